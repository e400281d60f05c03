"""The field of motors is subtracted from a recording as in the node."""

from dataclasses import replace

import numpy as np

from magcal_ros.core import Calibration
from magcal_ros.core.calibration import Evidence, MotorField, MotorInput
from magcal_ros.core.samples import FieldSample, SpeedSample
from magcal_ros.core.session import without_motors
from magcal_ros.core.simulation import Ride, Robot

ROBOT = Robot()
GAIN = np.array([[6e-6, -8e-6, 3e-6], [2e-6, 1e-6, -1e-6], [4e-6, 0.0, -5e-6]])
INPUTS = MotorInput.MOVING, MotorInput.CURRENT, MotorInput.SPEED
EVIDENCE = Evidence("none", "", "", "made up")
KNOWN = Calibration(ROBOT.true_correction, 1e-18 * np.eye(12), 0.3e-6, 0.01, 50e-6, 1.0, EVIDENCE)
MOTORS = MotorField(
    INPUTS, GAIN, (0.1e-6) ** 2 * np.eye(9), np.zeros((12, 9)), 0.2e-6, (1.0, 2.0, 0.5)
)


def reported():
    """Readings without and with motors, speeds of wheels, and currents."""
    ride = Ride(ROBOT, np.random.default_rng(1), start=100.0, imu_rate=50.0)
    clean, loud, speeds, currents = [], [], [], []
    for k in range(1500):
        moves, speed = 300 <= k < 1000, 0.4 * (500 <= k < 800)
        current = 0.5 + 2.0 * moves
        for sample in ride.step(0.4 * moves):
            clean.append(sample)
            if isinstance(sample, FieldSample):
                added = np.array([float(moves), current - 0.5, speed]) @ GAIN
                sample = sample._replace(field=tuple(np.add(sample.field, added)))
            loud.append(sample)
        speeds.append(SpeedSample(ride.stamp, speed))
        currents.append((ride.stamp, current))
    return clean, loud, speeds, currents


def fields(readings):
    return np.array([each.field for each in readings if isinstance(each, FieldSample)])


def test_the_fields_by_speed_current_and_motion_are_subtracted():
    clean, loud, speeds, currents = reported()
    known = replace(KNOWN, motors=MOTORS)
    found = list(without_motors(loud, known, speeds, currents))
    assert len(found) == len(loud)
    off = np.linalg.norm(fields(found) - fields(clean), axis=1)
    added = np.linalg.norm(fields(loud) - fields(clean), axis=1)
    assert np.sqrt(np.mean(off**2)) < 0.1 * np.sqrt(np.mean(added**2))


def test_a_calibration_without_motors_changes_nothing():
    _, loud, speeds, currents = reported()
    assert list(without_motors(loud, KNOWN, speeds, currents)) == loud
