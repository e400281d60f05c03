"""The guided half minute in virtual time."""

import numpy as np
import pytest

from magcal_ros.core.doctor import Guide, GuideStep
from magcal_ros.core.samples import FieldSample, ImuSample
from magcal_ros.core.simulation import Ride, Robot

PERIOD = 0.01


class Person:
    def __init__(self, spoil=lambda sample: sample):
        self.ride = Ride(Robot(), np.random.default_rng(1), start=0.0)
        self.guide = Guide(0.0)
        self.now = 0.0
        self.spoil = spoil

    def does(self, seconds, rate=0.0, pitch=0.0):
        for _ in range(round(seconds / PERIOD)):
            for sample in self.ride.step(rate, tipping=np.array([0.0, pitch, 0.0])):
                self.guide.add(self.spoil(sample))
            self.now += PERIOD
            self.guide.pass_time(self.now)

    def does_all(self):
        self.does(6.0)
        self.does(2.5, rate=0.8)
        self.does(2.0)
        self.does(1.0, pitch=-0.35)
        self.does(2.0)


def scaled(factor):
    def spoil(sample):
        if isinstance(sample, ImuSample):
            return sample._replace(rate=tuple(factor * value for value in sample.rate))
        return sample

    return spoil


def in_other_units(sample):
    if isinstance(sample, FieldSample):
        return sample._replace(field=tuple(1e6 * value for value in sample.field))
    return sample._replace(force=tuple(-value / 9.81 for value in sample.force))


@pytest.mark.parametrize(
    "spoil",
    [
        lambda sample: sample,
        scaled(-1.0),
        scaled(57.3),
        scaled(0.0),
        scaled(float("nan")),
        in_other_units,
    ],
    ids=["good", "mirrored", "degrees", "dead", "no gyro", "other units"],
)
def test_the_steps_are_detected_with_any_wrong_sensor(spoil):
    person = Person(spoil)
    assert person.guide.current is GuideStep.STAND
    person.does_all()
    assert list(person.guide.ended.values()) == [True, True, True]
    assert person.guide.current is None
    assert person.guide.turned_left is True


def test_the_steps_follow_one_another():
    person = Person()
    person.does(6.0)
    assert person.guide.current is GuideStep.TURN
    person.does(0.6, rate=0.8)
    person.does(3.0)
    assert person.guide.current is GuideStep.TURN  # 27° are too little
    person.does(2.0, rate=0.8)
    assert person.guide.current is GuideStep.TURN  # it has not stopped
    person.does(2.0)
    assert person.guide.current is GuideStep.LIFT


@pytest.mark.parametrize("spoil", [lambda sample: sample, scaled(0.0)], ids=["good", "no gyro"])
def test_a_slow_turn_ends_when_the_robot_stops(spoil):
    person = Person(spoil)
    person.does(6.0)
    person.does(25.0, rate=0.2)
    assert person.guide.current is GuideStep.TURN
    person.does(2.0)
    assert person.guide.current is GuideStep.LIFT


def test_a_step_that_is_not_done_ends_and_is_reported():
    person = Person()
    person.does(60.0)
    person.does(60.0)
    assert list(person.guide.ended.values()) == [True, False, False]
    assert person.guide.turned_left is None


def test_a_step_ends_without_samples_too():
    guide = Guide(0.0)
    for tick in range(1000):
        guide.pass_time(0.3 * tick)
    assert list(guide.ended.values()) == [False, False, False]


def test_a_step_can_be_skipped_and_gives_its_remaining_time():
    person = Person()
    person.guide.skip(0.0)
    assert person.guide.current is GuideStep.STAND  # nothing is detected without it
    person.does(6.0)
    assert person.guide.current is GuideStep.TURN
    assert 30.0 < person.guide.left(6.0) <= 45.0
    person.guide.skip(6.0)
    assert person.guide.current is GuideStep.LIFT
    person.guide.skip(6.0)
    assert person.guide.current is None
