"""Comparison of two calibrations on held-out data, one of them refitted during the drive."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from long_form import first_of
from simulated.drive import Fence, Vehicle, simulated_drive
from simulated.legs import city
from simulated.travel import travel

from magcal_ros.core import Belief, Figure, Knowledge, Window
from magcal_ros.core.assessment import LEVEL_ONLY, NO_REFERENCE
from magcal_ros.core.earth_field import made_elsewhere
from magcal_ros.core.knowledge import knowledge_of
from magcal_ros.core.samples import log_of
from magcal_ros.core.self_calibration import (
    CandidateKind,
    DriveJob,
    examine_drive,
    ratio_on,
    reason_to_accept,
)
from magcal_ros.core.simulation import Robot
from magcal_ros.core.smoother import drive_nodes

BOSTON = knowledge_of(51.3, inclination_deg=66.3)
ROBOT = Robot(strength=51.3e-6, inclination=math.radians(66.3), noise_field=0.3e-6)
RIGHT = ROBOT.true_correction
OLD, WORSE = (
    Vehicle(ROBOT).with_iron(np.array([0.0, iron, 0.0])).robot.true_correction
    for iron in (15e-6, 30e-6)
)


def driven(**options):
    rng = np.random.default_rng(4)
    way = travel(city(rng, 120.0), rng, rate=10.0)
    drive = simulated_drive(way, rng, Vehicle(ROBOT), **options)
    window = Window(drive.time, drive.field, drive.force, drive.rate)
    return drive_nodes(log_of(window), np.eye(3))


def proved(road, new, old=OLD):
    return ratio_on(road, *(SimpleNamespace(correction=each) for each in (old, new)), BOSTON)


@pytest.fixture(scope="module")
def road():
    return driven()


@pytest.fixture(scope="module")
def whole(road):
    """The comparison on all data for the correct calibration."""
    return proved(road, RIGHT)


@pytest.mark.parametrize("knowledge", [BOSTON, Knowledge()])
def test_a_candidate_says_whether_the_reference_was_known(knowledge):
    """Without it, a place that is met later is not another one than that of the drive."""
    rng = np.random.default_rng(4)
    drive = simulated_drive(travel(city(rng, 130.0), rng, rate=10.0), rng, Vehicle(ROBOT))
    log = log_of(Window(drive.time, drive.field, drive.force, drive.rate))
    job = DriveJob(log, knowledge, None, (120.0,))
    (found,) = examine_drive(job).candidates
    evidence = found.calibration.evidence
    is_known = knowledge is BOSTON
    assert (NO_REFERENCE in evidence.not_shown) is not is_known
    assert (LEVEL_ONLY in evidence.not_shown) is not is_known
    found_with = evidence.figure(Figure.REFERENCE_STRENGTH, 0.0)
    assert found_with == pytest.approx(51.3e-6 if is_known else 0.0)
    of_another_place = replace(
        BOSTON.reference, inclination=Belief(0.5, 0.02), strength=Belief(4e-5, 1e-6)
    )
    assert bool(made_elsewhere(found.calibration, of_another_place)) is is_known


def test_the_correct_one_is_likelier_in_both_halves(whole):
    middle = len(whole.by_node) // 2
    assert whole.gain > 10.0
    assert min(whole.by_node[:middle].sum(), whole.by_node[middle:].sum()) > 5.0
    assert "even if a part of it was disturbed" in reason_to_accept(CandidateKind.IRON, whole)


def test_too_little_data_give_an_empty_ratio(road):
    assert proved(road.after(road.time[-3]), RIGHT).seconds == 0.0


def test_added_iron_shows_at_more_than_one_quarter_of_the_headings(whole):
    assert 20.0 < whole.log_odds(0.01) < whole.gain


@pytest.mark.nightly
@pytest.mark.parametrize("heading", first_of([90.0, 0.0, 180.0, 270.0]))
def test_steel_beside_the_road_is_not_taken_for_added_iron(heading):
    side = (0.0, 15e-6, 0.0)
    road = driven(fences=(Fence(side, math.radians(heading), math.radians(100.0)),))
    proof = proved(road, OLD, old=RIGHT)
    assert reason_to_accept(CandidateKind.IRON, proof) == ""
    # Also if one heading contributes very much, in both halves.
    most = np.full(10, np.abs(proof.by_node).sum() + 2.0)
    best = np.full(10, np.argmax(np.bincount(proof.sector, proof.by_node, 12)))
    explained = replace(
        proof,
        by_node=np.concatenate([most, proof.by_node, most]),
        sector=np.concatenate([best, proof.sector, best]),
    )
    assert explained.gain > 8.0
    assert reason_to_accept(CandidateKind.IRON, explained) == ""
