from __future__ import annotations

import math
import tracemalloc

import numpy as np
import pytest
from examples import examples
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.core import Reason, Refusal
from magcal_ros.core.geometry import ellipse_ratio, fit_circle

every_fit = pytest.mark.parametrize("fit", [fit_circle, ellipse_ratio])


def curve(centre=(0.0, 0.0), radii=(1.0, 1.0), angle=0.0, arc=315.0, noise=0.0, seed=0, samples=50):
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, math.radians(arc), samples)
    c, s = math.cos(angle), math.sin(angle)
    points = np.column_stack([radii[0] * np.cos(t), radii[1] * np.sin(t)]) @ [[c, s], [-s, c]]
    return points + centre + noise * rng.standard_normal((samples, 2))


@examples(40)
@given(
    x=st.floats(-3.0, 3.0),
    y=st.floats(-3.0, 3.0),
    size=st.floats(-6.0, 3.0),
    arc=st.floats(120.0, 360.0),
)
def test_circles_are_exact_at_any_position(x, y, size, arc):
    scale = 10.0**size
    points = curve((x, y), arc=arc) * scale
    centre, radius = fit_circle(points)
    np.testing.assert_allclose(centre, np.array([x, y]) * scale, atol=1e-10 * scale)
    assert radius == pytest.approx(scale, rel=1e-10)
    assert ellipse_ratio(points) == pytest.approx(1.0, abs=1e-9)


@examples(40)
@given(angle=st.floats(-1.5, 1.5), short=st.floats(0.2, 0.9))
def test_the_ratio_of_an_ellipse_is_found_at_any_angle(angle, short):
    assert ellipse_ratio(curve((2.0, -1.0), (1.0, short), angle)) == pytest.approx(1.0 / short)


@pytest.mark.parametrize(("arc", "bound"), [(180.0, 0.01), (90.0, 0.03)])
def test_the_circle_is_nearly_unbiased_on_short_arcs(arc, bound):
    arcs = [curve(arc=arc, noise=0.02, seed=s, samples=500) for s in range(30)]
    assert np.linalg.norm(np.mean([fit_circle(each)[0] for each in arcs], axis=0)) < bound / 2.0


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


def test_four_points_determine_no_ellipse():
    with pytest.raises(Refusal) as caught:
        ellipse_ratio(curve(samples=4))
    assert caught.value.reason is Reason.TOO_FEW_SAMPLES


@every_fit
def test_memory_grows_with_the_points_and_not_with_their_square(fit):
    angles = np.linspace(0.0, math.tau, 4000)
    points = np.c_[2.0 * np.cos(angles), 2.0 * np.sin(angles)]
    tracemalloc.start()
    try:
        fit(points)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 5e6
