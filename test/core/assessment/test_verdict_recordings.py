"""The verdict on recorded turns; skipped without the recordings."""

import functools
import math

import numpy as np
import pytest
from long_form import first_of

from magcal_ros.core import Belief, Grade, Knowledge, ReferenceField, Window, calibrate

UNKNOWN = Knowledge()


def knowledge(microtesla, degrees):
    """Return the field of a world magnetic model."""
    strength = Belief(microtesla * 1e-6, 0.03 * microtesla * 1e-6)
    return Knowledge(ReferenceField(strength, Belief(math.radians(degrees), math.radians(1.0))))


@functools.cache
def table(path):
    return np.genfromtxt(path, delimiter=",", skip_header=1)


def window(folder, first=-math.inf, last=math.inf, added=0.0):
    imu, mag = (table(folder / f"{part}.csv") for part in ("imu", "mag"))
    rows = (mag[:, 0] >= first) & (mag[:, 0] <= last)
    time = mag[rows, 0]
    motion = np.column_stack([np.interp(time, imu[:, 0], imu[:, c]) for c in range(1, 7)])
    rate = motion[:, 3:] if np.isfinite(motion[:, 3:]).all() else None
    return Window(time, mag[rows, 1:4] + added, motion[:, :3], rate)


def refused(verdict):
    return " ".join(c.words for c in verdict.checks if c.grade is Grade.REFUSED)


class TestHandHeldTurn:
    """A turn by hand that wobbles to 20 degrees."""

    known = knowledge(44.3, 69.6)

    @pytest.fixture
    def turn(self, recording):
        return window(recording("broad05"), 48.0, 62.0, np.array([20e-6, -15e-6, 12e-6]))

    @pytest.mark.nightly
    def test_it_is_accepted(self, turn):
        assert calibrate(turn, self.known).verdict.accepted

    @pytest.mark.nightly
    def test_it_is_accepted_without_a_reference(self, turn):
        assert calibrate(turn, UNKNOWN).verdict.accepted

    @pytest.mark.nightly
    def test_the_whole_recording_is_a_turn_and_not_a_drive(self, recording):
        verdict = calibrate(window(recording("broad05")), self.known).verdict
        assert verdict.accepted
        assert "of movement" not in verdict.summary

    @pytest.mark.nightly
    def test_axes_unlike_those_of_the_imu_are_refused(self, turn):
        swapped = Window(
            turn.time, turn.field[:, [1, 0, 2]], turn.specific_force, turn.angular_rate
        )
        verdict = calibrate(swapped, self.known).verdict
        assert not verdict.accepted
        assert "axes" in refused(verdict)

    @pytest.mark.nightly
    def test_a_mirrored_gyro_is_refused(self, turn):
        mirrored = Window(turn.time, turn.field, turn.specific_force, -turn.angular_rate)
        verdict = calibrate(mirrored, self.known).verdict
        assert not verdict.accepted
        assert "the gyro's axes do not match the accelerometer's: x and y and z" in refused(verdict)

    @pytest.mark.nightly
    def test_a_board_upside_down_is_refused(self, turn):
        flip = np.array([1.0, -1.0, -1.0])
        flipped = Window(
            turn.time, turn.field * flip, turn.specific_force * flip, turn.angular_rate * flip
        )
        verdict = calibrate(flipped, self.known).verdict
        assert not verdict.accepted
        assert "z points down" in refused(verdict)

    @pytest.mark.nightly
    def test_acceleration_published_as_gravity_is_refused(self, turn):
        negated = Window(turn.time, turn.field, -turn.specific_force, turn.angular_rate)
        assert not calibrate(negated, self.known).verdict.accepted

    @pytest.mark.parametrize("seconds", first_of([1.5, 0.7]))
    def test_a_short_arc_is_refused_or_warned_of(self, turn, seconds):
        start = turn.time[0] + 5.0
        piece = turn.take((turn.time >= start) & (turn.time <= start + seconds))
        verdict = calibrate(piece, self.known).verdict
        assert verdict.confidence.rank >= Grade.WARN.rank

    @pytest.mark.nightly
    def test_a_unit_of_gravity_is_named(self, turn):
        in_g = Window(turn.time, turn.field, turn.specific_force / 9.7, turn.angular_rate)
        verdict = calibrate(in_g, self.known).verdict
        assert any("looks like g published" in check.words for check in verdict.checks)

    @pytest.mark.nightly
    @pytest.mark.parametrize("known", [known, UNKNOWN])
    def test_a_unit_of_field_is_named(self, turn, known):
        gauss = Window(turn.time, turn.field * 1e4, turn.specific_force, turn.angular_rate)
        verdict = calibrate(gauss, known).verdict
        assert verdict.quality.rank >= Grade.WARN.rank
        assert any("looks like gauss" in check.words for check in verdict.checks)


@pytest.mark.nightly
def test_a_car_in_circles_is_not_refused(recording):
    verdict = calibrate(
        window(recording("car_circles_neu2025_kiran")), knowledge(51.5, 66.5)
    ).verdict
    assert verdict.accepted
    assert verdict.quality.rank <= Grade.WARN.rank


@pytest.mark.nightly
def test_a_boat_that_turns_level_is_not_refused(recording):
    verdict = calibrate(window(recording("sailboat_lsm303_level")), UNKNOWN).verdict
    assert verdict.accepted
    assert any("no gyro" in text for text in verdict.not_shown)


@pytest.mark.parametrize("known", first_of([knowledge(48.0, 65.0), UNKNOWN], 0))
def test_a_boat_that_rolls_but_does_not_turn_is_refused(recording, known):
    assert not calibrate(window(recording("sailboat_lsm303_roll")), known).verdict.accepted
