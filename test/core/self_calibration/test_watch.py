"""Whether the calibration in force holds, by the fits of a drive."""

import math
from dataclasses import replace

import numpy as np
import pytest
from long_form import first_of
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
from magcal_ros.core.smoother import LikelihoodRatio

RIGHT, FAR = (0.0, 0.0, 0.0), (8e-6, 0.0, 0.0)


def proved(fit, gain=40.0):
    """A fit whose data are likelier than with the calibration in force, at all headings."""
    return replace(fit, ratio=LikelihoodRatio(np.full(12, gain / 12), np.arange(12), 60.0))


def watched(*fits, in_force=None, state=None):
    """The state after fits, each in a job of its own, whose data prove what they differ by."""
    state = Watch() if state is None else state
    for fit in map(proved, fits):
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
    assert not vague.findings


def test_a_refusal_of_the_fits_is_told():
    result = replace(findings(120.0), refusal="an axis of the gyro never changes")
    state = Watch().after(result, calibration())
    assert state.summary == "Not judged yet: an axis of the gyro never changes."


def test_a_right_calibration_holds():
    state = watched(candidate(RIGHT, 120.0))
    assert state.summary == "The calibration holds on the headings of the last minutes."
    later = state.after(findings(180.0), calibration())
    assert later.summary.startswith(
        "The calibration held when it was last judged. Since then: there was"
    )


def test_a_difference_must_be_proved_by_the_data():
    fit = candidate(FAR, 300.0, sigma=math.radians(1.0))
    suspected = Watch().after(findings(300.0, fit), calibration())
    assert not suspected.is_stale
    assert "differ from it, but do not prove a change" in suspected.summary
    stale = watched(candidate(FAR, 360.0, sigma=math.radians(1.0)), state=suspected)
    assert stale.is_stale
    assert stale.summary.startswith("The calibration has not held for about 2 min of driving: ")
    assert "the hard iron has changed (by about +8.0, " in stale.summary
    assert stale.summary.endswith("; calibrate again.")
    swing = math.degrees(8e-6 / LEVEL / math.sqrt(2.0))
    assert stale.findings[0].value == pytest.approx(swing, rel=0.1)


def test_a_difference_at_one_quarter_of_the_headings_is_steel_beside_the_road():
    fit = candidate(FAR, 300.0, sigma=math.radians(1.0))
    sectors = np.tile(np.arange(12), 2)
    for steel in (sectors < 3, sectors % 4 == 0):
        ratio = LikelihoodRatio(np.where(steel, 10.0, 0.0), sectors, 60.0)
        state = Watch().after(findings(300.0, replace(fit, ratio=ratio)), calibration())
        assert state.is_stale == (not steel[:3].all())


def test_only_data_after_the_last_contradiction_withdraw_a_warning():
    stale = watched(candidate(FAR, 320.0, sigma=math.radians(1.0)))
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
    state = watched(with_matrix(matrix, 120.0))
    assert state.is_stale
    assert words in state.summary
    assert "another place" not in state.summary


def test_a_fit_of_all_numbers_names_the_cause_rather_than_one_of_hard_iron():
    everything = with_matrix(rotation_from_rpy(math.radians(6.0), 0.0, 0.0), 120.0)
    iron = candidate(FAR, 120.0, CandidateKind.IRON, sigma=math.radians(0.4))
    found = findings(120.0, proved(everything), since=proved(iron))
    state = Watch().after(found, calibration())
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
    state = watched(at_place(120.0, **place))
    assert state.is_stale
    assert words in state.summary
    assert "another place" in state.summary
    assert "hard iron has changed (" not in state.summary


@pytest.mark.parametrize("iron", [FAR, RIGHT])
def test_a_field_only_at_rest_or_only_in_motion_is_no_change(iron):
    """It is that of a dock or a parked car beside the robot, or that of motors."""
    fit = candidate(iron, 120.0, sigma=math.radians(0.5))
    other = {FAR: RIGHT, RIGHT: FAR}[iron]
    assert not watched(replace(fit, in_motion=calibration(other).correction)).is_stale
    both = watched(replace(fit, in_motion=calibration(FAR).correction))
    assert both.is_stale == (iron is FAR)


def test_a_streets_field_explains_a_difference_of_strength():
    fit = at_place(120.0, strength=1.1 * ROBOT.strength)
    assert watched(fit).is_stale
    fit.calibration.evidence.figures["local_field"] = 6e-6
    assert not watched(fit).is_stale


def test_errors_of_the_stated_size_are_no_change():
    rng = np.random.default_rng(5)
    for sigma in (0.5, 1.0, 2.0):
        sigma = math.radians(sigma)
        for _ in range(120):
            iron = rng.normal(0.0, sigma * LEVEL, 2)
            fit = candidate((*iron, 0.0), 120.0, sigma=sigma)
            # The log likelihood ratio over the right calibration, which is off by chance.
            fit = proved(fit, 0.5 * float(iron @ iron) / (sigma * LEVEL) ** 2)
            assert not Watch().after(findings(120.0, fit), calibration()).is_stale


def test_an_uncertain_calibration_is_judged_by_its_sigma():
    poor = calibration(sigma=math.radians(3.0))
    off = candidate((3.5e-6, 0.0, 0.0), 120.0, sigma=math.radians(0.5))
    assert watched(off).is_stale
    assert not watched(off, in_force=poor).is_stale


class TestInTheMachine:
    def test_a_proposal_does_not_end_the_warning_before_it_is_accepted(self):
        machine = SelfCalibration(Mode.PROPOSE)
        machine.put_in_force(calibration())
        machine.proposal = calibration(FAR)
        job = machine.job(BOSTON)
        assert job.watched is not job.in_force
        fit = proved(candidate(FAR, 120.0, sigma=math.radians(1.0)))
        machine.note(findings(120.0, fit))
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
        "case",
        first_of(
            [
                *((3, 145.0, None, 1.0), (3, 145.0, 0.0, 1.0)),
                *((5, 255.0, None, 1.0), (5, 255.0, 40.0, 1.0), (5, 255.0, 40.0, 0.0)),
            ],
            2,
        ),
    )
    def test_a_drive_without_self_calibration_is_watched(self, case):
        """Iron is added after some seconds, or never; the last gyro measures about z alone."""
        seed, seconds, added, gyro = case
        irons = () if added is None else (Iron((10e-6, 0.0, 0.0), added),)
        drive = driven(seed, city(np.random.default_rng(seed), seconds), irons=irons)
        drive = replace(drive, rate=drive.rate * [gyro, gyro, 1.0])
        machine = SelfCalibration(Mode.OFF)
        machine.put_in_force(calibration())
        assert follow(drive, machine) == []
        assert machine.in_words == "off"
        assert machine.watch.findings or irons
        assert machine.watch.is_stale == bool(irons)
