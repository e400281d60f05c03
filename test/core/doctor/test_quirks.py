"""Each known fault of a driver is named when it is simulated, and only then."""

import functools
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from imu_faults_cases import good_case
from long_form import first_of
from realistic_robots import SAMPLES, SECONDS, driven, evenly
from scipy.spatial.transform import Rotation
from simulated.turns import measure, smooth_wobble

from magcal_ros.core import Belief, Knowledge, ReferenceField, Window, calibrate
from magcal_ros.core.doctor import (
    AK09916_IN_ICM20948,
    AK8963_IN_MPU9250,
    QUIRKS,
    WRAP,
    examine,
    examine_window,
    sensor_report,
)
from magcal_ros.core.geometry import interpolated, rotation_from_rpy
from magcal_ros.core.simulation import Robot

MOTION = "half minute"


@pytest.fixture(autouse=True)
def axes_alone(monkeypatch):
    """Fit no turn after the comparison: it takes most of the time, and names no driver."""
    monkeypatch.setattr(sensor_report, "fit_turn", lambda *_: None)


def case_of(seed):
    return good_case(np.random.default_rng([34, seed]), MOTION)


def wrong_lines(case, log):
    return lines_of(examine(log, case.knowledge, case.turned_left))


def lines_of(report):
    return [f"{f.name} {f.evidence} {f.remedy}" for f in report.findings if f.is_wrong]


def scaled(per_tesla):
    return lambda rng, log: replace(log, field=per_tesla * log.field)


def void(value):
    def published(rng, log):
        field = log.field.copy()
        field[rng.integers(2) :: 2] = value
        return replace(log, field=field)

    return published


def stamped(off):
    def published(rng, log):
        # The IMU's stream ends within a message or two of the field's.
        return replace(log, field_time=log.field_time + off + rng.uniform(-0.05, 0.05))

    return published


def stamped_with_voids(off):
    def published(rng, log):
        field = log.field.copy()
        field[rng.random(len(field)) < 0.1] = np.nan
        return stamped(off)(rng, replace(log, field=field))

    return published


def turned(axes):
    return lambda rng, log: replace(log, field=log.field @ axes.T)


def without_north(rng, log):
    """A game rotation vector: its yaw begins anywhere, here not by chance at the right one."""
    start = Rotation.from_rotvec([0.0, 0.0, np.radians(rng.uniform(45.0, 315.0))])
    return replace(log, orientation=(start * Rotation.from_quat(log.orientation)).as_quat())


CASES = {
    "imu_3dm_gx4": scaled(1e4),
    "MAVROS": scaled(1e10),
    "Phidgets": void(np.nan),
    "Phidgets Spatial": void(1e296),
    "SBG": stamped(WRAP),
    "ZED 2i": stamped(-0.8),
    "ZED": stamped_with_voids(-0.8),
    "MPU-9250": turned(AK8963_IN_MPU9250),
    "ICM-20948": turned(AK09916_IN_ICM20948),
    "BNO08x": without_north,
}


NORMED = {"Xsens": 1.0, "Inertial Sense": 1.4}
"""The field's strength without hard iron as these publish it."""


def published(name, seed):
    rng, case = np.random.default_rng([35, seed]), case_of(seed)
    if name not in NORMED:
        return CASES[name](rng, case.log)
    # The sensor's own unit is the field of where it was made, not the field here.
    here = case.knowledge.reference.strength.value * rng.uniform(0.95, 1.05)
    return scaled(NORMED[name] / here)(rng, case.log)


@functools.cache
def report_of(name, seed):
    """The findings on good sensors whose driver has such a fault."""
    case = case_of(seed)
    return examine(published(name, seed), case.knowledge, case.turned_left)


def is_named(name, seed):
    return any(name in line for line in lines_of(report_of(name, seed)))


ALL = [*CASES, *NORMED]
ONE_OF_A_KIND = ["imu_3dm_gx4", "Xsens", "Phidgets", "SBG", "MPU-9250", "BNO08x"]


@pytest.mark.parametrize(
    "name",
    first_of([*ONE_OF_A_KIND, *(n for n in ALL if n not in ONE_OF_A_KIND)], len(ONE_OF_A_KIND)),
)
def test_the_driver_is_named(name):
    assert is_named(name, 0)


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("MPU-9250", "mount_rpy_deg: [180.0, 0.0, 90.0]"),
        ("ICM-20948", "mount_rpy_deg: [180.0, 0.0, 0.0]"),
    ],
)
def test_the_parameter_sample_for_the_chip_has_the_mounting_that_doctor_names(name, line):
    report = report_of(name, 0)
    assert np.allclose(*(_rotation(text) for text in (report.parameters, line)), atol=1e-9)
    sample = Path(__file__).parents[3] / "config" / "sensors" / "icm20948.yaml"
    assert line.partition(": ")[2].replace(".0", "") in sample.read_text().replace(".0", "")


def _rotation(line):
    angles = re.findall(r"-?[\d.]+", line.partition(":")[2])
    return rotation_from_rpy(*(np.radians(float(angle)) for angle in angles))


@pytest.mark.nightly
@pytest.mark.parametrize("name", ALL)
def test_the_driver_is_named_in_99_of_100(name):
    assert sum(is_named(name, seed) for seed in range(1, 101)) >= 99


@pytest.mark.parametrize(("name", "seed"), [("Xsens", 0), ("Inertial Sense", 0)])
def test_a_field_in_an_unknown_unit_is_reported_without_microtesla(name, seed):
    """The strength without hard iron determines the unit; nothing is compared in tesla."""
    report = report_of(name, seed)
    of_field = [f.evidence + f.remedy for f in report.findings if f.name.startswith("field")]
    assert not any("µT" in words for words in of_field)
    unit = next(f for f in report.findings if f.key == "field_unit")
    assert "without hard iron" in unit.evidence
    assert "gauss" not in unit.remedy
    wrong = {f.key for f in report.findings if f.is_wrong}
    assert not wrong & {"reference", "motors", "resolution"}


@pytest.mark.parametrize("method", ["smoother", "ellipsoid"])
def test_a_fit_names_the_unit_by_the_strength_too(method):
    case, log = case_of(0), published("Xsens", 0)
    inside = (log.field_time > log.imu_time[0]) & (log.field_time < log.imu_time[-1])
    time = log.field_time[inside]
    force, rate = (interpolated(time, log.imu_time, each) for each in (log.force, log.rate))
    window = Window(time, log.field[inside], force, rate)
    words = calibrate(window, case.knowledge, method).verdict.summary
    assert "Xsens" in words
    assert "gauss" not in words


@pytest.mark.nightly
@pytest.mark.parametrize("seed", first_of(range(100)))
def test_no_driver_is_named_where_nothing_is_wrong(seed):
    case = case_of(seed)
    lines = " ".join(wrong_lines(case, case.log))
    assert not any(quirk.driver in lines for quirk in QUIRKS)


@pytest.mark.nightly
@pytest.mark.parametrize("seed", first_of(range(1, 51)))
def test_a_field_that_points_up_is_named_as_that_of_a_simulator(seed):
    """Gazebo turns the world's north, east and down into the robot's axes as if they were ENU."""
    case = case_of(seed)
    known = case.knowledge.reference
    if abs(known.inclination.value) < 0.3:
        pytest.skip("where the field is nearly level both signs say the same")
    other = replace(known.inclination, value=-known.inclination.value)
    knowledge = replace(case.knowledge, reference=replace(known, inclination=other))
    lines = wrong_lines(replace(case, knowledge=knowledge), case.log)
    assert any("NED" in line for line in lines)


@pytest.mark.nightly
@pytest.mark.parametrize("seed", first_of([5, *range(5), *range(6, 20)], 2))
def test_a_field_that_points_up_is_named_where_the_reference_is_uncertain(seed):
    """What the reference is off by looked as if the movement contradicted the other sign."""
    rng = np.random.default_rng(seed)
    robot = Robot(inclination=-1.14, noise_field=4e-7, noise_force=0.05, roll=0.0, pitch=0.0)
    sway = smooth_wobble(rng, SAMPLES, SECONDS, math.radians(0.2))
    motion = driven(evenly, 2.0 * math.pi, (0.0, 0.0, 0.0), sway)
    strength = Belief(1.2 * robot.strength, 0.1 * robot.strength)
    knowledge = Knowledge(ReferenceField(strength=strength, inclination=Belief(1.15, 0.02)))
    report = examine_window(measure(robot, motion, rng, gyro=True), knowledge)
    assert any("NED" in finding.remedy for finding in report.findings)


@pytest.mark.parametrize("seed", first_of([2, *(seed for seed in range(20) if seed != 2)]))
def test_a_field_that_points_up_on_a_swaying_robot_is_no_single_reversed_axis(seed):
    """All three axes seemed reversed, and the remedy blamed the driver's x."""
    rng = np.random.default_rng(seed)
    robot = Robot(inclination=-1.14, noise_field=0.2e-6, roll=0.0, pitch=0.0)
    sway = smooth_wobble(rng, SAMPLES, SECONDS, math.radians(rng.uniform(0.3, 2.5)))
    motion = driven(evenly, 2.0 * math.pi, (0.0, 0.03, 0.0), sway)
    strength = Belief(1.06 * robot.strength, 0.03 * robot.strength)
    knowledge = Knowledge(ReferenceField(strength=strength, inclination=Belief(1.15, 0.02)))
    report = examine_window(measure(robot, motion, rng, gyro=True), knowledge)
    remedies = [finding.remedy for finding in report.findings if finding.is_wrong]
    assert any("NED" in remedy for remedy in remedies)
    assert not any("most likely x" in remedy for remedy in remedies)
