import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from sample_results import calibration as sample_calibration

from magcal_ros.core import Compass, Correction
from magcal_ros.core.calibration import PARAMETERS
from magcal_ros.core.geometry import exp_rotation, rotation_from_rpy
from magcal_ros.core.heading import BaseHeading, Heading

angles = st.floats(-3.1, 3.1)
tilts = st.floats(-1.2, 1.2)
poses = st.builds(rotation_from_rpy, angles, tilts, angles)
FIELD_ENU = np.array([0.0, 20e-6, -43e-6])


def in_base_axes(calibration, pose):
    """Return the same calibration for a field in base axes."""
    carry = np.eye(PARAMETERS)
    carry[:9, :9] = np.kron(pose, np.eye(3))
    correction = calibration.correction
    return replace(
        calibration,
        correction=Correction(pose @ correction.matrix, correction.hard_iron),
        covariance=carry @ calibration.covariance @ carry.T,
    )


@given(angles, tilts, angles, poses)
def test_the_heading_is_that_of_a_compass_in_base_axes(roll, pitch, yaw, pose):
    calibration = sample_calibration()
    to_world = rotation_from_rpy(roll, pitch, yaw)
    field, up = to_world.T @ FIELD_ENU, to_world.T[:, 2]
    assume(abs((pose @ up)[0]) < 0.95)
    assume(abs(up[0]) < 0.95)
    seen = Compass(calibration).heading(tuple(field), tuple(up), 1e-4)
    compass = Compass(in_base_axes(calibration, pose))
    expected = compass.heading(tuple(pose @ field), tuple(pose @ up), 1e-4)
    found = BaseHeading(pose).heading(seen)
    for name in ("roll", "pitch", "yaw"):
        difference = getattr(found, name) - getattr(expected, name)
        assert math.remainder(difference, math.tau) == pytest.approx(0.0, abs=1e-9)
    assert found[3:9] == pytest.approx(expected[3:9], rel=1e-6, abs=1e-12)


def test_a_base_equal_to_the_imu_has_the_same_heading():
    heading = Heading(0.1, 0.2, 0.3, 1e-4, 2e-4, 1e-5, 1e-5)
    assert BaseHeading(np.eye(3)).heading(heading) is heading


@given(angles, tilts, angles, poses)
def test_a_yaw_independent_of_tilt_keeps_its_variance(roll, pitch, yaw, pose):
    heading = Heading(roll, pitch, yaw, 1e-4, 2e-4, 0.0, 0.0)
    found = BaseHeading(pose).heading(heading)
    assert found.yaw_variance == pytest.approx(2e-4)
    assert (found.by_east, found.by_north) == (0.0, 0.0)


def test_an_imu_mounted_sideways_has_a_yaw_of_a_right_angle_more():
    sideways = exp_rotation(np.array([0.0, 0.0, math.pi / 2]))
    found = BaseHeading(sideways).heading(Heading(0.05, 0.0, 1.0, 1e-4, 2e-4, 0.0, 0.0))
    assert found.yaw == pytest.approx(1.0 - math.pi / 2)
    assert found.pitch == pytest.approx(0.05)
    assert found.roll == pytest.approx(0.0, abs=1e-12)
