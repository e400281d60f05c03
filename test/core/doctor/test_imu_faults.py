"""Each simulated fault of good sensors is named, and nothing else."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from imu_faults_cases import FAULTS, HABITS, Habit, good_case
from long_form import first_of
from remembered import remembered
from simulated.turns import measure, turn
from uneven_turns import ROBOT, driven, evenly

from magcal_ros.core import Grade, Knowledge, Mounting
from magcal_ros.core.doctor import (
    compare_axes,
    examine,
    examine_window,
    force_latency,
    gravity_misfit,
    prepare,
    segment_of_log,
    turn_fit,
)
from magcal_ros.core.geometry import chained, exp_rotations, signed_permutations
from magcal_ros.core.samples import SensorLog
from magcal_ros.core.simulation import DEGREE, Robot

MOST_SEEN = "half minute"


examine_once = remembered(examine)
smooth_once = remembered(turn_fit.smooth)


@pytest.fixture(autouse=True)
def one_fit(monkeypatch):
    """Fit samples once: where wrong axes are corrected they are those of the good sensors."""
    monkeypatch.setattr(turn_fit, "smooth", smooth_once)


def report_of(case, log=None):
    return examine_once(log or case.log, case.knowledge, case.turned_left)


def wrong(report):
    return {finding.key for finding in report.findings if finding.is_wrong}


@pytest.mark.parametrize("motion", first_of(["turn", "half minute", "lift", "quarter"]))
def test_good_sensors_have_no_fault(motion):
    assert wrong(report_of(good_case(np.random.default_rng(11), motion))) == set()


ONE_OF_A_KIND = ["gravity's sign", "gyro x, y swapped", "scale +5 %", "bursts of 1 s", "frozen"]
"""Not those of the field alone, which test_health.py has."""


@pytest.mark.parametrize(
    "name",
    first_of([*ONE_OF_A_KIND, *(n for n in FAULTS if n not in ONE_OF_A_KIND)], len(ONE_OF_A_KIND)),
)
def test_a_fault_is_named_alone(name):
    fault, keys = FAULTS[name]
    rng = np.random.default_rng([5, 1])
    case = good_case(rng, MOST_SEEN)
    assert wrong(report_of(case, fault(rng, case.log))) == set(keys)


@pytest.mark.nightly
@pytest.mark.parametrize(
    "pair",
    first_of(
        [
            ("gravity's sign", "gyro z mirrored"),
            ("bursts of 1 s", "gyro y mirrored"),
            ("degrees for rad", "latency 20-500 ms"),
            ("rate z as x", "10 % repeats"),
            ("gyro x, y swapped", "g for m/s²"),
        ]
    ),
)
def test_two_faults_at_once_are_both_named(pair):
    one, two = pair
    rng = np.random.default_rng([5, 6])
    case = good_case(rng, MOST_SEEN)
    log = FAULTS[two][0](rng, FAULTS[one][0](rng, case.log))
    assert wrong(report_of(case, log)) >= {*FAULTS[one][1], *FAULTS[two][1]}


@pytest.mark.parametrize("number", first_of([17, 30, 1, 5, 24, 47]))
def test_the_magnetometer_is_named_if_gyro_and_accelerometer_agree(number):
    case = good_case(np.random.default_rng([5, 1]), MOST_SEEN)
    axes = signed_permutations()[number]
    report = report_of(case, replace(case.log, field=case.log.field @ axes.T))
    assert wrong(report) == {"field_axes"}


@pytest.mark.parametrize("axes", first_of([np.diag([1.0, -1.0, -1.0]), np.diag([-1.0, -1.0, 1.0])]))
def test_the_accelerometer_is_named_if_gyro_and_field_agree(axes):
    case = good_case(np.random.default_rng([5, 1]), MOST_SEEN)
    keys = wrong(report_of(case, replace(case.log, force=case.log.force @ axes.T)))
    assert keys & {"force_axes", "imu_axes", "gravity_sign"}
    assert not keys & {"gyro_axes", "field_axes"}


def test_an_imu_upside_down_is_distinguished_from_gravity_of_the_wrong_sign():
    case = good_case(np.random.default_rng([5, 1]), MOST_SEEN)
    over = np.diag([1.0, -1.0, -1.0])
    turned = replace(
        case.log,
        force=case.log.force @ over,
        rate=case.log.rate @ over,
        field=case.log.field @ over,
    )
    assert wrong(report_of(case, turned)) == {"imu_axes"}
    assert wrong(report_of(case, replace(case.log, force=-case.log.force))) == {"gravity_sign"}


def mirrored_on_the_level(seed):
    """The report on a level turn whose gyro is mirrored."""
    case = good_case(np.random.default_rng([6, seed]), "turn")
    return report_of(case, replace(case.log, rate=case.log.rate * np.array([1.0, 1.0, -1.0])))


@pytest.mark.parametrize("seeds", first_of([range(1, 2), range(3)]))
def test_an_ambiguity_of_a_level_turn_is_one_finding_with_a_movement(seeds):
    asked = 0
    for seed in seeds:
        (line,) = [f for f in mirrored_on_the_level(seed).findings if f.is_wrong]
        assert line.key in ("axes", "gyro_axes")
        asked += line.key == "axes"
        if line.key == "axes":
            assert (
                "has wrong axes, and this movement does not show which: lift the nose"
                in line.remedy
            )
    assert asked


def test_two_sensors_are_never_reported_together():
    case = good_case(np.random.default_rng([5, 2]), MOST_SEEN)
    slip = np.array([1.0, 1.0, -1.0])
    other = case.log.field[:, [1, 0, 2]]
    report = report_of(case, replace(case.log, rate=case.log.rate * slip, field=other))
    (line,) = [f for f in report.findings if f.is_wrong]
    assert line.grade is Grade.WARN
    assert "wrong axes of one sensor do not explain it" in line.remedy


def seconds_late(line):
    size, how = re.match(r"(\d+) ± \d+ ms (early|late)", line.evidence).groups()
    return int(size) * (1e-3 if how == "late" else -1e-3)


@pytest.mark.parametrize("lag", first_of([-0.2, 0.04, -0.04, 0.3]))
def test_the_latency_of_the_field_is_measured(lag):
    case = good_case(np.random.default_rng([5, 6]), "quarter")
    late = replace(case.log, field_time=case.log.field_time + lag)
    lines = {f.key: f for f in report_of(case, late).findings}
    assert lines["latency"].is_wrong
    assert seconds_late(lines["latency"]) == pytest.approx(lag, abs=8e-3)
    assert not lines["force_latency"].is_wrong


@pytest.mark.parametrize("samples", first_of([5, 20]))
def test_the_latency_of_the_accelerometer_is_measured(samples):
    case = good_case(np.random.default_rng([5, 6]), "quarter")
    log = case.log
    lag = samples * float(np.median(np.diff(log.imu_time)))
    late = replace(log, force=np.roll(log.force, samples, axis=0))
    report = report_of(case, late)
    lines = {f.key: f for f in report.findings}
    assert seconds_late(lines["force_latency"]) == pytest.approx(lag, abs=8e-3)
    assert wrong(report) == {"force_latency"}
    ahead = replace(log, rate=np.roll(log.rate, -samples, axis=0))
    lines = {f.key: f for f in report_of(case, ahead).findings if f.is_wrong}
    assert set(lines) == {"latency", "force_latency"}
    assert "the gyro is" in lines["latency"].remedy


@pytest.mark.nightly
def test_the_sigma_of_a_latency_is_correct():
    errors = []
    for seed in range(60):
        case = good_case(np.random.default_rng([8, seed]), MOST_SEEN)
        log = prepare(case.log).log
        hypotheses = compare_axes(log, case.knowledge.reference.inclination)
        latency = force_latency(hypotheses.hypothesis(hypotheses.best))
        errors.append(latency.value / latency.sigma)
    assert 0.75 < np.sqrt(np.mean(np.square(errors))) < 1.3


@pytest.mark.nightly
@pytest.mark.parametrize("off", first_of([-3.0, 2.0, 1000.0]))
def test_stamps_of_two_clocks_are_named_and_the_other_checks_are_made(off):
    case = good_case(np.random.default_rng([5, 6]), MOST_SEEN)
    log = replace(case.log, field_time=case.log.field_time + off)
    assert wrong(report_of(case, log)) == {"clocks"}
    ned = replace(log, field=log.field * np.array([1.0, -1.0, -1.0]))
    report = report_of(case, ned)
    assert wrong(report) == {"clocks", "field_axes", "driver"}
    assert report.parameters == "mount_rpy_deg: [180.0, 0.0, 0.0]"


@pytest.mark.nightly
@pytest.mark.parametrize("drawn", first_of([("turn", 2), ("lift", 4), ("half minute", 9)]))
def test_a_frozen_sensor_is_not_taken_for_another_clock(drawn):
    """While it is frozen it does not show when the robot turned."""
    motion, seed = drawn
    freeze, keys = FAULTS["frozen"]
    rng = np.random.default_rng([3401, seed])
    case = good_case(rng, motion)
    assert wrong(report_of(case, freeze(rng, case.log))) == {*keys}


def test_a_turn_in_the_other_direction_is_no_fault_of_a_sensor():
    case = good_case(np.random.default_rng([4, 0]), MOST_SEEN, habit=Habit(left=-1.0))
    (line,) = [f for f in examine(case.log, case.knowledge, True).findings if f.is_wrong]
    assert line.key == "imu_axes"
    assert "turn left and check again" in line.remedy


@pytest.mark.nightly
@pytest.mark.parametrize("name", first_of(HABITS))
def test_good_sensors_of_other_robots_and_movements_have_no_fault(name):
    rng = np.random.default_rng([4, 3])
    report = report_of(good_case(rng, MOST_SEEN, habit=HABITS[name]))
    stated = {"bias of 2 °/s": {"gyro_bias"}, "half the field": {"reference"}}
    if "clock" in name:
        # A field with growing latency; between starts and stops motors look the same.
        late = [each for each in report.findings if each.is_wrong]
        assert [each.key for each in late] in (["latency"], ["motors"])
        assert late[0].key == "latency" or "Late stamps of the field" in late[0].remedy
        return
    assert wrong(report) == stated.get(name, set())


MOTORS_HIDE = ("gyro_bias", "rate_scale", "reference", "axes")


def test_a_field_that_steps_with_the_motors_is_named():
    case = good_case(np.random.default_rng([5, 7]), MOST_SEEN)
    log = case.log
    moving = np.linalg.norm(log.rate, axis=1) > 0.1
    on = np.interp(log.field_time, log.imu_time, moving.astype(float)) > 0.5
    for size, words in ((1.0, "subtracts it while"), (10.0, "too large to be subtracted well")):
        added = size * np.outer(on, [3e-6, -2e-6, 4e-6])
        report = report_of(case, replace(log, field=log.field + added))
        (line,) = [each for each in report.findings if each.key == "motors"]
        assert line.is_wrong
        assert words in line.remedy
        assert "° of heading" in line.evidence
        hidden = [f for f in report.findings if f.evidence.startswith("not shown")]
        # The robot has already rested, turned and lifted its nose: asking again is no help.
        assert not [f.evidence for f in hidden if "then turn a full circle" in f.evidence]
        assert all("motors off" in f.evidence for f in hidden if f.key in MOTORS_HIDE)


def test_without_a_gyro_the_other_checks_are_made_and_a_movement_is_named():
    case = good_case(np.random.default_rng([5, 8]), MOST_SEEN)
    blind = replace(case.log, rate=np.full_like(case.log.rate, np.nan), force=-case.log.force)
    lines = {f.key: f for f in report_of(case, blind).findings if f.is_wrong}
    assert set(lines) == {"no_gyro", "gravity_sign"}
    assert "drive straight" in lines["no_gyro"].remedy


def test_short_logs_and_logs_at_rest_give_no_error_and_no_fault():
    case = good_case(np.random.default_rng([5, 9]), MOST_SEEN)
    log = case.log
    still = replace(
        log,
        imu_time=log.imu_time[:200],
        force=log.force[:200],
        rate=log.rate[:200],
        field_time=log.field_time[:80],
        field=log.field[:80],
    )
    assert wrong(report_of(case, still)) == set()
    for count in (0, 1, 2, 5):
        short = replace(
            log,
            imu_time=log.imu_time[:count],
            force=log.force[:count],
            rate=log.rate[:count],
            field_time=log.field_time[:count],
            field=log.field[:count],
        )
        assert wrong(report_of(case, short)) == set()


@pytest.mark.nightly
def test_only_the_correcting_mounting_is_offered():
    rng = np.random.default_rng([5, 10])
    case = good_case(rng, MOST_SEEN)
    ned = replace(case.log, field=case.log.field * np.array([1.0, -1.0, -1.0]))
    assert report_of(case, ned).parameters == "mount_rpy_deg: [180.0, 0.0, 0.0]"
    mirrored = replace(case.log, rate=case.log.rate * np.array([1.0, 1.0, -1.0]))
    assert report_of(case, mirrored).parameters == ""


def test_the_reference_of_another_place_is_named():
    case = good_case(np.random.default_rng([5, 12]), MOST_SEEN)
    known = case.knowledge.reference
    dip = replace(known.inclination, value=known.inclination.value - math.radians(25.0))
    elsewhere = replace(case, knowledge=Knowledge(replace(known, inclination=dip)))
    (line,) = [f for f in report_of(elsewhere).findings if f.key == "reference"]
    assert line.is_wrong
    assert f"an inclination of {math.degrees(dip.value):.0f}°" in line.remedy


def test_a_part_of_a_turn_asks_for_the_missing_movement():
    robot = Robot()
    window = measure(robot, turn(arc=0.44), np.random.default_rng(1), gyro=True)
    report = examine_window(window, robot.knowledge())
    assert wrong(report) == set()
    lines = {f.key: f for f in report.findings}
    for key in ("gyro_bias", "rate_scale"):
        assert "turn left once" in lines[key].evidence


def streets(case):
    """A robot that goes straight on through fields that change by 20 µT, its gyro all but still."""
    log, rng = case.log, np.random.default_rng(3)
    steps = np.arange(log.field_time[0], log.field_time[-1] + 1.0)
    bends = rng.normal(0.0, 20e-6, (len(steps), 3))
    bent = np.column_stack([np.interp(log.field_time, steps, bends[:, k]) for k in range(3)])
    return replace(log, rate=rng.normal(0.0, 0.02, log.rate.shape), field=bent + 50e-6)


@pytest.mark.nightly
def test_a_field_that_changes_from_place_to_place_is_no_unit_of_the_gyro():
    case = good_case(np.random.default_rng([5, 6]), MOST_SEEN)
    lines = {f.key: f for f in report_of(case, streets(case)).findings}
    assert "rate_unit" not in lines or not lines["rate_unit"].is_wrong


@pytest.mark.parametrize("seed", first_of(range(3)))
def test_a_lever_arm_is_not_taken_for_a_rotated_accelerometer(seed):
    """A hand swings the sensor around an elbow: it measures the arm's acceleration."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 30.0, 0.01)
    phases = enumerate(rng.uniform(0.0, 6.0, 3))
    rate = np.column_stack([0.4 * np.sin(6.0 * time * (1.0 + 0.1 * k) + p) for k, p in phases])
    turns = chained(exp_rotations(-0.5 * (rate[1:] + rate[:-1]) * 0.01)[None])[0]
    arm = np.array([0.0, 0.0, 0.6])
    swung = np.cross(np.gradient(rate, 0.01, axis=0), arm) + np.cross(rate, np.cross(rate, arm))
    force = 9.81 * turns[:, :, 2] + swung + 0.05 * rng.normal(size=rate.shape)
    field = 45e-6 * (turns @ np.array([0.0, 0.4, -0.9])) + 0.3e-6 * rng.normal(size=rate.shape)
    noisy = rate + 0.003 * rng.normal(size=rate.shape)
    part = segment_of_log(SensorLog(time, force, noisy, time, field))
    misfit, _ = gravity_misfit(part, signed_permutations())
    assert misfit[0] < 5.0


def test_a_robot_at_rest_shows_the_gyro_bias_and_no_wrong_axes():
    """The field at rest wanders by half a microtesla; the gyro alone tells a turn of 140°."""
    rng, time = np.random.default_rng(8), np.arange(0.0, 30.0, 0.025)
    bias = np.array([3.5, 2.0, 2.0]) * DEGREE
    rate = bias + 0.1 * DEGREE * rng.normal(size=(len(time), 3))
    force = np.array([0.3, -0.1, 9.8]) + 0.03 * rng.normal(size=rate.shape)
    wander = np.linspace(0.0, 0.5e-6, len(time))[:, None] * np.array([1.0, 1.0, -1.0])
    field = np.array([15e-6, 5e-6, -35e-6]) + wander + 0.02e-6 * rng.normal(size=rate.shape)
    lines = {f.key: f for f in examine(SensorLog(time, force, rate, time, field)).findings}
    assert "nothing_fits" not in lines
    assert lines["axes"].evidence.startswith("not shown")
    assert lines["gyro_bias"].evidence.startswith(("(3.48", "(3.49", "(3.5"))


@pytest.mark.nightly
def test_a_gyro_scale_error_by_one_turn_asks_for_another_turn():
    """Currents that rise during one turn move the field as another scale would."""
    case = good_case(np.random.default_rng([5, 1]), MOST_SEEN)
    (line,) = [
        f
        for f in report_of(case, replace(case.log, rate=1.08 * case.log.rate)).findings
        if f.key == "rate_scale"
    ]
    assert line.is_wrong
    assert line.remedy.startswith("check again: stand still, turn a full")


@pytest.mark.nightly
@pytest.mark.parametrize("case", first_of([(57.3, "57.3 times too large"), (1.0, "")]))
def test_a_slow_turn_determines_the_unit_of_the_gyro(case):
    """In half a second a robot that turns by 15 degrees a second shows too little of it."""
    times, words = case
    rng = np.random.default_rng(4)
    time = np.arange(-6.0, 31.0, 1.0 / 30.0)
    rate = 0.26 * np.clip(np.minimum(time, 25.0 - time) / 0.5, 0.0, 1.0)
    turned = exp_rotations(-np.outer(np.cumsum(rate) / 30.0, [0.0, 0.0, 1.0]))
    field = turned @ np.array([0.0, 25e-6, -43e-6]) + 0.3e-6 * rng.normal(size=(len(time), 3))
    force = np.array([0.0, 0.0, 9.81]) + 0.05 * rng.normal(size=field.shape)
    rates = times * (np.outer(rate, [0.0, 0.0, 1.0]) + 2e-3 * rng.normal(size=field.shape))
    lines = {f.key: f for f in examine(SensorLog(time, force, rates, time, field)).findings}
    assert lines["rate_unit"].is_wrong == bool(words)
    assert words in lines["rate_unit"].remedy


@pytest.mark.nightly
@pytest.mark.parametrize("size", first_of([7e-6, 15e-6]))
def test_a_motor_field_in_proportion_to_the_rate_gives_a_warning(size):
    """A field that is early by .8 s explains the same turn: both are reported."""
    rng = np.random.default_rng(4)
    time = np.arange(-6.0, 31.0, 1.0 / 30.0)
    rate = 0.26 * np.clip(np.minimum(time, 25.0 - time) / 0.5, 0.0, 1.0)
    turned = exp_rotations(-np.outer(np.cumsum(rate) / 30.0, [0.0, 0.0, 1.0]))
    field = turned @ np.array([0.0, 25e-6, -43e-6]) + np.array([30e-6, -20e-6, 25e-6])
    field += np.outer(size * rate / 0.26, [0.6, -0.8, 0.0])
    field += 0.3e-6 * rng.normal(size=field.shape)
    force = np.array([0.0, 0.0, 9.81]) + 0.05 * rng.normal(size=field.shape)
    rates = np.outer(rate, [0.0, 0.0, 1.0]) + 2e-3 * rng.normal(size=field.shape)
    lines = {f.key: f for f in examine(SensorLog(time, force, rates, time, field)).findings}
    assert lines["motors"].is_wrong
    assert not lines["latency"].is_wrong


@pytest.mark.nightly
def test_after_a_turn_between_rests_motors_do_not_hide_the_gyro_scale():
    """The rests show the field of the motors, and the smoother tells it from a scale error."""
    _, window = driven(evenly, ROBOT, 6.0)
    rate = window.angular_rate[:, 2]
    added = np.outer(7e-6 * rate / np.abs(rate).max(), [0.6, -0.8, 0.0])
    report = examine(SensorLog.of_window(replace(window, field=window.field + added)))
    lines = {finding.key: finding for finding in report.findings}
    assert lines["motors"].is_wrong
    assert not lines["rate_scale"].is_wrong
    shown = re.match(r"([+-]\d\.\d)% ± \d\.\d%", lines["rate_scale"].evidence)
    assert float(shown.group(1)) == pytest.approx(0.0, abs=0.5)


def test_wrong_axes_of_the_imu_are_not_attributed_to_the_magnetometer():
    case = good_case(np.random.default_rng([5, 7]), "lift")
    forward_right_down = np.array([1.0, -1.0, -1.0])
    force, rate = case.log.force * forward_right_down, case.log.rate * forward_right_down
    report = report_of(case, replace(case.log, force=force, rate=rate))
    assert len(wrong(report)) == 1
    assert report.mount_rpy_deg is None


def test_the_distinguishing_movement_is_asked_for_once():
    (line,) = [f for f in mirrored_on_the_level(1).findings if f.key == "axes"]
    assert line.remedy.count("lift the nose") == 1


def test_a_robot_of_exact_sensors_has_no_latency_to_be_shown():
    """The smoother holds the latency at zero for exact sensors."""
    case = good_case(np.random.default_rng([5, 6]), MOST_SEEN)
    report = examine(case.log, replace(case.knowledge, exact_sensors=True))
    lines = {f.key: f for f in report.findings}
    assert lines["latency"].evidence.startswith("not shown")


def test_a_known_mounting_is_applied_once():
    """Applied twice, the field seemed to turn the wrong way, and motors seemed to explain it."""
    case = good_case(np.random.default_rng([85, 1]), MOST_SEEN)
    mounting = Mounting(pose=np.diag([1.0, -1.0, -1.0]))
    log = replace(case.log, field=case.log.field * np.array([1.0, -1.0, -1.0]))
    report = examine(log, replace(case.knowledge, mounting=mounting), case.turned_left)
    assert wrong(report) == set()
    as_mounted = {f.key: f.evidence for f in report_of(case).findings}
    given = {f.key: f.evidence for f in report.findings}
    assert all(given[key] == as_mounted[key] for key in ("latency", "motors", "rate_scale"))
