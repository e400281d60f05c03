"""A reference of the wrong sign looks like a magnet along the axis of the turn; it is reported."""

import math

import numpy as np
import pytest
from long_form import first_of
from simulated.turns import measure, smooth_wobble, turn

from magcal_ros.core import Belief, Figure, Grade, Knowledge, ReferenceField, calibrate
from magcal_ros.core.simulation import DEGREE, Robot

pytestmark = pytest.mark.usefixtures("right_axes")

STRENGTH = 48e-6


def outcome_of(iron, dip=65.0, reported=None, wobble=0.0, seed=1, gyro=True):
    """Calibrate a robot with a hard iron (µT) and a wrong reference inclination."""
    rng = np.random.default_rng(seed)
    robot = Robot(
        strength=STRENGTH, inclination=dip * DEGREE, hard_iron=1e-6 * np.array(iron, dtype=float)
    )
    leans = smooth_wobble(rng, 500, 15.0, wobble * DEGREE, (0.05, 0.5)) if wobble else None
    window = measure(robot, turn(wobble=leans), rng, gyro=gyro)
    reported = dip if reported is None else reported
    reference = ReferenceField(Belief(STRENGTH, 1.5e-6), Belief(reported * DEGREE, DEGREE))
    return calibrate(window, Knowledge(reference))


def doubt(outcome):
    found = [check for check in outcome.verdict.checks if check.figure is Figure.AXIAL_IRON]
    return found[0] if found else None


@pytest.mark.parametrize("dip", first_of([-50.0, 30.0, 65.0, 75.0]))
def test_a_wrong_sign_of_the_inclination_gives_a_warning(dip):
    outcome = outcome_of((15, -8, 10), dip, -dip)
    check = doubt(outcome)
    assert check.grade is Grade.WARN
    assert outcome.verdict.confidence is not Grade.EXCELLENT
    assert "check the sign of reference.inclination_deg" in check.words
    assert "the sign of reference.inclination_deg" in outcome.verdict.summary
    size = abs(
        1e-6 * 10.0 + math.copysign(1.0, dip) * -2.0 * STRENGTH * math.sin(abs(dip) * DEGREE)
    )
    assert float(check.words.partition("field, ")[2].split()[0]) == pytest.approx(
        size * 1e6, rel=0.1
    )


@pytest.mark.nightly
@pytest.mark.parametrize("dip", first_of([65.0, 30.0, -50.0, 75.0]))
@pytest.mark.parametrize("iron", first_of([(120, -60, 10), (15, -8, 10), (0, 150, -15), (0, 0, 0)]))
def test_iron_across_the_axis_gives_no_warning_on_the_reference(dip, iron):
    outcome = outcome_of(iron, dip)
    assert doubt(outcome).grade is Grade.EXCELLENT
    assert outcome.verdict.accepted


@pytest.mark.parametrize("height", first_of([-70.0, 70.0]))
def test_an_axial_magnet_larger_than_the_field_gives_a_warning(height):
    check = doubt(outcome_of((5, 5, height), 20.0))
    assert check.grade is Grade.WARN
    assert "more than the field itself" in check.words


@pytest.mark.nightly
def test_strong_axial_hard_iron_is_expected_if_that_across_the_axis_is_strong():
    assert doubt(outcome_of((20, -20, 52), 65.0)).grade is Grade.EXCELLENT
    assert doubt(outcome_of((4, -4, 52), 65.0)).grade is Grade.WARN


@pytest.mark.nightly
def test_a_turn_that_shows_the_axial_field_gives_no_warning_on_the_reference():
    right = outcome_of((15, -8, 85), 65.0, wobble=4.0, gyro=False)
    assert doubt(right) is None
    assert right.verdict.accepted
    assert not outcome_of((15, -8, 85), 65.0, -65.0, wobble=4.0, gyro=False).verdict.accepted


def test_without_a_reference_there_is_no_warning_on_it():
    rng = np.random.default_rng(1)
    robot = Robot(hard_iron=np.array([0.0, 0.0, 90e-6]))
    outcome = calibrate(measure(robot, turn(), rng, gyro=True), Knowledge())
    assert doubt(outcome) is None


@pytest.mark.nightly
@pytest.mark.parametrize("factor", first_of([0.7, 1.4, 0.5, 2.0]))
def test_a_strength_wrong_by_a_factor_is_not_excellent(factor):
    rng = np.random.default_rng(1)
    window = measure(Robot(strength=STRENGTH, inclination=65.0 * DEGREE), turn(), rng)
    beliefs = Belief(factor * STRENGTH, 1.5e-6), Belief(65.0 * DEGREE, DEGREE)
    verdict = calibrate(window, Knowledge(ReferenceField(*beliefs))).verdict
    assert Grade.WARN.rank <= max(verdict.quality.rank, verdict.confidence.rank)
