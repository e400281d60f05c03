"""A recorded turn or drive is fitted as the node fits it."""

import dataclasses
import math

import numpy as np
import pytest
from drives import ROBOT, drive
from long_form import first_of
from simulated import Vehicle, city, simulated_drive, travel

from magcal_ros.core import Figure
from magcal_ros.core.knowledge import knowledge_of
from magcal_ros.core.samples import ImuSample, Streams
from magcal_ros.core.session import Conclusion, SampleCollector, SelfTurn, fit_collected
from magcal_ros.core.simulation import Robot
from magcal_ros.core.up import UpFollower
from magcal_ros.ros.magnetometer import Control
from magcal_ros.ros.parameter_table import PARAMETERS
from magcal_ros.ros.parameters import Settings

KNOWLEDGE = ROBOT.knowledge(1.5e-6, math.radians(1.0))


def fitted(samples, knowledge=KNOWLEDGE):
    collector = SampleCollector(ROBOT.mounting, "/imu", "/mag")
    collector.take(samples)
    return fit_collected(collector, knowledge)


class House:
    """The parts of a node that a turn needs."""

    def __init__(self):
        self.reporter = self.fits = self.files = self
        self.travel = self.estimator = self.motors = self
        self.owner = self.pipeline = self.inputs = self.store = self
        self.up, self.streams = UpFollower(), Streams(0.2)

    calibration = None

    def use(self, _, tell):
        tell(Conclusion(True, ""))

    def report(self, *_):
        return ""

    def turn_ended(self, *_):
        pass

    def wheel_speed(self, _):
        return math.nan

    currents = ()

    def run(self, work, then, _):
        then(work())


def live(samples, knowledge):
    """The result of the node's control with the samples."""
    house = House()
    streams, control = house.streams, Control(house, SelfTurn())
    settings = Settings.of({spec.name: spec.default for spec in PARAMETERS})
    assert control.start(dataclasses.replace(settings, knowledge=knowledge)).success
    for sample in samples:
        if isinstance(sample, ImuSample):
            streams.add_imu(sample)
        elif streams.add_field(sample) and not streams.is_repeated:
            control.add(sample)
    assert control.finish() is None
    control.shut_down()
    return control.turn.last_outcome


@pytest.mark.parametrize("gyro", first_of([True, False]))
def test_a_recording_gives_the_same_calibration_as_the_node(gyro):
    samples = drive(400.0, gyro=gyro)
    found, expected = fitted(samples), live(samples, KNOWLEDGE)
    assert found.verdict.summary == expected.verdict.summary
    # Another process may add the same numbers in another order.
    one, other = found.calibration.correction, expected.calibration.correction
    np.testing.assert_allclose(one.parameters, other.parameters, rtol=1e-6, atol=1e-12)
    assert (found.calibration.covariance == expected.calibration.covariance).all()


@pytest.mark.nightly
def test_a_drive_gives_the_same_fit_by_both_functions():
    rng = np.random.default_rng(4)
    car = Robot(strength=48e-6, inclination=math.radians(65.0), noise_force=0.05, noise_rate=2e-3)
    known = knowledge_of(48.0, inclination_deg=65.0)
    way = travel(city(rng, 130.0), rng, rate=10.0)
    samples = list(simulated_drive(way, rng, Vehicle(car))._sensors())
    found, expected = fitted(samples, known), live(samples, known)
    assert Figure.HEADINGS_DRIVEN in found.estimate.figures
    assert found.verdict.summary == expected.verdict.summary
    one, other = found.calibration.correction, expected.calibration.correction
    np.testing.assert_allclose(one.parameters, other.parameters, rtol=1e-6, atol=1e-12)
