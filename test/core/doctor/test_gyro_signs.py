import math

import numpy as np
import pytest
from long_form import first_of
from simulated.drive import Vehicle, simulated_drive
from simulated.legs import Leg
from simulated.travel import travel
from simulated.turns import measure, smooth_wobble, turn

from magcal_ros.core import Knowledge, Window
from magcal_ros.core.doctor import examine, wrong_axes
from magcal_ros.core.knowledge import knowledge_of
from magcal_ros.core.samples import SensorLog
from magcal_ros.core.simulation import Robot


def is_refused(window):
    return wrong_axes(window, Knowledge()) is not None


def leaning_turn(seed=1):
    robot = Robot(gyro_bias=np.array([0.02, -0.01, 0.03]))
    rng = np.random.default_rng(seed)
    wobble = smooth_wobble(rng, 500, 15.0, 0.1)
    return measure(robot, turn(wobble=wobble), rng, gyro=True)


def with_signs(window, signs):
    rate = window.angular_rate * np.array(signs)
    return Window(window.time, window.field, window.specific_force, rate)


@pytest.mark.parametrize("seed", first_of(range(5)))
def test_a_correct_gyro_is_accepted(seed):
    assert not is_refused(leaning_turn(seed))


@pytest.mark.parametrize("signs", first_of([(-1, -1, 1), (-1, -1, -1), (1, 1, -1), (1, -1, 1)]))
def test_axes_that_turn_the_wrong_way_are_found(signs):
    found = wrong_axes(with_signs(leaning_turn(), signs), Knowledge())
    assert "the gyro's axes do not match the accelerometer's" in str(found)


def test_a_missing_gyro_gives_no_finding_on_signs():
    assert not is_refused(measure(Robot(), turn(), np.random.default_rng(1)))


PLACE = knowledge_of(48.0, inclination_deg=64.0)


@pytest.mark.nightly
@pytest.mark.parametrize("knowledge", first_of([PLACE, Knowledge()]))
@pytest.mark.parametrize(
    ("source", "alive"), [(2, 0), (2, 2), pytest.param(2, 1, marks=pytest.mark.nightly)]
)
def test_dead_axes_of_a_gyro_are_not_attributed_to_other_sensors(knowledge, source, alive):
    rest = [Leg(6.0), Leg(25.0, turn_rate=math.tau / 25.0), Leg(6.0)]
    robot = Robot(strength=48e-6, inclination=math.radians(64.0), noise_rate=2e-3)
    rng = np.random.default_rng(40)
    drive = simulated_drive(travel(rest, rng, rate=50.0), rng, Vehicle(robot), streets=None)
    rate = np.zeros_like(drive.rate)
    rate[:, alive] = drive.rate[:, source]
    report = examine(SensorLog(drive.time, drive.force, rate, drive.time, drive.field), knowledge)
    assert report.mount_rpy_deg is None
    stated = {finding.name: finding.remedy for finding in report.findings if finding.is_wrong}
    assert list(stated) == ["gyro: axes alive"]
    moved = f"and publishes the turn about z as {'xyz'[alive]}"
    assert (moved in stated["gyro: axes alive"]) == (alive != source)
