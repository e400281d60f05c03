"""A field that points up instead of down is reported after a level turn."""

import math
from dataclasses import replace

import numpy as np
import pytest
from imu_faults_cases import good_case
from long_form import first_of
from simulated.turns import measure, smooth_wobble, turn

from magcal_ros.core import Knowledge
from magcal_ros.core.doctor import FIELD_POINTS_UP, examine, examine_window
from magcal_ros.core.knowledge import knowledge_of
from magcal_ros.core.simulation import Robot

PLACE = knowledge_of(48.0, inclination_deg=64.0)


def named(dip, knowledge, iron=(12.0, -7.0, 10.0), wobble=None):
    """Whether the report names a field that points up."""
    robot = Robot(strength=48e-6, inclination=math.radians(dip), hard_iron=1e-6 * np.array(iron))
    window = measure(robot, turn(wobble=wobble), np.random.default_rng(3), gyro=True)
    findings = examine_window(window, knowledge).findings
    return any(finding.remedy.endswith(FIELD_POINTS_UP) for finding in findings)


@pytest.mark.nightly
@pytest.mark.parametrize("dip", first_of([-64.0, 64.0]))
def test_a_field_that_points_up_is_named_after_a_level_turn(dip):
    assert named(dip, knowledge_of(48.0, inclination_deg=-dip))


@pytest.mark.nightly
@pytest.mark.parametrize(
    "iron", first_of([(12.0, -7.0, 10.0), (40.0, 0.0, -40.0), (0.0, 0.0, 40.0)])
)
def test_a_correct_field_is_not_reported(iron):
    assert not named(64.0, PLACE, iron)


@pytest.mark.nightly
def test_nothing_is_reported_without_a_reference():
    assert not named(-64.0, Knowledge())


def test_a_turn_that_determines_the_dip_gives_its_own_finding():
    leans = smooth_wobble(np.random.default_rng(4), 500, 15.0, math.radians(10.0))
    assert not named(64.0, PLACE, (0.0, 0.0, -86.0), leans)


def test_it_is_named_if_a_lift_does_not_show_the_wrong_sensor():
    case = good_case(np.random.default_rng([5, 3]), "quarter")
    report = examine(replace(case.log, field=-case.log.field), case.knowledge)
    (line,) = (finding for finding in report.findings if finding.key == "axes")
    assert "magnetometer or accelerometer" in line.evidence
    assert line.remedy.endswith(FIELD_POINTS_UP)
