"""Whether the calibration in force holds, by the fits of a drive."""

import math
from dataclasses import replace

import numpy as np
import pytest
from simulated.drive import Iron
from simulated.legs import city
from test_self_calibration import (
    BOSTON,
    LEVEL,
    ROBOT,
    calibration,
    candidate,
    driven,
    findings,
    follow,
)

from magcal_ros.core import Correction
from magcal_ros.core.geometry import rotation_from_rpy
from magcal_ros.core.self_calibration import CandidateKind, Mode, SelfCalibration, Watch

RIGHT, FAR = (0.0, 0.0, 0.0), (8e-6, 0.0, 0.0)


def watched(*fits, in_force=None, state=None):
    """The state after fits, each in a job of its own."""
    state = Watch() if state is None else state
    for fit in fits:
        state = state.after(findings(fit.end, fit), in_force or calibration())
    return state


def with_matrix(matrix, end):
    """A fit that differs from the true calibration by a matrix."""
    fit = candidate(RIGHT, end, sigma=math.radians(0.5))
    old = fit.calibration.correction
    changed = Correction(matrix @ old.matrix, old.hard_iron)
    return replace(fit, calibration=replace(fit.calibration, correction=changed))


def at_place(end, **place):
    """A fit in a place of another field, with the same hard iron."""
    fit = candidate(RIGHT, end, sigma=math.radians(0.5))
    return replace(fit, calibration=replace(fit.calibration, **place))


def test_nothing_is_judged_without_a_conclusive_fit():
    assert Watch().summary == "Not judged yet: the robot has not driven with a gyro yet."
    vague = watched(candidate(FAR, 120.0, sigma=math.radians(9.0)))
    assert vague.summary == "Not judged yet: there was too little driving over different headings."
    assert not vague.was_judged


def test_a_refusal_of_the_fits_is_told():
    result = replace(findings(120.0), refusal="an axis of the gyro never changes")
    state = Watch().after(result, calibration())
    assert state.summary == "Not judged yet: an axis of the gyro never changes."


def test_a_right_calibration_holds():
    state = watched(candidate(RIGHT, 120.0))
    assert state.summary == "The calibration holds on the headings of the last minutes."
    later = state.after(findings(180.0), calibration())
    assert later.summary.startswith("The calibration held when it was last judged; now there was")


def test_two_fits_must_contradict_it():
    once = watched(candidate(FAR, 300.0, sigma=math.radians(1.0)))
    assert not once.is_stale
    assert "a second fit must confirm a change" in once.summary
    twice = watched(candidate(FAR, 360.0, sigma=math.radians(1.0)), state=once)
    assert twice.is_stale
    assert twice.summary.startswith("The calibration has not held for about 3 min of driving: ")
    assert "the hard iron has changed (by about +8.0, " in twice.summary
    assert twice.summary.endswith("; calibrate again.")
    swing = math.degrees(8e-6 / LEVEL / math.sqrt(2.0))
    assert twice.findings[0].value == pytest.approx(swing, rel=0.1)


def test_only_data_after_the_last_contradiction_withdraw_a_warning():
    stale = watched(*(candidate(FAR, end, sigma=math.radians(1.0)) for end in (300.0, 320.0)))
    mixed = watched(candidate(RIGHT, 430.0, seconds=120.0), state=stale)
    assert mixed.is_stale
    assert not watched(candidate(RIGHT, 440.0, seconds=120.0), state=mixed).is_stale


@pytest.mark.parametrize(
    ("matrix", "words"),
    [
        (rotation_from_rpy(math.radians(6.0), 0.0, 0.0), "the mounting has changed"),
        (np.diag([1.15, 0.87, 1.0]), "the soft iron has changed"),
    ],
)
def test_the_cause_is_named(matrix, words):
    state = watched(*(with_matrix(matrix, end) for end in (120.0, 140.0)))
    assert state.is_stale
    assert words in state.summary
    assert "another place" not in state.summary


def test_a_fit_of_all_numbers_names_the_cause_rather_than_one_of_hard_iron():
    everything = with_matrix(rotation_from_rpy(math.radians(6.0), 0.0, 0.0), 120.0)
    iron = candidate(FAR, 120.0, CandidateKind.IRON, sigma=math.radians(0.4))
    state = Watch()
    for _ in range(2):
        state = state.after(findings(120.0, everything, since=iron), calibration())
    assert "the mounting has changed" in state.summary


@pytest.mark.parametrize(
    ("place", "words"),
    [
        (
            {"strength": 1.2 * ROBOT.strength},
            "field strength differs from the calibrated one by 20",
        ),
        ({"inclination": ROBOT.inclination - math.radians(12.0)}, "inclination differs"),
    ],
)
def test_another_place_is_named(place, words):
    state = watched(*(at_place(end, **place) for end in (120.0, 140.0)))
    assert state.is_stale
    assert words in state.summary
    assert "another place" in state.summary
    assert "hard iron has changed (" not in state.summary


@pytest.mark.parametrize("iron", [FAR, RIGHT])
def test_a_field_only_at_rest_or_only_in_motion_is_no_change(iron):
    """It is that of a dock or a parked car beside the robot, or that of motors."""
    fits = [candidate(iron, end, sigma=math.radians(0.5)) for end in (120.0, 140.0)]
    other = {FAR: RIGHT, RIGHT: FAR}[iron]
    in_motion = calibration(other).correction
    assert not watched(*(replace(fit, in_motion=in_motion) for fit in fits)).is_stale
    assert watched(
        *(replace(fit, in_motion=calibration(FAR).correction) for fit in fits)
    ).is_stale == (iron is FAR)


def test_a_streets_field_explains_a_difference_of_strength():
    fits = [at_place(end, strength=1.1 * ROBOT.strength) for end in (120.0, 140.0)]
    assert watched(*fits).is_stale
    for fit in fits:
        fit.calibration.evidence.figures["local_field"] = 6e-6
    assert not watched(*fits).is_stale


def test_errors_of_the_stated_size_are_no_change():
    rng = np.random.default_rng(5)
    for sigma in (0.5, 1.0, 2.0):
        sigma = math.radians(sigma)
        for _ in range(60):
            fits = [
                candidate((*rng.normal(0.0, sigma * LEVEL, 2), 0.0), 120.0 + k, sigma=sigma)
                for k in range(2)
            ]
            assert not watched(*fits).is_stale


def test_an_uncertain_calibration_is_judged_by_its_sigma():
    poor = calibration(sigma=math.radians(3.0))
    off = [candidate((3.5e-6, 0.0, 0.0), end, sigma=math.radians(0.5)) for end in (120.0, 140.0)]
    assert watched(*off).is_stale
    assert not watched(*off, in_force=poor).is_stale


class TestInTheMachine:
    def test_a_proposal_does_not_end_the_warning_before_it_is_accepted(self):
        machine = SelfCalibration(Mode.PROPOSE)
        machine.put_in_force(calibration())
        machine.proposal = calibration(FAR)
        for clock in (120.0, 140.0):
            machine.job(BOSTON)
            machine.note(findings(clock, candidate(FAR, clock, sigma=math.radians(1.0))))
        assert machine.watch.is_stale
        machine.put_in_force(machine.proposal)
        assert not machine.watch.is_stale

    def test_data_from_before_a_calibration_of_the_user_do_not_count(self):
        machine = SelfCalibration(Mode.OFF)
        machine.put_in_force(calibration())
        follow(driven(3, city(np.random.default_rng(3), 40.0)), machine)
        assert machine.job(BOSTON).changed == -math.inf
        machine.put_in_force(calibration(FAR))
        assert machine.job(BOSTON).changed == machine.recorder.clock > 0.0

    @pytest.mark.parametrize(
        ("added", "gyro"),
        [(0.0, 1.0), (10e-6, 1.0), pytest.param(10e-6, 0.0, marks=pytest.mark.nightly)],
    )
    def test_a_drive_without_self_calibration_is_watched(self, added, gyro):
        """The last case has a gyro that measures about z alone."""
        irons = (Iron((added, 0.0, 0.0), 40.0),) if added else ()
        drive = driven(5, city(np.random.default_rng(5), 255.0), irons=irons)
        drive = replace(drive, rate=drive.rate * [gyro, gyro, 1.0])
        machine = SelfCalibration(Mode.OFF)
        machine.put_in_force(calibration())
        assert follow(drive, machine) == []
        assert machine.in_words == "off"
        assert machine.watch.was_judged or added
        assert machine.watch.is_stale == bool(added)
