"""A circle in space is found anywhere, with its normal to the requested side."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.core import Refusal
from magcal_ros.core.geometry import exp_rotation, fit_circle_in_space

numbers = st.floats(-3.0, 3.0)
vectors = st.tuples(numbers, numbers, numbers).map(np.array)


@given(vectors, vectors, st.floats(0.5, 5.0), st.floats(1.5, 6.0))
def test_a_circle_and_its_phases_are_recovered(turn, centre, radius, arc):
    pose = exp_rotation(turn)
    angles = np.linspace(0.0, arc, 60)
    flat = radius * np.stack([np.cos(angles), np.sin(angles), np.zeros(60)], axis=-1)
    points = flat @ pose.T + centre
    circle = fit_circle_in_space(points, pose[:, 2])
    assert circle.radius == pytest.approx(radius, rel=1e-6)
    assert np.allclose(circle.centre, centre, atol=1e-6)
    assert np.allclose(circle.basis[2], pose[:, 2], atol=1e-6)
    assert np.allclose(np.diff(np.unwrap(circle.phase(points))), angles[1], atol=1e-6)
    assert np.allclose(circle.at(circle.phase(points)), points, atol=1e-6)


def test_the_normal_points_to_the_requested_side():
    angles = np.linspace(0.0, 6.0, 40)
    points = np.stack([np.cos(angles), np.sin(angles), np.ones(40)], axis=-1)
    down = fit_circle_in_space(points, np.array([0.0, 0.0, -1.0]))
    assert down.basis[2, 2] == pytest.approx(-1.0)
    assert np.linalg.det(down.basis) == pytest.approx(1.0)


def test_points_on_a_line_are_refused():
    with pytest.raises(Refusal):
        fit_circle_in_space(np.outer(np.arange(30.0), [1.0, 2.0, 3.0]), np.array([0.0, 0.0, 1.0]))
