"""Iron added during a drive is distinguished from streets, and its time is found."""

import math

import numpy as np
import pytest
from long_form import first_of
from simulated.drive import Iron
from simulated.legs import Leg, city, standing
from streets import BOSTON, driven, heading_error, log_from

from magcal_ros.core import Calibration
from magcal_ros.core.calibration import Evidence
from magcal_ros.core.samples import DriveRecorder, FieldSample, ImuSample, Pair
from magcal_ros.core.self_calibration import SELF_CALIBRATION
from magcal_ros.core.smoother import drive_nodes, find_change, iron_added

NOBODY = np.eye(3)
LEVEL = 51.3e-6 * math.cos(math.radians(66.3))
CAME = 110.0


def in_force(drive, sigma=math.radians(0.8), iron=(0.0, 0.0, 0.0)):
    """A calibration by a turn, correct but for some iron (tesla), with a sigma in radians."""
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


@pytest.mark.nightly
@pytest.mark.parametrize("seed", first_of([4, 7]))
def test_iron_added_half_a_minute_ago_is_found_with_its_time(seed):
    iron = (8e-6, -6e-6, 0.0)
    drive = driven(seed, CAME + 30.0, irons=(Iron(iron, CAME),))
    found = changed(drive)
    since = found.since - drive.time[0]
    assert found.gain > SELF_CALIBRATION.notice
    assert since == pytest.approx(CAME, abs=1.5)
    with_iron = drive.vehicle.with_iron(np.array(iron)).robot
    assert heading_error(in_force(drive).correction, with_iron) > 10.0
    left = heading_error(found.fit.posterior.correction, with_iron)
    assert left < min(6.0, 3.0 * math.degrees(found.fit.posterior.heading_sigma))


def test_an_uncertain_moment_enlarges_the_sigma(monkeypatch):
    """If no moment is likelier than another, the posterior covers the fits of all."""
    drive = driven(4, CAME + 30.0, irons=(Iron((8e-6, -6e-6, 0.0), CAME),))
    by_evidence = changed(drive).fit.posterior
    monkeypatch.setattr(iron_added, "EVIDENCE_WEIGHT", 0.0)
    by_all = changed(drive).fit.posterior
    assert by_all.heading_sigma > by_evidence.heading_sigma
    assert by_all.distance_to(by_evidence) < 2.0 * by_all.heading_sigma


@pytest.mark.parametrize("seed", first_of([4, 7]))
def test_streets_are_no_change(seed):
    assert gain(driven(seed, 150.0)) < SELF_CALIBRATION.notice


@pytest.mark.nightly
def test_the_uncertainty_of_the_calibration_is_no_change():
    drive = driven(4, 120.0)
    off = {"iron": (6e-6, 0.0, 0.0)}
    rough, sure = (gain(drive, sigma=math.radians(sigma), **off) for sigma in (10.0, 0.3))
    assert rough < SELF_CALIBRATION.notice < sure


def recorded(drive, added):
    """The log of a drive to whose field something is added, tesla."""
    recorder = DriveRecorder(600.0)
    rows = zip(drive.time, drive.field + added, drive.force, drive.rate, strict=True)
    for stamp, field, force, rate in rows:
        imu = ImuSample(stamp, tuple(force), tuple(rate))
        recorder.add(Pair(FieldSample(stamp, tuple(field)), imu))
    return recorder.log()


def from_a_stop(seed):
    """A drive that stops, and then goes straight on for half a minute; when it starts to do so."""
    town = city(np.random.default_rng(seed), 100.0)
    legs = [*town, *standing(12.0), Leg(4.0, 10.0), Leg(26.0, 10.0)]
    drive = driven(seed, legs=legs)
    return drive, drive.time[-1] - 30.0


@pytest.mark.nightly
@pytest.mark.parametrize("quarter", first_of(range(4)))
def test_iron_added_at_rest_is_found_before_a_turn(quarter):
    drive, start = from_a_stop(5)
    way = 0.5 * math.pi * quarter
    iron = 10e-6 * np.array([math.cos(way), math.sin(way), 0.0])
    log = recorded(drive, np.outer(drive.time > start - 4.0, iron))
    found = find_change(drive_nodes(log, NOBODY), in_force(drive), BOSTON)
    assert found.gain > SELF_CALIBRATION.notice
    came = found.fit.posterior.correction.hard_iron - in_force(drive).correction.hard_iron
    assert came == pytest.approx(iron, abs=3e-6)


@pytest.mark.nightly
def test_steel_beside_the_road_is_not_taken_for_added_iron():
    drive, start = from_a_stop(5)
    steel = (drive.time > start + 15.0)[:, None] * (drive.truth.attitude @ [0.0, 12e-6, -9e-6])
    nodes = drive_nodes(recorded(drive, steel), NOBODY)
    found = find_change(nodes, in_force(drive), BOSTON)
    assert found is None or found.gain < SELF_CALIBRATION.notice
