from __future__ import annotations

import math
import tracemalloc

import numpy as np
import pytest
from examples import examples
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.shapes import ConicFit

every_fit = pytest.mark.parametrize("fit", ConicFit)
CIRCLES = (ConicFit.TAUBIN, ConicFit.CIRCLE)
FREE = (ConicFit.ROTATED_ELLIPSE, ConicFit.HALIR_FLUSSER)


def curve(centre=(0.0, 0.0), radii=(1.0, 1.0), angle=0.0, arc=315.0, noise=0.0, seed=0, samples=50):
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, math.radians(arc), samples)
    c, s = math.cos(angle), math.sin(angle)
    points = np.column_stack([radii[0] * np.cos(t), radii[1] * np.sin(t)]) @ [[c, s], [-s, c]]
    return points + centre + noise * rng.standard_normal((samples, 2))


@every_fit
@examples(40)
@given(
    x=st.floats(-3.0, 3.0),
    y=st.floats(-3.0, 3.0),
    size=st.floats(-6.0, 3.0),
    arc=st.floats(120.0, 360.0),
)
def test_circles_are_exact_wherever_they_lie(fit, x, y, size, arc):
    scale = 10.0**size
    conic = fit(curve((x, y), arc=arc) * scale)
    np.testing.assert_allclose(conic.centre, np.array([x, y]) * scale, atol=1e-10 * scale)
    np.testing.assert_allclose(conic.radii, scale, rtol=1e-10)
    assert conic.ratio == pytest.approx(1.0, abs=1e-9)


@every_fit
def test_a_circle_through_the_origin(fit):
    points = curve((0.3, -0.4), radii=(0.5, 0.5))
    x, y = points.T
    printed = np.column_stack([x * x + y * y, 2.0 * x, 2.0 * y])
    assert np.linalg.norm(printed @ np.linalg.lstsq(printed, np.ones(50))[0] - 1.0) > 1.0
    np.testing.assert_allclose(fit(points).centre, [0.3, -0.4], atol=1e-10)


@pytest.mark.parametrize("fit", FREE)
@examples(40)
@given(angle=st.floats(-1.5, 1.5), short=st.floats(0.2, 0.9))
def test_free_ellipses_keep_their_angle_and_radii(fit, angle, short):
    conic = fit(curve((2.0, -1.0), (1.0, short), angle))
    np.testing.assert_allclose(conic.centre, [2.0, -1.0], atol=1e-9)
    np.testing.assert_allclose(sorted(conic.radii), [short, 1.0], rtol=1e-8)
    long_axis = math.atan2(*conic.axes[::-1, int(np.argmax(conic.radii))])
    assert math.remainder(long_axis - angle, math.pi) == pytest.approx(0.0, abs=1e-7)
    assert conic.radius == pytest.approx(math.sqrt(short), rel=1e-8)


@pytest.mark.parametrize("radii", [(1.0, 0.4), (0.4, 1.0)])
def test_aligned_ellipses_name_x_first(radii):
    conic = ConicFit.ELLIPSE(curve((2.0, -1.0), radii))
    np.testing.assert_allclose(conic.radii, radii, rtol=1e-10)
    assert np.array_equal(conic.axes, np.eye(2))


@pytest.mark.parametrize(("arc", "bound"), [(180.0, 0.01), (90.0, 0.03)])
def test_taubin_is_nearly_unbiased_on_short_arcs(arc, bound):
    found = {
        fit: np.mean(
            [fit(curve(arc=arc, noise=0.02, seed=s, samples=500)).centre for s in range(30)], axis=0
        )
        for fit in (ConicFit.TAUBIN, ConicFit.HALIR_FLUSSER)
    }
    assert np.linalg.norm(found[ConicFit.TAUBIN]) < bound / 2.0
    assert np.linalg.norm(found[ConicFit.HALIR_FLUSSER]) > bound


@every_fit
@pytest.mark.parametrize(
    ("points", "reason"),
    [
        (np.outer(np.arange(30.0), [1.0, 2.0]), Reason.FIELD_ON_A_LINE),
        (np.ones((30, 2)), Reason.FIELD_ON_A_LINE),
        (np.eye(2), Reason.TOO_FEW_SAMPLES),
        (np.full((30, 2), np.nan), Reason.NOT_FINITE),
    ],
)
def test_degenerate_points_are_refused(fit, points, reason):
    with pytest.raises(Refusal) as caught:
        fit(points)
    assert caught.value.reason is reason


@pytest.mark.parametrize("fit", FREE)
def test_four_points_hold_no_free_ellipse(fit):
    with pytest.raises(Refusal) as caught:
        fit(curve(samples=4))
    assert caught.value.reason is Reason.TOO_FEW_SAMPLES


def test_a_hyperbola_is_no_ellipse():
    t = np.linspace(-1.5, 1.5, 50)
    branches = np.vstack([[np.cosh(t), np.sinh(t)], [-np.cosh(t), np.sinh(t)]])
    points = branches.reshape(2, 2, 50).transpose(0, 2, 1).reshape(-1, 2)
    with pytest.raises(Refusal, match="hyperbola"):
        ConicFit.ROTATED_ELLIPSE(points)


@pytest.mark.parametrize("fit", ConicFit)
def test_memory_grows_with_the_points_and_not_with_their_square(fit):
    angles = np.linspace(0.0, math.tau, 4000)
    points = np.c_[2.0 * np.cos(angles), np.sin(angles) * (2.0 if "ellipse" not in fit else 1.0)]
    tracemalloc.start()
    try:
        fit(points)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 5e6
