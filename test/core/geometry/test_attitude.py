from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.core.geometry import (
    FRD_FROM_FLU,
    body_from_enu,
    field_in_enu,
    level_part,
    rotation_from_rpy,
    true_yaw,
    unit,
    wrap_angle,
    yaw_from_up_and_field,
)

angles = st.floats(-3.1, 3.1)
tilts = st.floats(-1.2, 1.2)
dips = st.floats(-1.4, 1.4)


@pytest.mark.parametrize(
    ("north_in_body", "yaw"),
    [([1, 0, 0], 90.0), ([0, 1, 0], 0.0), ([-1, 0, 0], -90.0), ([0, -1, 0], 180.0)],
)
def test_yaw_is_correct_for_the_four_cardinal_directions(north_in_body, yaw):
    found = yaw_from_up_and_field(np.array([0, 0, 9.81]), np.array(north_in_body, dtype=float))
    assert math.degrees(found) == pytest.approx(yaw)


@given(tilts, tilts, angles, dips)
def test_yaw_is_the_poses_yaw_whatever_the_tilt_and_dip(roll, pitch, yaw, dip):
    to_body = rotation_from_rpy(roll, pitch, yaw).T
    up, field = to_body @ [0.0, 0.0, 9.81], to_body @ field_in_enu(50e-6, dip)
    assert yaw_from_up_and_field(up, field) == pytest.approx(yaw, abs=1e-9)
    np.testing.assert_allclose(body_from_enu(up, field), to_body, atol=1e-9)


@given(angles, dips, st.floats(-1.0, 1.0))
def test_true_yaw_is_magnetic_yaw_minus_declination(yaw, dip, declination):
    to_body = rotation_from_rpy(0.1, -0.2, yaw).T
    field = to_body @ field_in_enu(50e-6, dip, declination)
    magnetic = float(yaw_from_up_and_field(to_body @ [0.0, 0.0, 1.0], field))
    assert math.remainder(true_yaw(magnetic, declination) - yaw, 2 * math.pi) == pytest.approx(
        0.0, abs=1e-9
    )


def test_the_field_points_down_in_the_north_and_east_of_true_north():
    east, north, up = field_in_enu(50e-6, math.radians(60.0), math.radians(10.0))
    assert north > east > 0.0 > up
    assert up == pytest.approx(-50e-6 * math.sin(math.radians(60.0)))


def test_the_change_of_body_axes_is_a_rotation_and_its_own_inverse():
    np.testing.assert_array_equal(FRD_FROM_FLU @ FRD_FROM_FLU, np.eye(3))
    assert np.linalg.det(FRD_FROM_FLU) == pytest.approx(1.0)


@given(st.floats(-1e3, 1e3))
def test_wrapping_keeps_the_direction(angle):
    wrapped = float(wrap_angle(angle))
    assert -math.pi < wrapped <= math.pi
    assert math.remainder(wrapped - angle, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)


def test_angles_wrap_at_180_degrees():
    np.testing.assert_allclose(
        wrap_angle(np.array([math.pi, -math.pi, 0.0])), [math.pi, math.pi, 0]
    )


def test_the_unit_vector_of_zero_is_zero():
    np.testing.assert_allclose(
        unit(np.array([[0, 0, 0], [3.0, 0, 4.0]])), [[0, 0, 0], [0.6, 0, 0.8]]
    )


def test_the_level_part_is_across_up_and_leaves_what_is_along_it():
    rng = np.random.default_rng(1)
    vectors, up = rng.normal(size=(20, 3)), unit(rng.normal(size=(20, 3)))
    level = level_part(vectors, up)
    np.testing.assert_allclose(np.sum(level * up, axis=1), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.cross(vectors - level, up), 0.0, atol=1e-12)
