from __future__ import annotations

import numpy as np
import pytest
from examples import examples
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.core import Reason, Refusal
from magcal_ros.core.geometry import fit_plane


def disc(normal, centre=(0.0, 0.0, 0.0), noise=0.0, seed=0, samples=50, size=(1.0, 1.0)):
    rng = np.random.default_rng(seed)
    in_plane = np.linalg.svd(np.asarray(normal, dtype=float)[None])[2][1:]
    angle = np.linspace(0.0, 5.0, samples)
    flat = np.column_stack([np.cos(angle), np.sin(angle)]) * size
    return flat @ in_plane + centre + noise * rng.standard_normal((samples, 3))


def unit(vector):
    return np.asarray(vector) / np.linalg.norm(vector)


@examples(50)
@given(seed=st.integers(0, 10_000))
def test_finds_any_plane_at_any_place_and_size(seed):
    rng = np.random.default_rng(seed)
    normal, centre = unit(rng.standard_normal(3)), 3.0 * rng.standard_normal(3)
    points = disc(normal, centre) * 50e-6
    plane = fit_plane(points)
    assert abs(plane.normal @ normal) == pytest.approx(1.0, abs=1e-12)
    assert np.linalg.norm(plane.normal) == pytest.approx(1.0, abs=1e-12)
    assert plane.thickness < 1e-7 * plane.spread[2]


@pytest.mark.parametrize("normal", np.eye(3))
def test_planes_along_the_axes(normal):
    assert abs(fit_plane(disc(normal)).normal @ normal) == pytest.approx(1.0, abs=1e-12)


def test_spread_is_ordered_and_measured():
    plane = fit_plane(disc([0, 0, 1], noise=0.01, samples=5000))
    assert plane.spread[0] == pytest.approx(0.01, rel=0.05)
    assert plane.spread[0] <= plane.spread[1] <= plane.spread[2]
    assert plane.thickness == pytest.approx(plane.spread[0], rel=1e-6)


def test_a_thin_cloud_does_not_turn_the_normal():
    normal = unit([0.5, 0.0, 0.8])
    cloud = disc(normal, noise=0.03, samples=20_000, size=(0.1, 0.1))
    off = np.arccos(min(1.0, abs(fit_plane(cloud).normal @ normal)))
    assert off < np.radians(0.5)


def test_the_normals_sigma_is_the_scatter_of_many_fits():
    normal = np.array([0.0, 0.0, 1.0])
    planes = [fit_plane(disc(normal, noise=0.05, seed=s, size=(1.0, 0.3))) for s in range(300)]
    tilt = np.array([p.normal[:2] * np.sign(p.normal[2]) for p in planes])
    worst = np.sqrt(np.linalg.eigvalsh(np.cov(tilt.T))[1])
    predicted = np.mean([plane.normal_sigma(1e-9) for plane in planes])
    assert predicted == pytest.approx(worst, rel=0.15)


def test_an_isotropic_cloud_has_an_infinite_sigma_of_its_normal():
    plane = fit_plane(np.random.default_rng(0).standard_normal((500, 3)))
    assert plane.normal_sigma(1e-9) > np.radians(20.0)


@pytest.mark.parametrize(
    ("points", "reason"),
    [
        (np.tile([1.0, 2.0, 3.0], (30, 1)), Reason.NO_MOTION),
        (np.zeros((30, 3)), Reason.NO_MOTION),
        (np.outer(np.arange(30.0), [1.0, 2.0, 3.0]) + 5.0, Reason.FIELD_ON_A_LINE),
        (np.eye(3)[:2], Reason.TOO_FEW_SAMPLES),
        (np.array([[0.0, 0.0, 1.0], [np.nan, 0.0, 0.0], [1.0, 0.0, 0.0]]), Reason.NOT_FINITE),
        (np.array([[0.0, 0.0, 1.0], [np.inf, 0.0, 0.0], [1.0, 0.0, 0.0]]), Reason.NOT_FINITE),
    ],
)
def test_degenerate_clouds_are_refused(points, reason):
    with pytest.raises(Refusal) as caught:
        fit_plane(points)
    assert caught.value.reason is reason
