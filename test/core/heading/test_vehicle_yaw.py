"""What is wrong: the yaw of the IMU in the vehicle, of the magnetometer, or the declination."""

import math

import pytest

from magcal_ros.core.driving import CourseOffset, MountingYaw
from magcal_ros.core.geometry import rotation_from_rpy, rpy_from_rotation
from magcal_ros.core.heading import VehicleYaw, compare_with_course, corrected_pose

DEGREE = math.pi / 180.0
EAST = 9.0 * DEGREE, 0.5 * DEGREE


def mounting(yaw_deg, sigma_deg=0.5):
    return MountingYaw(yaw_deg * DEGREE, sigma_deg * DEGREE, 1.0, 0.0, 0.9, 90.0, 90.0, 0.1)


def course(offset_deg, sigma_deg=1.0):
    return CourseOffset(offset_deg * DEGREE, sigma_deg * DEGREE, 900.0, 8)


def test_a_rotated_imu_shows_in_both_and_they_are_weighted():
    front = compare_with_course(mounting(5.0), course(9.0 + 6.0), *EAST)
    assert front.suspicion == ""
    assert 5.0 < math.degrees(front.yaw.offset) < 5.5
    assert front.yaw.sigma < 0.5 * DEGREE
    assert "to the left of the vehicle's front, by accelerations and course" in front.yaw.words


def test_a_rotated_magnetometer_is_distinguished_from_a_rotated_imu():
    front = compare_with_course(mounting(5.0), course(9.0 + 5.0 + 12.0), *EAST)
    assert math.degrees(front.yaw.offset) == pytest.approx(5.0)
    assert front.yaw.source == "accelerations"
    assert "the magnetometer is turned against the IMU" in front.suspicion
    assert "+12.0" in front.suspicion


def test_the_wrong_sign_of_a_declination_is_named():
    """It is -9 degrees in truth: the compass reads 9 less than it is corrected by, twice."""
    front = compare_with_course(mounting(5.0), course(-9.0 + 5.0), *EAST)
    assert "its sign is wrong" in front.suspicion
    assert "reference.declination_deg: -9.0" in front.suspicion


def test_an_unknown_declination_is_estimated_and_no_fault_is_reported():
    front = compare_with_course(mounting(5.0), course(-9.0 + 5.0), None)
    assert front.yaw.source == "accelerations"
    assert "the declination is about -9°" in front.suspicion
    assert compare_with_course(None, course(3.0), None).yaw is None


def test_course_alone_gives_the_yaw_if_true_north_is_known():
    front = compare_with_course(None, course(9.0 - 20.0, 1.2), *EAST)
    assert math.degrees(front.yaw.offset) == pytest.approx(-20.0)
    assert math.degrees(front.yaw.sigma) == pytest.approx(1.3)
    assert "20.0° ± 1.3° to the right" in front.yaw.words


def test_an_uncertain_course_is_not_used():
    front = compare_with_course(mounting(5.0), course(120.0, 15.0), *EAST)
    assert front.suspicion == ""
    assert front.yaw.source == "accelerations"


def test_angles_wrap_at_180_degrees():
    front = compare_with_course(mounting(179.8), course(9.0 - 179.6), *EAST)
    assert abs(math.degrees(front.yaw.offset)) > 179.0


def yaw_deg(pose):
    return math.degrees(rpy_from_rotation(pose)[2])


class TestMended:
    DESCRIBED = rotation_from_rpy(0.02, -0.03, 0.1)

    def found(self, degrees, sigma=0.5):
        return VehicleYaw(degrees * DEGREE, sigma * DEGREE, "accelerations")

    def test_a_yaw_found_by_driving_corrects_the_description(self):
        pose, contradiction = corrected_pose(self.DESCRIBED, None, self.found(10.0))
        assert yaw_deg(pose) == pytest.approx(10.0)
        assert rpy_from_rotation(pose)[:2] == pytest.approx((0.02, -0.03))
        assert contradiction == ""

    def test_an_uncertain_yaw_does_not_correct_the_description(self):
        assert corrected_pose(self.DESCRIBED, None, self.found(10.0, 2.5))[0] is self.DESCRIBED

    def test_a_yaw_far_from_the_description_is_reported_and_not_used(self):
        pose, contradiction = corrected_pose(self.DESCRIBED, None, self.found(90.0))
        assert pose is self.DESCRIBED
        assert "correct its joint" in contradiction

    def test_a_yaw_given_by_hand_has_priority_and_a_contradiction_is_reported(self):
        pose, contradiction = corrected_pose(self.DESCRIBED, 20.0 * DEGREE, self.found(10.0))
        assert yaw_deg(pose) == pytest.approx(20.0)
        assert "vehicle_yaw_deg is 20.0°, which is used" in contradiction
        assert corrected_pose(self.DESCRIBED, 10.5 * DEGREE, self.found(10.0))[1] == ""

    def test_without_a_description_there_is_nothing_to_correct(self):
        assert corrected_pose(None, 0.3, self.found(10.0))[0] is None
