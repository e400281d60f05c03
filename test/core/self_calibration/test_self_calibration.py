"""Self-calibration: candidates, probation, the calibration in force, and its return."""

import math
from dataclasses import replace

import numpy as np
import pytest
from remembered import remembered
from simulated.drive import Iron, Vehicle, simulated_drive
from simulated.legs import Leg, city
from simulated.travel import travel

from magcal_ros.core import Calibration
from magcal_ros.core.calibration import Evidence, predicted_heading_sigma
from magcal_ros.core.geometry import rotation_from_rpy, yaw_from_up_and_field
from magcal_ros.core.knowledge import knowledge_of
from magcal_ros.core.samples import FieldSample, ImuSample, Pair
from magcal_ros.core.self_calibration import (
    CandidateKind,
    DecisionKind,
    DriveCandidate,
    DriveResult,
    Mode,
    SelfCalibration,
    difference,
    examine_drive,
    reason_to_accept,
)
from magcal_ros.core.simulation import Robot
from magcal_ros.core.smoother import LikelihoodRatio

BOSTON = knowledge_of(51.3, inclination_deg=66.3)
ROBOT = Robot(
    strength=51.3e-6,
    inclination=math.radians(66.3),
    noise_force=0.05,
    noise_rate=2e-3,
    noise_field=0.3e-6,
)
LEVEL = 51.3e-6 * math.cos(math.radians(66.3))


def ratio(first, second=0.0, sectors=12):
    """A likelihood ratio of so much in each half of a drive over this many headings."""
    halves = np.repeat([first, second], 36) / 36.0
    return LikelihoodRatio(halves, np.arange(72) % sectors, 60.0)


PROVED = ratio(9.0, 11.0)


def calibration(iron=(0.0, 0.0, 0.0), sigma=math.radians(0.8), method="maximum_likelihood"):
    """The true one with another hard iron, tesla, and a heading sigma, radians."""
    covariance = np.zeros((12, 12))
    covariance[9:, 9:] = np.eye(3) * (sigma * LEVEL) ** 2
    correction = Vehicle(ROBOT).with_iron(np.array(iron)).robot.true_correction
    evidence = Evidence(method, "good", "good", "")
    return Calibration(
        correction, covariance, 5e-7, 0.01, ROBOT.strength, ROBOT.inclination, evidence
    )


def candidate(iron, end, kind=CandidateKind.ALL, sigma=math.radians(2.0), sectors=9, seconds=120.0):
    found = calibration(iron, sigma, "smoother")
    found.evidence.figures.update(headings_driven=float(sectors), heading_sigma=sigma)
    return DriveCandidate(kind, found, end - seconds, end)


def findings(clock, *candidates, since=None, **ratios):
    named = {CandidateKind(name): each for name, each in ratios.items()}
    return DriveResult(clock, candidates, since, named)


class CalibrationStore:
    """A state machine that receives results as if it had requested them."""

    def __init__(self, in_force=None, mode=Mode.APPLY):
        self.machine = SelfCalibration(mode)
        self.machine.put_in_force(in_force)

    def note(self, found):
        self.machine.job(BOSTON)
        made = self.machine.note(found)
        for decision in made:
            if decision.is_change:
                self.machine.put_in_force(decision.calibration)
        return [decision.kind for decision in made]


FAR = (6e-6, 0.0, 0.0)
SLIGHT = (0.1e-6, 0.0, 0.0)


def test_headings_differ_by_the_iron_over_the_level_field():
    apart = difference(calibration(), calibration((0.5e-6, 0.0, 0.0)))
    assert apart == pytest.approx(0.5e-6 / LEVEL / math.sqrt(2.0), rel=0.05)
    assert predicted_heading_sigma(calibration(sigma=0.02)) == pytest.approx(0.02, rel=0.1)


def test_two_agreeing_windows_give_the_first_calibration():
    keeper = CalibrationStore()
    assert keeper.note(findings(120.0, candidate((0.0, 0.0, 0.0), 120.0))) == [
        DecisionKind.PROBATION
    ]
    assert keeper.note(findings(140.0, candidate((0.4e-6, 0.0, 0.0), 140.0))) == [
        DecisionKind.APPLIED
    ]


def test_a_second_window_confirms_the_first_in_these_words():
    keeper = CalibrationStore()
    machine = keeper.machine
    keeper.note(findings(120.0, candidate((0.0, 0.0, 0.0), 120.0)))
    assert machine.decisions[-1].words.endswith("; a second one that agrees confirms it")
    keeper.note(findings(140.0, candidate((0.4e-6, 0.0, 0.0), 140.0)))
    words = machine.decisions[-1].words
    assert "it agrees with the fit before it (0." in words
    assert words.endswith("° apart), and no calibration was in force")


def test_two_disagreeing_windows_give_no_calibration():
    keeper = CalibrationStore()
    keeper.note(findings(120.0, candidate((0.0, 0.0, 0.0), 120.0)))
    assert keeper.note(findings(140.0, candidate(FAR, 140.0))) == []
    assert keeper.note(findings(160.0, candidate(FAR, 160.0))) == [DecisionKind.APPLIED]


def test_an_uncertain_candidate_is_not_used():
    keeper = CalibrationStore()
    for clock in (120.0, 140.0, 160.0):
        assert keeper.note(findings(clock, candidate(FAR, clock, sigma=math.radians(4.0)))) == []


def test_a_different_candidate_goes_on_probation_first():
    keeper = CalibrationStore(calibration())
    assert keeper.note(findings(120.0, candidate(FAR, 120.0))) == [DecisionKind.PROBATION]
    assert keeper.note(findings(140.0, all=ratio(0.0))) == []
    assert keeper.note(findings(180.0, all=PROVED)) == [DecisionKind.APPLIED]


def test_an_unproved_candidate_is_dropped_after_a_time():
    keeper = CalibrationStore(calibration())
    keeper.note(findings(120.0, candidate(FAR, 120.0)))
    assert keeper.note(findings(370.0, all=ratio(0.0))) == [DecisionKind.DROPPED]


def proved(fit, by=PROVED):
    """A fit whose own data are likelier than with the calibration in force."""
    return replace(fit, ratio=by)


def test_of_iron_on_probation_the_newest_fit_is_put_in_force():
    keeper = CalibrationStore(calibration())
    first, last = (
        candidate(iron, clock, CandidateKind.IRON, math.radians(sigma))
        for iron, clock, sigma in ((FAR, 120.0, 2.5), ((8e-6, 0.0, 0.0), 140.0, 2.0))
    )
    assert keeper.note(findings(120.0, since=first)) == [DecisionKind.NOTICED]
    assert keeper.note(findings(140.0, since=proved(last, ratio(0.0)))) == []
    assert keeper.note(findings(140.0, since=proved(last))) == [DecisionKind.APPLIED]
    assert keeper.machine.decisions[-1].calibration.correction is last.calibration.correction


def test_iron_that_is_proved_at_once_is_reported_and_put_in_force():
    keeper = CalibrationStore(calibration())
    came = proved(candidate((10e-6, 0.0, 0.0), 120.0, CandidateKind.IRON))
    assert keeper.note(findings(120.0, since=came)) == [DecisionKind.NOTICED, DecisionKind.APPLIED]


def test_a_proved_change_of_iron_waits_until_it_is_plain():
    keeper = CalibrationStore(calibration())
    vague, clear = (
        proved(candidate((10e-6, 0.0, 0.0), clock, CandidateKind.IRON, math.radians(sigma)))
        for clock, sigma in ((140.0, 5.5), (160.0, 3.5))
    )
    assert keeper.note(findings(140.0, since=vague)) == []
    made = keeper.note(findings(160.0, since=clear))
    assert made == [DecisionKind.NOTICED, DecisionKind.APPLIED]


def test_removed_iron_restores_the_previous_calibration():
    old = calibration()
    keeper = CalibrationStore(old)
    came = candidate((10e-6, 0.0, 0.0), 120.0, CandidateKind.IRON)
    keeper.note(findings(120.0, since=came))
    keeper.note(findings(140.0, since=proved(came)))
    keeper.note(findings(460.0, earlier=ratio(0.0)))
    went = candidate((0.5e-6, 0.0, 0.0), 900.0, CandidateKind.IRON)
    assert keeper.note(findings(900.0, since=went)) == [DecisionKind.NOTICED]
    assert keeper.machine.job(BOSTON).contests[CandidateKind.EARLIER].end == went.start
    keeper.machine.fail()
    assert keeper.note(findings(910.0, earlier=PROVED)) == [DecisionKind.ROLLED_BACK]
    assert keeper.machine.decisions[-1].calibration.correction is old.correction
    assert keeper.machine.job(BOSTON).changed == went.start


def test_a_proposal_is_made_once():
    keeper = CalibrationStore(calibration(), Mode.PROPOSE)
    came = candidate((10e-6, 0.0, 0.0), 120.0, CandidateKind.IRON)
    keeper.note(findings(120.0, since=came))
    assert keeper.note(findings(140.0, since=proved(came))) == [DecisionKind.PROPOSED]
    assert keeper.note(findings(160.0, since=came)) == []


def test_with_nothing_in_force_it_is_proposed_once():
    keeper = CalibrationStore(mode=Mode.PROPOSE)
    keeper.note(findings(120.0, sized((0.0, 0.0, 0.0), 120.0, 2.0)))
    assert keeper.note(findings(140.0, sized(SLIGHT, 140.0, 2.0))) == [DecisionKind.PROPOSED]
    for clock in (160.0, 180.0, 200.0):
        assert keeper.note(findings(clock, sized(SLIGHT, clock, 1.8))) == []
    assert keeper.machine.proposal is not None


def test_the_next_proposal_must_be_better_than_the_pending_one():
    keeper = CalibrationStore(calibration(FAR), Mode.PROPOSE)
    keeper.note(findings(120.0, sized((0.0, 0.0, 0.0), 120.0, 2.0)))
    assert keeper.note(findings(180.0, all=PROVED)) == [DecisionKind.PROPOSED]
    machine = keeper.machine
    # Fits and proofs are against the proposal from now on, not against what is in force.
    assert machine.job(BOSTON).in_force is machine.proposal
    machine.fail()
    assert keeper.note(findings(200.0, sized(SLIGHT, 200.0, 1.9))) == []
    assert keeper.note(findings(220.0, sized((-6e-6, 0.0, 0.0), 220.0, 1.9))) == [
        DecisionKind.PROBATION
    ]
    assert "from what is proposed" in machine.decisions[-1].words


def test_a_proposal_is_withdrawn_if_the_calibration_in_force_is_better():
    old = calibration()
    keeper = CalibrationStore(old, Mode.PROPOSE)
    keeper.note(findings(120.0, candidate(FAR, 120.0)))
    keeper.note(findings(180.0, all=PROVED))
    earlier = keeper.machine.job(BOSTON).contests[CandidateKind.EARLIER]
    assert earlier.calibration is old
    keeper.machine.fail()
    assert keeper.note(findings(260.0, earlier=PROVED)) == [DecisionKind.DROPPED]
    assert keeper.machine.proposal is None
    assert keeper.machine.decisions[-1].calibration is None


def sized(iron, end, sigma_deg, seconds=120.0):
    return candidate(iron, end, sigma=math.radians(sigma_deg), seconds=seconds)


def test_a_much_more_certain_candidate_that_agrees_is_used():
    keeper = CalibrationStore(calibration(sigma=math.radians(10.7)))
    assert keeper.note(findings(120.0, sized(FAR, 120.0, 2.9))) == [DecisionKind.APPLIED]
    longer = sized((4e-6, 0.0, 0.0), 420.0, 1.3, 420.0)
    assert keeper.note(findings(420.0, longer)) == [DecisionKind.REFINED]


def test_a_calibration_on_probation_keeps_no_rough_one_in_force():
    keeper = CalibrationStore(calibration((20e-6, 0.0, 0.0), sigma=math.radians(4.0)))
    assert keeper.note(findings(120.0, sized((0.0, 0.0, 0.0), 120.0, 2.9))) == [
        DecisionKind.PROBATION
    ]
    near = sized((17e-6, 0.0, 0.0), 140.0, 2.0)
    assert keeper.note(findings(140.0, near)) == [DecisionKind.APPLIED]


def test_a_contradicting_candidate_goes_on_probation_even_against_a_rough_one():
    keeper = CalibrationStore(calibration(sigma=math.radians(5.0)))
    assert keeper.note(findings(120.0, sized((12e-6, 0.0, 0.0), 120.0, 2.0))) == [
        DecisionKind.PROBATION
    ]


@pytest.mark.parametrize(("sigma", "made"), [(1.3, []), (0.8, [DecisionKind.REFINED])])
def test_a_good_calibration_is_refined_only_by_a_much_more_certain_one(sigma, made):
    keeper = CalibrationStore()
    keeper.note(findings(120.0, sized((0.0, 0.0, 0.0), 120.0, 1.5)))
    keeper.note(findings(140.0, sized((0.0, 0.0, 0.0), 140.0, 1.5)))
    assert keeper.note(findings(420.0, sized((0.3e-6, 0.0, 0.0), 420.0, sigma, 400.0))) == made


def test_an_agreeing_candidate_changes_nothing():
    keeper = CalibrationStore(calibration())
    assert keeper.note(findings(120.0, candidate((0.3e-6, 0.0, 0.0), 120.0))) == []


def test_the_old_calibration_returns_if_it_was_better():
    old = calibration()
    keeper = CalibrationStore(old)
    keeper.note(findings(120.0, candidate(FAR, 120.0)))
    keeper.note(findings(180.0, all=PROVED))
    assert keeper.note(findings(260.0, earlier=PROVED)) == [DecisionKind.ROLLED_BACK]
    assert keeper.machine.decisions[-1].calibration.correction is old.correction
    assert keeper.note(findings(280.0, earlier=PROVED)) == []


def test_a_trial_ends():
    keeper = CalibrationStore(calibration())
    keeper.note(findings(120.0, candidate(FAR, 120.0)))
    keeper.note(findings(180.0, all=PROVED))
    assert keeper.note(findings(500.0, earlier=ratio(0.0))) == [DecisionKind.CONFIRMED]


def test_a_proposal_waits_for_the_user():
    old = calibration()
    keeper = CalibrationStore(old, Mode.PROPOSE)
    keeper.note(findings(120.0, candidate(FAR, 120.0)))
    assert keeper.note(findings(180.0, all=PROVED)) == [DecisionKind.PROPOSED]
    machine = keeper.machine
    assert machine.proposal is machine.decisions[-1].calibration
    assert "accept" in machine.in_words
    machine.put_in_force(machine.proposal.accepted_by_person())
    assert machine.proposal is None
    assert keeper.note(findings(260.0, earlier=PROVED)) == [DecisionKind.PROPOSED]
    assert machine.proposal.correction is old.correction


def test_results_for_another_calibration_are_ignored():
    keeper = CalibrationStore()
    machine = keeper.machine
    keeper.note(findings(120.0, candidate(FAR, 120.0)))
    machine.job(BOSTON)
    machine.put_in_force(calibration())
    assert machine.note(findings(140.0, candidate(FAR, 140.0))) == []


def test_a_lost_job_is_repeated():
    machine = SelfCalibration()
    machine.job(BOSTON)
    machine.fail()
    assert machine.note(findings(120.0, candidate(FAR, 120.0))) == []
    machine.job(BOSTON)
    assert machine.note(findings(140.0, candidate(FAR, 140.0))) != []


def test_the_wait_grows_with_each_lost_job():
    machine, due = SelfCalibration(), []
    for k in range(20 * 400):
        # A robot that drives in a circle, so that all of it counts as movement.
        yaw = 0.3 * 0.05 * k
        field = (20e-6 * math.cos(yaw), -20e-6 * math.sin(yaw), -40e-6)
        stamp = 100.0 + 0.05 * k
        imu = ImuSample(stamp, (0.0, 0.0, 9.81), (0.0, 0.0, 0.3))
        if machine.add(Pair(FieldSample(stamp, field), imu), 1.0):
            due.append(0.05 * k)
            machine.job(BOSTON)
            machine.fail()
    waits = np.diff(due)
    assert len(waits) >= 3
    assert np.allclose(waits[1:] / waits[:-1], 2.0, atol=0.1)
    machine.job(BOSTON)
    machine.note(findings(400.0, candidate(FAR, 400.0)))
    assert machine.lost == 0


@pytest.mark.parametrize("kind", list(CandidateKind))
def test_evidence_of_one_quarter_of_headings_does_not_prove_a_fit(kind):
    """Steel on one side of the roads explains it; an earlier calibration it does not imitate."""
    is_earlier = kind is CandidateKind.EARLIER
    assert bool(reason_to_accept(kind, ratio(900.0, 1100.0, sectors=3))) is is_earlier
    assert reason_to_accept(kind, ratio(9.0, 11.0))


@pytest.mark.parametrize(
    ("proof", "stands"),
    [
        (LikelihoodRatio(), False),
        (PROVED, True),
        (ratio(21.0, -1.0), False),
        (ratio(5.0, 6.0), False),
    ],
)
def test_a_proof_needs_both_halves_of_the_drive(proof, stands):
    assert bool(reason_to_accept(CandidateKind.EARLIER, proof)) is stands


def driven(seed, legs, **options):
    rng = np.random.default_rng(seed)
    return simulated_drive(travel(legs, rng), rng, Vehicle(ROBOT), receiver=None, **options)


def follow(drive, machine, reported=lambda stamp: stamp):
    """Let the machine decide along a drive; returns its decisions with their seconds.

    The stamps that the machine receives are `reported(stamp)`.
    """
    made = []
    rows = (drive.time, drive.field, drive.force, drive.rate)
    for stamp, field, force, rate in zip(*(row[::2].tolist() for row in rows), strict=True):
        imu = ImuSample(reported(stamp), force, rate)
        if machine.add(Pair(FieldSample(reported(stamp), field), imu)):
            for decision in machine.note(examine_drive(machine.job(BOSTON))):
                made.append((stamp - drive.time[0], decision))
                if decision.is_change:
                    machine.put_in_force(decision.calibration)
    return made


def heading_error(correction, robot):
    yaw = np.arange(36) * (math.tau / 36)
    attitude = np.array([rotation_from_rpy(0.0, 0.0, angle).T for angle in yaw])
    raw = robot.raw_field(attitude @ robot.field_enu)
    turn = np.exp(1j * (yaw_from_up_and_field(attitude[:, :, 2], correction.apply(raw)) - yaw))
    return math.degrees(math.sqrt(np.mean(np.angle(turn / turn.mean()) ** 2)))


@pytest.mark.nightly
def test_an_ordinary_drive_gives_a_first_calibration():
    machine = SelfCalibration(Mode.APPLY)
    drive = driven(5, city(np.random.default_rng(5), 200.0))
    made = follow(drive, machine)
    applied = [decision for _, decision in made if decision.kind is DecisionKind.APPLIED]
    assert len(applied) == 1
    assert all(0.0 < decision.clock <= seconds for seconds, decision in made)
    assert heading_error(applied[0].calibration.correction, ROBOT) < 5.0


HOURS = 5 * 3600.0
JUMPS = {
    "blip": lambda seconds: HOURS if 100.0 < seconds < 101.0 else 0.0,
    "jump": lambda seconds: HOURS if seconds > 100.0 else 0.0,
    "ten_minutes": lambda seconds: 600.0 if seconds > 100.0 else 0.0,
    "back": lambda seconds: -600.0 if seconds > 100.0 else 0.0,
    "epoch": lambda seconds: 2e9 if 100.0 < seconds < 101.0 else 0.0,
    "often": lambda seconds: HOURS if seconds % 30.0 < 0.3 else 0.0,
}


@remembered
def first_calibration(seed, jump=None):
    """When a drive gave the first calibration, and how much of it was recorded, seconds."""
    drive = driven(seed, city(np.random.default_rng(seed), 360.0))
    started, machine = float(drive.time[0]), SelfCalibration(Mode.APPLY)
    later = JUMPS.get(jump, lambda seconds: 0.0)
    made = follow(drive, machine, lambda stamp: stamp + later(stamp - started))
    first = next(seconds for seconds, each in made if each.kind is DecisionKind.APPLIED)
    return first, machine.recorder.seconds


@pytest.mark.nightly
@pytest.mark.parametrize("jump", JUMPS)
def test_jumps_of_stamps_usually_delay_self_calibration_by_at_most_a_minute(jump):
    """In a single drive, a fit that was just good enough may be delayed by two looks."""
    seeds = 5, 720010, 720011
    made, undisturbed = (
        np.array([first_calibration(seed, each) for seed in seeds]) for each in (jump, None)
    )
    assert np.median(made[:, 0] - undisturbed[:, 0]) < 75.0
    assert made[:, 0].max() < 300.0
    assert made[:, 1] == pytest.approx(undisturbed[:, 1], abs=15.0)


def test_a_magnet_of_less_than_a_minute_is_reported():
    magnet = Iron((0.0, 27e-6, 0.0), 30.0, 75.0)
    drive = driven(2, city(np.random.default_rng(4), 75.0), irons=(magnet,))
    machine = SelfCalibration(Mode.APPLY)
    machine.put_in_force(calibration())
    reported = [at for at, made in follow(drive, machine) if made.kind is DecisionKind.NOTICED]
    assert 30.0 < reported[0] < 70.0


@pytest.mark.nightly
def test_added_iron_is_noticed_and_corrected():
    drive = driven(2, city(np.random.default_rng(4), 400.0), irons=(Iron((0.0, 9e-6, 0.0), 150.0),))
    machine = SelfCalibration(Mode.APPLY)
    machine.put_in_force(calibration())
    made = follow(drive, machine)
    noticed = [seconds for seconds, decision in made if decision.kind is DecisionKind.NOTICED]
    applied = [(at, found) for at, found in made if found.kind is DecisionKind.APPLIED]
    assert 150.0 < noticed[0] < 260.0
    assert applied[0][0] < 390.0
    robot = Vehicle(ROBOT).with_iron(np.array([0.0, 9e-6, 0.0])).robot
    assert heading_error(ROBOT.true_correction, robot) > 12.0
    assert heading_error(applied[-1][1].calibration.correction, robot) < 4.0


def test_a_robot_at_rest_beside_a_car_starts_no_job():
    drive = driven(3, [Leg(90.0)])
    machine = SelfCalibration(Mode.APPLY)
    assert follow(drive, machine) == []
    assert machine.in_words == "waiting for movement"
    assert machine.recorder.seconds < 10.0


def test_nothing_is_recorded_if_self_calibration_is_off_and_nothing_is_in_force():
    machine = SelfCalibration(Mode.OFF)
    assert follow(driven(3, city(np.random.default_rng(3), 60.0)), machine) == []
    assert machine.recorder.seconds == 0.0
