"""Ellipsoids through points, against ellipsoids that are known."""

from __future__ import annotations

import numpy as np
import pytest
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from magcal_ros.core import Reason, Refusal
from magcal_ros.core.geometry import QuadricFit, fit_quadric

seeds = st.integers(0, 2**32 - 1)


def on_sphere(rng, count=60):
    points = rng.standard_normal((count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


@examples(50)
@given(seeds)
def test_every_ellipsoid_is_found_from_exact_points(seed):
    rng = np.random.default_rng(seed)
    radii, centre = rng.uniform(0.5, 1.5, 3), rng.uniform(-5.0, 5.0, 3)
    axes = Rotation.from_quat(rng.standard_normal(4)).as_matrix()
    found = fit_quadric(1e-5 * (centre + on_sphere(rng) * radii @ axes.T))
    np.testing.assert_allclose(found.centre, 1e-5 * centre, atol=1e-12)
    np.testing.assert_allclose(np.sort(found.radii), 1e-5 * np.sort(radii), rtol=1e-6)
    inverse = axes @ np.diag(1e5 / radii) @ axes.T
    np.testing.assert_allclose(found.to_unit_sphere, inverse, rtol=1e-5, atol=1.0)
    assert np.linalg.det(found.axes) == pytest.approx(1.0)


@examples(30)
@given(seeds)
def test_the_restricted_shapes_are_found(seed):
    rng = np.random.default_rng(seed)
    radii, centre = rng.uniform(0.5, 1.5, 3), rng.uniform(-5.0, 5.0, 3)
    aligned = fit_quadric(centre + on_sphere(rng) * radii, QuadricFit.ALIGNED)
    np.testing.assert_allclose(aligned.radii, radii, rtol=1e-6)
    np.testing.assert_array_equal(aligned.axes, np.eye(3))
    sphere = fit_quadric(centre + 2.0 * on_sphere(rng), QuadricFit.SPHERE)
    np.testing.assert_allclose(sphere.radii, 2.0, rtol=1e-9)
    np.testing.assert_allclose(sphere.centre, centre, atol=1e-9)


def test_a_surface_through_the_origin_is_found():
    points = on_sphere(np.random.default_rng(1)) + np.array([1.0, 0.0, 0.0])
    np.testing.assert_allclose(fit_quadric(points).centre, [1.0, 0.0, 0.0], atol=1e-9)


def test_the_radius_is_that_of_the_sphere_of_the_same_volume():
    points = on_sphere(np.random.default_rng(1)) * np.array([1.0, 2.0, 4.0])
    assert fit_quadric(points).radius == pytest.approx(2.0)


@pytest.mark.parametrize("shape", QuadricFit)
def test_a_plane_is_refused(shape):
    points = on_sphere(np.random.default_rng(1)) * np.array([1.0, 1.0, 0.0])
    with pytest.raises(Refusal) as caught:
        fit_quadric(points, shape)
    assert caught.value.reason is Reason.PLANAR


def test_an_open_surface_is_refused():
    rng = np.random.default_rng(1)
    height, angle = rng.uniform(-2.0, 2.0, 200), rng.uniform(0.0, 6.28, 200)
    waist = np.sqrt(1.0 + height**2)
    points = np.column_stack([waist * np.cos(angle), waist * np.sin(angle), height])
    with pytest.raises(Refusal) as caught:
        fit_quadric(points)
    assert caught.value.reason is Reason.NO_SOLUTION
    assert "hyperboloid" in str(caught.value)


@pytest.mark.parametrize(("shape", "least"), [("rotated", 9), ("aligned", 6), ("sphere", 4)])
def test_too_few_points_are_refused(shape, least):
    points = on_sphere(np.random.default_rng(1))
    fit_quadric(points[:least], QuadricFit(shape))
    with pytest.raises(Refusal) as caught:
        fit_quadric(points[: least - 1], QuadricFit(shape))
    assert caught.value.reason is Reason.TOO_FEW_SAMPLES


def test_points_that_are_not_finite_are_refused():
    points = on_sphere(np.random.default_rng(1))
    points[3, 1] = np.nan
    with pytest.raises(Refusal) as caught:
        fit_quadric(points)
    assert caught.value.reason is Reason.NOT_FINITE
