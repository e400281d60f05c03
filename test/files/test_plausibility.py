"""Impossible calibrations are not loaded, and possible ones are."""

import math
from dataclasses import replace

import numpy as np
import pytest
import yaml
from long_form import first_of
from simulated.turns import measure, turn

from magcal_ros.core import Correction, Figure, Grade, Knowledge, calibrate
from magcal_ros.core.simulation import Robot
from magcal_ros.files import (
    FileError,
    Origin,
    read_calibration,
    require_possible,
    write_calibration,
)

pytestmark = pytest.mark.faults

ROBOT = Robot(strength=48e-6, inclination=1.13, hard_iron=np.array([15e-6, -8e-6, 10e-6]))


@pytest.fixture(scope="module")
def found():
    window = measure(ROBOT, turn(), np.random.default_rng(3))
    return calibrate(window, ROBOT.knowledge()).calibration


def with_covariance(found, change):
    covariance = np.array(found.covariance)
    change(covariance)
    return replace(found, covariance=covariance)


def uneven(covariance):
    covariance[0, 9] += 1e-3 * math.sqrt(covariance[0, 0] * covariance[9, 9])


def flipped_variance(covariance):
    """A plausible edit: one off-diagonal pair ten times what two sigmas allow."""
    covariance[9, 10] = covariance[10, 9] = 10.0 * math.sqrt(covariance[9, 9] * covariance[10, 10])


def smaller_diagonal(covariance):
    covariance[9, 9] *= 1e-3


def exact_but_tied(covariance):
    covariance[9, 9] = 0.0


@pytest.mark.parametrize("strength", first_of([25e-6, 48e-6, 65e-6]))
@pytest.mark.parametrize("known", first_of([True, False]))
def test_the_result_of_a_turn_is_possible(strength, known):
    robot = replace(ROBOT, strength=strength)
    window = measure(robot, turn(), np.random.default_rng(5))
    outcome = calibrate(window, robot.knowledge() if known else Knowledge())
    require_possible(outcome.calibration)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (uneven, "not symmetric"),
        (flipped_variance, "negative eigenvalue"),
        (smaller_diagonal, "negative eigenvalue"),
        (exact_but_tied, "variance is zero"),
        (lambda covariance: covariance.fill(0.0), "hard iron known to 0.0e.00"),
        (lambda covariance: covariance.__imul__(1e-12), "no turn shows it better"),
    ],
)
def test_a_covariance_that_is_not_finite_is_refused(found, change, words):
    require_possible(found)
    with pytest.raises(ValueError, match=words):
        require_possible(with_covariance(found, change))


@pytest.mark.parametrize(
    ("entry", "value", "words"),
    [
        ("strength", 48.0, "strength is 4.8e.07 µT"),
        ("strength", 1e-9, "strength is 0.001 µT"),
        ("strength", 0.0, "strength is 0 µT"),
        ("inclination", 65.0, "more than a right angle"),
        ("noise_field", 1.0, "noise_field"),
    ],
)
def test_a_field_that_is_not_on_earth_is_refused(found, entry, value, words):
    with pytest.raises(ValueError, match=words):
        require_possible(replace(found, **{entry: value}))


@pytest.mark.parametrize("value", [math.nan, math.inf, -80.0])
@pytest.mark.parametrize("name", ["latency", "gyro_scale", "local_field"])
def test_a_figure_that_would_spoil_the_heading_is_refused(found, name, value):
    evidence = replace(found.evidence, figures={**found.evidence.figures, name: value})
    with pytest.raises(ValueError, match=name):
        require_possible(replace(found, evidence=evidence))


@pytest.mark.parametrize("strength", [2.1e-6, 190e-6])
def test_every_strength_that_a_verdict_accepts_can_be_stored(strength):
    robot = replace(ROBOT, strength=strength, noise_field=1e-8, hard_iron=np.zeros(3))
    window = measure(robot, turn(), np.random.default_rng(7))
    outcome = calibrate(window, robot.knowledge())
    checks = {check.figure: check.grade for check in outcome.verdict.checks}
    assert checks[Figure.STRENGTH] is Grade.WARN
    require_possible(outcome.calibration)


def test_a_singular_matrix_and_a_hard_iron_in_microtesla_are_refused(found):
    flat = Correction(np.diag([1.0, 1.0, 1e-6]), found.correction.hard_iron)
    with pytest.raises(ValueError, match="multiplies the field by 1e-06 to 1"):
        require_possible(replace(found, correction=flat))
    unit = Correction(found.correction.matrix, found.correction.hard_iron * 1e6)
    with pytest.raises(ValueError, match="hard_iron"):
        require_possible(replace(found, correction=unit))


@pytest.mark.parametrize("gains", [1e3, 3e-3, np.diag([1.0, 50.0, 1.0])])
def test_a_matrix_in_another_unit_is_refused(found, gains):
    edited = Correction(found.correction.matrix @ (gains * np.eye(3)), np.zeros(3))
    with pytest.raises(ValueError, match="correction_matrix multiplies"):
        require_possible(replace(found, correction=edited))


def test_a_hard_iron_in_millitesla_is_refused(found):
    edited = Correction(found.correction.matrix, found.correction.hard_iron * 1e3)
    with pytest.raises(ValueError, match="hard_iron reads up to 2e-02"):
        require_possible(replace(found, correction=edited))


@pytest.mark.parametrize("gains", [[0.1, 0.1, 0.1], [10.0, 0.1, 1.0]])
def test_gains_that_can_be_given_are_possible(found, gains):
    matrix = found.correction.matrix @ np.diag(1.0 / np.array(gains))
    require_possible(replace(found, correction=Correction(matrix, np.full(3, 5e-4))))


def test_an_impossible_file_is_refused_with_its_name(found, tmp_path):
    path = tmp_path / "mag.yaml"
    write_calibration(path, found, Origin.now("mag_link", "imu_link"))
    document = yaml.safe_load(path.read_text())
    document["covariance"][9][9] = 0.0
    path.write_text(yaml.safe_dump(document))
    with pytest.raises(FileError, match=f"{path} is not a usable calibration: covariance"):
        read_calibration(path)
