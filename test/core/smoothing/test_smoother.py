"""The smoother finds a calibration in a drive, and says how sure it is."""

import dataclasses
import math

import numpy as np
import pytest
from long_windows import (
    PAPER_SOFT_IRON,
    swaying,
    swaying_robot,
    swaying_window,
)
from simulated.legs import Leg, city
from streets import BOSTON, driven, heading_error, log_from

from magcal_ros.core.errors import Refusal
from magcal_ros.core.knowledge import knowledge_of
from magcal_ros.core.samples.window import Window
from magcal_ros.core.smoothing.certainty import cluster_scores
from magcal_ros.core.smoothing.chain import eliminate, own_covariances
from magcal_ros.core.smoothing.descent import Linearisation, Problem, descend
from magcal_ros.core.smoothing.drive_model import (
    SHARED,
    SOFT,
    Unknowns,
    field_jacobians,
    field_of,
    free_prior,
)
from magcal_ros.core.smoothing.fit import fit_iron, fit_nodes, held_fit, linear_start
from magcal_ros.core.smoothing.log import log_of

MICRO = 1e6
NOBODY = np.eye(3)


@pytest.fixture(scope="module")
def drive():
    return driven(4, 300.0)


@pytest.fixture(scope="module")
def nodes(drive):
    return log_from(drive).nodes(NOBODY)


@pytest.fixture(scope="module")
def fitted(nodes):
    return fit_nodes(nodes, BOSTON)


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def somewhere(nodes, rng):
    shared = free_prior(BOSTON).mean + rng.normal(0.0, 0.05, SHARED)
    return Unknowns(shared, rng.normal(0.0, 2.0, len(nodes)), rng.normal(0.0, 3.0, (len(nodes), 3)))


def test_the_jacobians_are_the_slopes_of_the_field(nodes, rng):
    nodes = nodes.take(np.arange(5))
    place = somewhere(nodes, rng)
    local, every = field_jacobians(nodes, place)
    for k in range(SHARED):
        step = np.zeros(SHARED)
        step[k] = 1e-5
        still = np.zeros((5, 4))
        ends = [field_of(nodes, place.moved(way * step, still)) for way in (1.0, -1.0)]
        assert every[:, :, k] == pytest.approx((ends[0] - ends[1]) / 2e-5, abs=1e-5)
    for k in range(4):
        step = np.zeros((5, 4))
        step[:, k] = 1e-5
        ends = [field_of(nodes, place.moved(np.zeros(SHARED), way * step)) for way in (1.0, -1.0)]
        assert local[:, :, k] == pytest.approx((ends[0] - ends[1]) / 2e-5, abs=1e-5)


def test_the_gradient_is_the_slope_of_the_cost(nodes, rng):
    nodes = dataclasses.replace(
        nodes.take(np.arange(6)), course=np.full(6, 0.3), course_sigma=np.full(6, 0.1)
    )
    place = somewhere(nodes, rng)
    problem = Problem(nodes, free_prior(BOSTON))
    chain = Linearisation(problem, place).chain

    def cost(shared, local):
        return Linearisation(problem, place.moved(shared, local)).cost

    for k in range(SHARED):
        step = np.zeros(SHARED)
        step[k] = 1e-6
        still = np.zeros((6, 4))
        slope = (cost(step, still) - cost(-step, still)) / 2e-6
        assert -2.0 * chain.shared_gradient[k] == pytest.approx(slope, rel=1e-4, abs=1e-2)
    for j, k in ((0, 0), (2, 0), (2, 1), (5, 3), (0, 2)):
        step = np.zeros((6, 4))
        step[j, k] = 1e-6
        slope = (cost(np.zeros(SHARED), step) - cost(np.zeros(SHARED), -step)) / 2e-6
        assert -2.0 * chain.local_gradient[j, k] == pytest.approx(slope, rel=1e-4, abs=1e-2)


def test_the_chain_is_solved_as_the_whole_matrix_would_be(nodes, rng):
    nodes = nodes.take(np.arange(8))
    chain = Linearisation(Problem(nodes, free_prior(BOSTON)), somewhere(nodes, rng)).chain
    n = len(nodes)
    whole = np.zeros((4 * n + SHARED, 4 * n + SHARED))
    for j in range(n):
        own = slice(4 * j, 4 * j + 4)
        whole[own, own] = chain.blocks[j]
        whole[own, 4 * n :] = chain.coupling[j]
        whole[4 * n :, own] = chain.coupling[j].T
        if j:
            before = slice(4 * j - 4, 4 * j)
            whole[before, own] = whole[own, before] = np.diag(chain.ties[j - 1])
    local = whole[: 4 * n, : 4 * n].copy()
    whole[4 * n :, 4 * n :] = chain.shared
    right = np.concatenate([chain.local_gradient.ravel(), chain.shared_gradient])
    step = np.linalg.solve(whole, right)
    found = eliminate(chain)
    assert found.shared_step == pytest.approx(step[4 * n :], rel=1e-6, abs=1e-9)
    assert found.local_step.ravel() == pytest.approx(step[: 4 * n], rel=1e-6, abs=1e-9)
    shared = np.linalg.inv(np.linalg.inv(whole)[4 * n :, 4 * n :])
    assert found.information == pytest.approx(shared, rel=1e-6, abs=1e-6)
    own, between = own_covariances(chain)
    inverse = np.linalg.inv(local)
    assert own[3] == pytest.approx(inverse[12:16, 12:16], rel=1e-6, abs=1e-12)
    assert between[3] == pytest.approx(inverse[12:16, 16:20], rel=1e-6, abs=1e-12)


def test_a_drive_shows_the_calibration_within_what_is_said(drive, fitted):
    error = heading_error(fitted.twelve.correction, drive.vehicle.robot)
    said = math.degrees(fitted.twelve.heading_sigma)
    assert error < 3.0
    assert said < 3.0
    assert error < 2.5 * said
    assert fitted.smoothed.converged
    assert fitted.sectors >= 6


def test_the_pulls_of_the_roads_add_up_to_the_priors(fitted):
    smoothed = fitted.smoothed
    pull = cluster_scores(smoothed).sum(axis=0)
    prior = smoothed.problem.prior.information @ smoothed.here.shared_gap
    sigma = np.sqrt(np.diag(np.linalg.inv(smoothed.eliminated.information)))
    assert (pull - prior) * sigma == pytest.approx(np.zeros(SHARED), abs=0.02)


def test_a_fifth_piece_of_road_makes_no_drive_less_certain():
    """From there on the pieces tell how much they differ; five of them say little of it."""
    shorter, longer = [], []
    for seed in (10, 11, 14, 17):
        nodes = log_from(driven(seed, 240.0)).nodes(NOBODY)
        metres = np.cumsum(nodes.metres)
        for pieces, said in ((4, shorter), (5, longer)):
            road = nodes.take(np.flatnonzero(metres < 150.0 * pieces - 1.0))
            said.append(fit_nodes(road, BOSTON).twelve.heading_sigma)
    assert np.mean(longer) < np.mean(shorter)


def test_nothing_moves_when_it_starts_at_the_optimum(fitted):
    again = descend(fitted.smoothed.problem, fitted.smoothed.unknowns)
    assert again.rounds == 1


def test_a_start_eighty_degrees_off_is_found_all_the_same(drive):
    vehicle = dataclasses.replace(
        drive.vehicle,
        robot=dataclasses.replace(drive.vehicle.robot, hard_iron=np.array([90e-6, -60e-6, 40e-6])),
    )
    other = driven(5, 240.0, vehicle=vehicle)
    found = fit_nodes(log_from(other).nodes(NOBODY), BOSTON)
    assert heading_error(found.twelve.correction, vehicle.robot) < 4.0


def test_a_wrong_gyro_does_not_shrink_the_compass(nodes):
    """The yaw is given wrongly: E stays within three sigmas of its prior, and A does not vanish."""
    wrong = dataclasses.replace(nodes, turned=-nodes.turned)
    prior = free_prior(BOSTON)
    start, prior = linear_start(wrong, prior)
    found = descend(Problem(wrong, prior), start)
    assert np.abs(found.unknowns.shared[SOFT] / prior.sigma[SOFT]).max() < 3.0
    assert np.linalg.det(found.unknowns.distortion) == pytest.approx(1.0, abs=0.1)


def test_a_standing_robot_adds_one_node():
    drive = driven(3, legs=[Leg(120.0)])
    assert len(log_from(drive).nodes(NOBODY)) <= 4
    with pytest.raises(Refusal, match="drive on"):
        fit_nodes(log_from(drive).nodes(NOBODY), BOSTON)


def test_nodes_that_are_left_out_leave_their_way(nodes):
    rows = np.arange(0, len(nodes), 3)
    some = nodes.take(rows)
    assert some.heading[-1] == pytest.approx(nodes.heading[rows[-1]])
    assert some.metres.sum() == pytest.approx(nodes.metres[: rows[-1] + 1].sum(), abs=5.0)
    assert not some.is_tied[0]
    assert some.is_tied[1:].all()


def test_the_iron_that_was_added_is_found_in_ninety_seconds(drive):
    robot = drive.vehicle.robot
    changed = drive.vehicle.with_iron(np.array([8e-6, -6e-6, 0.0]))
    other = driven(9, 90.0, vehicle=changed)
    found = fit_iron(log_from(other).nodes(NOBODY), robot.true_correction, BOSTON)
    before = heading_error(robot.true_correction, changed.robot)
    after = heading_error(found.twelve.correction, changed.robot)
    assert before > 10.0
    assert after < min(6.0, 3.0 * math.degrees(found.twelve.heading_sigma))


def test_the_true_calibration_is_likelier_than_a_wrong_one(drive, fitted):
    robot = drive.vehicle.robot
    wrong = drive.vehicle.with_iron(np.array([5e-6, 0.0, 0.0])).robot.true_correction
    sizes = fitted.smoothed.problem.sizes
    true, off = (
        held_fit(fitted.nodes, each, BOSTON, sizes) for each in (robot.true_correction, wrong)
    )
    assert off.here.cost - true.here.cost > 48.0


def test_a_drive_whose_stamps_come_in_bursts_is_refused_by_name(drive):
    """A buffer that is read once a second: what was turned between, nobody knows."""
    window = Window(drive.time, drive.field, drive.force, drive.rate)
    read = np.floor(window.time)
    bursts = dataclasses.replace(window, time=read + 0.05 * (window.time - read))
    nodes = log_of(bursts).nodes(NOBODY)
    with pytest.raises(Refusal, match="in bursts"):
        fit_nodes(nodes, BOSTON)
    assert fit_iron(nodes, drive.vehicle.robot.true_correction, BOSTON) is None


LONG = knowledge_of(47.3, inclination_deg=60.5)


def weak_motion(seconds, turns, soft_iron, seed):
    """Error and sigma of the heading, degrees, of a robot that sways where it is."""
    robot = swaying_robot(soft_iron)
    window = swaying_window(robot, swaying(seconds, turns=turns), np.random.default_rng(seed))
    found = fit_nodes(log_of(window).nodes(NOBODY), LONG)
    error = heading_error(found.twelve.correction, robot)
    return error, math.degrees(found.twelve.heading_sigma)


@pytest.mark.parametrize("turns", [False, True])
@pytest.mark.parametrize("soft_iron", [np.zeros((3, 3)), PAPER_SOFT_IRON])
def test_two_minutes_of_weak_motion(turns, soft_iron):
    """Nothing pulls: no road is made up for it, nor the sigma that roads leave."""
    error, said = weak_motion(120.0, turns, soft_iron, 1)
    assert error < 0.6
    assert error < 2.5 * said
    assert said < 0.6


@pytest.mark.nightly
@pytest.mark.timeout(900)
@pytest.mark.parametrize("turns", [False, True])
@pytest.mark.parametrize("soft_iron", [np.zeros((3, 3)), PAPER_SOFT_IRON])
@pytest.mark.parametrize("seconds", [120.0, 600.0])
def test_weak_motion_over_many_windows(seconds, turns, soft_iron):
    errors, said = np.array([weak_motion(seconds, turns, soft_iron, k) for k in range(20)]).T
    assert math.sqrt(np.mean(errors**2)) < 0.45
    assert np.mean((errors / said) ** 2) < 2.0


def test_a_robot_that_creeps_along_a_street_says_no_more_than_it_may():
    """Nothing pulls here either, but the street is in what is left of the field."""
    drive = driven(3, legs=city(np.random.default_rng(3), 120.0, fastest=0.4))
    found = fit_nodes(log_from(drive).nodes(NOBODY), BOSTON)
    error = heading_error(found.twelve.correction, drive.vehicle.robot)
    said = math.degrees(found.twelve.heading_sigma)
    assert found.metres == 0.0
    assert error < 2.5 * said
    assert said > 1.0


@pytest.mark.nightly
@pytest.mark.timeout(900)
@pytest.mark.parametrize("seconds", [120.0, 300.0])
@pytest.mark.parametrize("speed", [False, True])
def test_sigma_is_right_over_many_drives(seconds, speed):
    errors, said = [], []
    for seed in range(100):
        drive = driven(seed, seconds)
        twelve = fit_nodes(log_from(drive, speed=speed).nodes(NOBODY), BOSTON).twelve
        errors.append(heading_error(twelve.correction, drive.vehicle.robot))
        said.append(math.degrees(twelve.heading_sigma))
    wrong, predicted = (math.sqrt(np.mean(np.square(each))) for each in (errors, said))
    assert wrong < (3.0 if seconds > 200.0 else 4.5)
    assert 1.0 / 1.5 < wrong / predicted < 1.5
    assert 0.3 < np.mean((np.array(errors) / said) ** 2) < 2.0
