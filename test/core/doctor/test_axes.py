import math

import numpy as np
import pytest
from axes_cases import good_case, wrong_case
from imu_faults_cases import good_case as case_of
from long_form import first_of
from remembered import remembered
from simulated.turns import measure, turn

from magcal_ros.core import Knowledge, Mounting, Reason, Window, calibrate, calibrate_turns
from magcal_ros.core.doctor import (
    examine,
    examine_window,
    mount_of,
    parameter_line,
    sensor_report,
)
from magcal_ros.core.geometry import rotation_from_rpy, signed_permutations
from magcal_ros.core.knowledge import Belief
from magcal_ros.core.simulation import DEGREE, Robot

EVERY = signed_permutations()
NED = np.diag([1.0, -1.0, -1.0])
MIRRORED_Z = np.diag([1.0, 1.0, -1.0])


@pytest.fixture(autouse=True)
def axes_alone(monkeypatch):
    """Fit no turn after the axes are found: it takes most of the time, and changes none."""
    monkeypatch.setattr(sensor_report, "fit_turn", lambda *_: None)


def named(found, axes):
    return any(np.array_equal(axes, each) for each in found.candidates)


def find_axes(window, knowledge=Knowledge()):
    return examine_window(window, knowledge).axes


def of(axes, kind, seed=0):
    window, knowledge = wrong_case(axes, np.random.default_rng([seed, 5]), kind)
    return find_axes(window, knowledge), window, knowledge


lifted = remembered(lambda number: of(EVERY[number], "lift"))


@pytest.mark.nightly
@pytest.mark.parametrize("which", first_of(range(0, 48, 9)))
def test_after_a_turn_the_true_axes_are_among_those_named(which):
    found, *_ = of(EVERY[which], "level")
    assert found.right == named(found, np.eye(3))
    assert found.right or named(found, EVERY[which])
    assert len(found.candidates) <= 8


@pytest.mark.parametrize("which", first_of([13, 6, 30, 0, 12, 18, 24, 36, 42]))
def test_a_turn_and_a_lift_determine_one_of_48_axes(which):
    found, *_ = lifted(which)
    assert len(found.candidates) == 1
    assert np.array_equal(found.likeliest, EVERY[which])
    assert (found.mount_rpy_deg is None) == (which >= 24)


@pytest.mark.nightly
@pytest.mark.timeout(900)
def test_a_turn_and_a_lift_nearly_always_determine_the_axes_and_never_wrongly():
    decided = []
    for number in range(4 * len(EVERY)):
        axes = EVERY[number % len(EVERY)]
        found, *_ = of(axes, "lift", number)
        assert named(found, axes) or found.right, f"lift {number}: {found.words}"
        decided.append(len(found.candidates) == 1 and np.array_equal(found.likeliest, axes))
    assert np.mean(decided) > 0.95


@pytest.mark.parametrize("seed", first_of(range(4)))
def test_good_sensors_are_never_called_wrong(seed):
    window, knowledge = good_case(np.random.default_rng([seed, 3]))
    assert find_axes(window, knowledge).words == ""


@pytest.mark.nightly
@pytest.mark.timeout(900)
def test_good_sensors_are_not_called_wrong_in_hundreds_of_turns():
    for seed in range(300):
        window, knowledge = good_case(np.random.default_rng([seed, 4]))
        found = find_axes(window, knowledge)
        assert found is None or found.right, seed


def test_the_words_contain_the_parameter_line():
    found, *_ = of(NED, "lift")
    assert "x forward, y right, z down (NED): set `mount_rpy_deg: [180.0, 0.0, 0.0]`" in found.words


def test_the_parameter_line_corrects_the_axes():
    found, window, knowledge = lifted(13)
    mount = [math.radians(angle) for angle in found.mount_rpy_deg]
    mended = Knowledge(knowledge.reference, Mounting(pose=rotation_from_rpy(*mount)))
    again = find_axes(window, mended)
    assert again.right
    assert len(again.candidates) == 1


@pytest.mark.nightly
def test_a_wrong_mount_parameter_is_replaced_as_a_whole():
    """The magnetometer is parallel to the IMU, but the parameter says that it is upside down."""
    _, window, knowledge = of(np.eye(3), "lift")
    wrong = Knowledge(knowledge.reference, Mounting(pose=rotation_from_rpy(math.pi, 0.0, 0.0)))
    found = find_axes(window, wrong)
    assert found.mount_rpy_deg == (0, 0, 0)
    assert "x forward, y left, z up" in found.words


@pytest.mark.nightly
def test_without_the_inclination_axes_and_their_opposites_are_named():
    _, window, _ = of(MIRRORED_Z, "lift")
    found = find_axes(window)
    assert len(found.candidates) == 2
    assert named(found, MIRRORED_Z)
    assert named(found, -MIRRORED_Z)
    assert "give the position or the field's inclination" in found.words


def test_candidates_after_a_level_turn_are_named_with_the_distinguishing_movement():
    found, *_ = of(NED, "level")
    assert "lift the nose by 20° while the robot turns, or drive over a kerb" in found.words


@pytest.mark.parametrize("lacks", ["gyro", "turn", "samples"])
def test_nothing_is_reported_if_nothing_is_observable(lacks):
    arc = 20.0 * DEGREE if lacks == "turn" else 2.0 * math.pi
    motion = turn(arc=arc, samples=10 if lacks == "samples" else 300)
    window = measure(Robot(), motion, np.random.default_rng(1), gyro=lacks != "gyro")
    assert find_axes(window) is None


@pytest.mark.nightly
@pytest.mark.parametrize("axes", [MIRRORED_Z, NED, EVERY[30]])
@pytest.mark.parametrize("several", [False, True])
def test_a_turn_with_wrong_axes_is_refused_with_these_words(axes, several):
    found, window, knowledge = of(axes, "lift")
    outcome = calibrate_turns([window], knowledge) if several else calibrate(window, knowledge)
    assert not outcome.verdict.accepted
    assert outcome.reason is Reason.AXES_DISAGREE
    assert found.words in outcome.verdict.summary


@pytest.mark.nightly
def test_a_gyro_that_fits_no_axes_is_reported():
    _, window, knowledge = of(np.eye(3), "lift")
    scrambled = np.random.default_rng(2).permutation(window.angular_rate)
    odd = Window(window.time, window.field, window.specific_force, scrambled * 5.0)
    report = examine_window(odd, knowledge)
    assert report.axes is None
    assert any("check that the gyro responds to turns" in f.remedy for f in report.findings)


def test_angles_are_written_within_half_a_turn():
    assert mount_of(NED, np.eye(3)) == (180, 0, 0)
    assert parameter_line((180, 0, -90)) == "mount_rpy_deg: [180.0, 0.0, -90.0]"


def test_the_number_of_other_fitting_orientations_is_given():
    case = case_of(np.random.default_rng([6, 0]), "turn")
    (line,) = (f for f in examine(case.log, case.knowledge).findings if f.key == "axes")
    assert "other pairs of orientations of gyro and magnetometer; to tell" in line.evidence
    assert "or drive over a kerb" in line.evidence


def test_a_course_determines_the_mounting_if_the_yaw_of_the_imu_is_known():
    report = examine_window(*good_case(np.random.default_rng([3, 7, 10])))
    gap = Belief(90.0 * DEGREE, 2.0 * DEGREE)
    known = report.with_course(gap, Belief(0.0, 2.0 * DEGREE))
    assert known.mount_rpy_deg == (0, 0, 90)
    assert known.findings[-1].remedy.startswith("the magnetometer's axes are")
    unknown = report.with_course(gap, Belief.unknown())
    assert unknown.mount_rpy_deg is None
    assert unknown.findings[-1].remedy.startswith("either the magnetometer's axes are")
