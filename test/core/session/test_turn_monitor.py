import math

import numpy as np
import pytest

from magcal_ros.core.samples import Coverage, FieldSample, Pair
from magcal_ros.core.session import Fault, MeasuredTurn, Progress, Stage, TurnMonitor
from magcal_ros.core.simulation import UP_ENU, Ride, Robot

TOLD = 0.4
NOTHING = Progress(Stage.COLLECTING, Coverage.nothing(), 0, 0.0, 0.0)


def watch(yaw_rate=TOLD, seconds=2.0, mirror_gyro=1.0, seed=1, gyro=True, gap=None, lean=(0, 0)):
    """The monitor after the robot has turned for a while."""
    monitor = TurnMonitor(np.eye(3))
    ride = Ride(Robot(), np.random.default_rng(seed), start=1.0, steps_per_field=1, gyro=gyro)
    ride.stand(*lean, 0.3)
    ride.axis = ride.attitude @ UP_ENU
    for _ in range(int(seconds * 100)):
        imu, field = ride.step(yaw_rate)
        if gap and gap[0] < ride.stamp - 1.0 < gap[1]:
            continue
        rate = tuple(mirror_gyro * value for value in imu.rate)
        monitor.add(Pair(FieldSample(imu.stamp, field.field), imu._replace(rate=rate)), TOLD)
    return monitor


@pytest.mark.parametrize("yaw_rate", [0.4, -0.4])
@pytest.mark.parametrize("lean", [(0.0, 0.0), (0.2, -0.1), (math.pi, 0.0)])
def test_the_gyro_gives_rate_and_angle_about_up(yaw_rate, lean):
    measured = watch(yaw_rate, lean=lean).measured(NOTHING)
    assert measured.by_gyro
    assert measured.rate == pytest.approx(yaw_rate, rel=0.02)
    assert measured.turned == pytest.approx(2.0 * yaw_rate, rel=0.03)


def test_a_gap_adds_no_angle_and_the_rate_is_correct_after_it():
    measured = watch(seconds=4.0, gap=(1.0, 2.0)).measured(NOTHING)
    assert measured.turned == pytest.approx(3.0 * TOLD, rel=0.03)
    assert measured.rate == pytest.approx(TOLD, rel=0.02)


def test_without_a_gyro_the_compass_of_the_session_is_used():
    coverage = Coverage.of(np.linspace(0.0, 2.0, 50))
    progress = Progress(Stage.COLLECTING, coverage, 50, 5.0, 0.37)
    assert watch(gyro=False).measured(progress) == MeasuredTurn(2.0, 0.37, False, False)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("mirror", [1.0, -1.0])
@pytest.mark.parametrize("yaw_rate", [0.4, -0.4])
def test_an_arc_of_45_degrees_shows_the_sense_of_the_compass(seed, mirror, yaw_rate):
    assert watch(yaw_rate, 2.0, mirror, seed).compass_sense() == mirror


def test_a_robot_at_rest_shows_no_sense():
    assert watch(0.0).compass_sense() == 0
    assert TurnMonitor(np.eye(3)).compass_sense() == 0


def test_a_mirrored_gyro_and_a_mirrored_base_are_distinguished():
    def words(**case):
        monitor = watch(**case)
        return monitor.explain(Fault.WRONG_WAY, monitor.measured(NOTHING), TOLD)

    assert "the gyro is mirrored" in words(mirror_gyro=-1.0)
    assert "the base turns the wrong way" in words(yaw_rate=-TOLD)
    assert "too short to decide" in words(yaw_rate=-TOLD, seconds=0.2)
    assert "-23°/s at a command of +23°/s" in words(yaw_rate=-TOLD)


def test_a_gyro_that_misses_the_turn_and_a_robot_at_rest_are_named():
    turning, resting = watch(mirror_gyro=1e-6), watch(0.0)
    measured = MeasuredTurn(0.0, 0.0, True, False)
    assert "the gyro does not measure" in turning.explain(Fault.NOT_TURNING, measured, TOLD)
    assert "emergency stop" in resting.explain(Fault.NOT_TURNING, measured, TOLD)
