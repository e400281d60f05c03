"""What road says of two calibrations, one of them fitted anew on the way."""

import math

import numpy as np
import pytest

from magcal_ros.core.keeping.candidates import Kind
from magcal_ros.core.keeping.jobs import Step
from magcal_ros.core.keeping.proving import prove
from magcal_ros.core.knowledge import knowledge_of
from magcal_ros.core.samples.window import Window
from magcal_ros.core.simulation.drive import Vehicle, simulated_drive
from magcal_ros.core.simulation.legs import city
from magcal_ros.core.simulation.simulator import Robot
from magcal_ros.core.simulation.travel import travel
from magcal_ros.core.smoothing.log import log_of

BOSTON = knowledge_of(51.3, inclination_deg=66.3)
ROBOT = Robot(strength=51.3e-6, inclination=math.radians(66.3), noise_field=0.3e-6)
RIGHT = ROBOT.true_correction
OLD, WORSE = (
    Vehicle(ROBOT).with_iron(np.array([0.0, iron, 0.0])).robot.true_correction
    for iron in (15e-6, 30e-6)
)


@pytest.fixture(scope="module")
def road():
    rng = np.random.default_rng(4)
    drive = simulated_drive(travel(city(rng, 120.0), rng, rate=10.0), rng, Vehicle(ROBOT))
    window = Window(drive.time, drive.field, drive.force, drive.rate)
    return log_of(window).nodes(np.eye(3))


def test_the_right_one_explains_the_road_in_both_halves(road):
    proof = prove(road, OLD, (Step(road.time[0], RIGHT),), BOSTON)
    assert proof.likelihood > 10.0
    assert min(proof.halves) > 5.0
    assert "quieter" in proof.stands(kind=Kind.IRON)


def test_road_before_the_first_fit_does_not_count(road):
    proof = prove(road, OLD, (Step(road.time[-1] - 30.0, RIGHT),), BOSTON)
    assert proof.seconds < 30.0
    assert prove(road, OLD, (Step(road.time[-1], RIGHT),), BOSTON).seconds == 0.0


def test_a_fit_counts_only_for_the_road_after_it(road):
    middle = 0.5 * (road.time[0] + road.time[-1])
    first, last = Step(road.time[0], WORSE), Step(middle, RIGHT)
    both = prove(road, OLD, (first, last), BOSTON).likelihood
    assert prove(road, OLD, (first,), BOSTON).likelihood < both
    assert both < prove(road, OLD, (first._replace(correction=RIGHT),), BOSTON).likelihood
