"""Iron that is added on the way is told from streets, and when it came is found."""

import math

import numpy as np
import pytest
from simulated.drive import Iron
from streets import BOSTON, driven, heading_error, log_from

from magcal_ros.core.calibration.calibration import Calibration, Evidence
from magcal_ros.core.keeping.candidates import KEEPING
from magcal_ros.core.smoother.drives import drive_nodes
from magcal_ros.core.smoother.iron_added import find_change

NOBODY = np.eye(3)
LEVEL = 51.3e-6 * math.cos(math.radians(66.3))
CAME = 110.0


def in_force(drive, sigma=math.radians(0.8), iron=(0.0, 0.0, 0.0)):
    """What a turn left: right but for some iron, tesla, known to sigma, radians of heading."""
    covariance = np.zeros((12, 12))
    covariance[9:, 9:] = np.eye(3) * (sigma * LEVEL) ** 2
    robot = drive.vehicle.with_iron(np.array(iron)).robot
    evidence = Evidence("maximum_likelihood", "good", "good", "")
    return Calibration(
        robot.true_correction, covariance, 5e-7, 0.01, 51.3e-6, math.radians(66.3), evidence
    )


def changed(drive, **promise):
    nodes = drive_nodes(log_from(drive), NOBODY)
    return find_change(nodes, in_force(drive, **promise), BOSTON)


def gain(drive, **promise):
    found = changed(drive, **promise)
    return -math.inf if found is None else found.gain


@pytest.mark.parametrize("seed", [4, 7])
def test_iron_that_came_half_a_minute_ago_is_found_with_its_moment(seed):
    iron = (8e-6, -6e-6, 0.0)
    drive = driven(seed, CAME + 30.0, irons=(Iron(iron, CAME),))
    found = changed(drive)
    since = found.since - drive.time[0]
    assert found.gain > KEEPING.notice_proof
    assert since == pytest.approx(CAME, abs=1.5)
    with_iron = drive.vehicle.with_iron(np.array(iron)).robot
    assert heading_error(in_force(drive).correction, with_iron) > 10.0
    left = heading_error(found.fit.posterior.correction, with_iron)
    assert left < min(6.0, 3.0 * math.degrees(found.fit.posterior.heading_sigma))


@pytest.mark.parametrize("seed", [4, 7])
def test_streets_are_no_change(seed):
    assert gain(driven(seed, 150.0)) < KEEPING.notice_proof


def test_what_the_calibration_itself_is_uncertain_by_is_no_change():
    drive = driven(4, 150.0)
    off = {"iron": (6e-6, 0.0, 0.0)}
    rough, sure = (gain(drive, sigma=math.radians(sigma), **off) for sigma in (10.0, 0.3))
    assert rough < KEEPING.notice_proof < sure
