from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from magcal_ros.core.geometry import (
    exp_rotation,
    exp_rotations,
    in_axes,
    minimal_rotation,
    rotation_about,
    rotation_angle,
    rotation_from_quaternion,
    rotation_from_rpy,
    rotation_vectors_near,
    rpy_from_rotation,
    skew,
)

angles = st.floats(-3.1, 3.1)
vectors = st.tuples(*[st.floats(-2.0, 2.0)] * 3).map(np.array)
directions = vectors.filter(lambda v: np.linalg.norm(v) > 0.1).map(lambda v: v / np.linalg.norm(v))


def assert_rotation(matrix):
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(matrix) == pytest.approx(1.0, abs=1e-9)


@given(vectors, vectors)
def test_skew_is_the_cross_product(v, w):
    np.testing.assert_allclose(skew(v) @ w, np.cross(v, w), atol=1e-12)


@given(vectors)
def test_exponential_turns_by_its_length_and_back(v):
    turn = exp_rotation(v)
    assert_rotation(turn)
    np.testing.assert_allclose(turn @ exp_rotation(-v), np.eye(3), atol=1e-12)
    np.testing.assert_allclose(turn @ v, v, atol=1e-12)
    if np.linalg.norm(v) < math.pi:
        assert rotation_angle(turn) == pytest.approx(np.linalg.norm(v), abs=1e-7)


def test_exponential_is_smooth_at_zero():
    above, below = exp_rotation(np.array([1.01e-8, 0, 0])), exp_rotation(np.array([0.99e-8, 0, 0]))
    np.testing.assert_allclose(above - below, skew(np.array([2e-10, 0, 0])), atol=1e-16)


def test_a_quarter_turn_about_up_takes_forward_to_left():
    up = np.array([0.0, 0.0, 1.0])
    for turn in (
        rotation_about(up, np.array([math.pi / 2]))[0],
        rotation_from_rpy(0, 0, math.pi / 2),
    ):
        np.testing.assert_allclose(turn @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-15)


def test_rpy_turns_about_fixed_axes_in_urdf_order():
    x, y, z = np.eye(3)
    expected = exp_rotation(0.3 * z) @ exp_rotation(0.2 * y) @ exp_rotation(0.1 * x)
    np.testing.assert_allclose(rotation_from_rpy(0.1, 0.2, 0.3), expected, atol=1e-15)


@given(angles, st.floats(-1.5, 1.5), angles)
def test_rpy_angles_are_recovered(roll, pitch, yaw):
    found = rpy_from_rotation(rotation_from_rpy(roll, pitch, yaw))
    np.testing.assert_allclose(found, (roll, pitch, yaw), atol=1e-9)


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2])
@given(roll=angles, yaw=angles)
def test_rpy_at_the_pole_is_still_the_same_pose(pitch, roll, yaw):
    pose = rotation_from_rpy(roll, pitch, yaw)
    np.testing.assert_allclose(rotation_from_rpy(*rpy_from_rotation(pose)), pose, atol=1e-8)


@example(np.array([math.cos(4.8e-5), 0.0, math.sin(4.8e-5)]), np.array([-1.0, 0.0, 0.0]))
@example(np.array([math.cos(1e-8), math.sin(1e-8), 0.0]), np.array([-1.0, 0.0, 0.0]))
@given(directions, directions)
def test_minimal_rotation_arrives_by_the_shortest_way(start, end):
    turn = minimal_rotation(start, end)
    assert_rotation(turn)
    np.testing.assert_allclose(turn @ start, end, atol=1e-7)
    between = math.atan2(np.linalg.norm(np.cross(start, end)), start @ end)
    assert rotation_angle(turn) == pytest.approx(between, abs=1e-5)


@given(directions)
def test_minimal_rotation_to_the_opposite(start):
    turn = minimal_rotation(start, -start)
    assert_rotation(turn)
    np.testing.assert_allclose(turn @ start, -start, atol=1e-12)


@given(vectors, st.floats(0.01, 100.0))
def test_a_quaternion_of_any_length_turns_as_its_vector_does(v, length):
    angle = float(np.linalg.norm(v))
    axis = v / angle if angle > 0.0 else v
    x, y, z = (length * math.sin(angle / 2.0) * axis).tolist()
    turn = rotation_from_quaternion(x, y, z, length * math.cos(angle / 2.0))
    np.testing.assert_allclose(turn, exp_rotation(v), atol=1e-9)


def test_a_zero_quaternion_is_no_rotation():
    assert rotation_from_quaternion(0.0, 0.0, 0.0, 0.0) is None
    assert rotation_from_quaternion(math.nan, 0.0, 0.0, 1.0) is None


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, 1.7, math.pi, 3.3, 6.1, math.tau, 9.0])
def test_the_vector_of_a_rotation_of_any_angle_is_the_one_nearest_to_a_guess(angle):
    axis = np.array([[0.6, 0.0, 0.8]])
    guess = (angle + 0.2) * axis + 0.01
    found = rotation_vectors_near(exp_rotations(angle * axis), guess)
    away = found - angle * axis
    # Of a whole or half round the axis is that of the guess.
    assert np.abs(away).max() < (0.08 if angle in (math.pi, math.tau) else 1e-6)


@dataclass(frozen=True)
class Arrow:
    tip: np.ndarray

    def in_axes(self, rotation):
        return Arrow(rotation @ self.tip)


@dataclass(frozen=True)
class Quiver:
    name: str
    first: Arrow | None
    others: dict[str, tuple[Arrow, ...]]


def test_everything_that_has_axes_is_turned():
    turn = rotation_from_rpy(0.3, -0.2, 1.0)
    arrow, number = Arrow(np.array([1.0, 2.0, 3.0])), np.arange(3.0)
    quiver, last = in_axes([Quiver("ash", None, {"oak": (arrow,)}), number], turn)
    assert (quiver.name, quiver.first, last is number) == ("ash", None, True)
    assert quiver.others["oak"][0].tip == pytest.approx(turn @ arrow.tip)
    assert in_axes(arrow, np.eye(3)) is arrow
