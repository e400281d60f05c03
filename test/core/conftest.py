"""Fixtures of the tests of the core."""

import pytest
from remembered import remembered

from magcal_ros.core.doctor import sensor_report
from magcal_ros.core.methods import smoother
from magcal_ros.core.multi_turn import joined

SMOOTH = remembered(smoother.smooth)


@pytest.fixture(scope="module")
def right_axes(request):
    """Look for no wrong axes after a fit, which takes longer than the fit; `make nightly` looks.

    For tests whose subject is the fit of a robot with right axes.
    """
    with pytest.MonkeyPatch.context() as patched:
        if "not nightly" in request.config.option.markexpr:
            for module in (sensor_report, joined):
                patched.setattr(module, "wrong_axes", lambda *_: None)
        yield


@pytest.fixture
def one_fit(monkeypatch):
    """Fit the same samples once."""
    monkeypatch.setattr(smoother, "smooth", SMOOTH)
