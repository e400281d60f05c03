"""Robots at rest at known headings, without a turn."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from long_form import first_of

from magcal_ros.core import Belief, Knowledge, Reason, ReferenceField, Refusal
from magcal_ros.core.calibration import heading_differences, heading_jacobian
from magcal_ros.core.geometry import STANDARD_GRAVITY, field_in_enu, rotation_from_rpy, wrapped
from magcal_ros.core.methods import declination_hint
from magcal_ros.core.methods.known_headings import fit
from magcal_ros.core.session import add_known_heading
from magcal_ros.core.simulation import DEGREE, Robot
from magcal_ros.core.smoother import SIZES, KnownHeadingMeasurement, fit_headings

ROBOT = Robot(yaw=2.0 * DEGREE)
SIGMA = 1.0 * DEGREE
PERFECT = np.random.default_rng(0)
THREE = (0.3, 2.3, 4.4)


def knowledge(declination: float = 0.0) -> Knowledge:
    reference = ReferenceField(
        Belief(ROBOT.strength, 1.5e-6), Belief(ROBOT.inclination, DEGREE), declination, 0.5 * DEGREE
    )
    return Knowledge(reference)


def measurements(
    yaws=THREE, rng=None, place: float = 0.0, robot: Robot = ROBOT, is_true: bool = False
) -> list[KnownHeadingMeasurement]:
    """Return what a robot measures at headings to magnetic north, by chance if there is any."""
    found = []
    for yaw in yaws:
        tilt = (0.0, 0.0) if rng is None else 2.0 * DEGREE * rng.standard_normal(2)
        pose = rotation_from_rpy(*tilt, yaw).T
        here = field_in_enu(robot.strength, robot.inclination)
        reported = yaw
        if rng is not None:
            here = here + place * rng.standard_normal(3)
            reported = yaw + SIGMA * rng.standard_normal()
        field = robot.raw_field((pose @ here)[None])[0]
        force = STANDARD_GRAVITY * pose[:, 2]
        found.append(
            KnownHeadingMeasurement(field, force, wrapped(reported), SIGMA, by_declination=is_true)
        )
    return found


def off(correction, robot: Robot = ROBOT) -> np.ndarray:
    return heading_differences(robot.true_correction, correction, robot.strength, robot.inclination)


def test_three_known_headings_determine_the_calibration_and_the_installation_yaw():
    found = fit(measurements(), knowledge())
    assert np.abs(off(found.correction)).max() < 0.3 * DEGREE
    assert found.installation is not None
    assert found.installation.yaw == pytest.approx(ROBOT.yaw, abs=0.3 * DEGREE)
    assert found.arc > 3.5


def test_one_known_heading_is_correct_near_it_and_uncertain_elsewhere():
    found = fit_headings(measurements([0.0]), knowledge()).posterior
    field = field_in_enu(ROBOT.strength, ROBOT.inclination)
    jacobian = heading_jacobian(found.correction, field, 0.0)
    sigma = np.sqrt(np.einsum("ki,ij,kj->k", jacobian, found.covariance, jacobian))
    errors = np.abs(off(found.correction))
    # At the known heading, to the side, and behind.
    assert errors[0] < 0.1 * DEGREE
    assert sigma[0] < 3.5 * DEGREE
    assert sigma[12] > 2.5 * sigma[0]
    assert (errors < 2.0 * sigma).all()


@pytest.mark.parametrize("yaws", [(0.5, 3.4), THREE], ids=len)
def test_the_sigma_is_correct(yaws, request):
    many = request.config.getoption("markexpr") == ""
    ratios = []
    for seed in range(120 if many else 4):
        rng = np.random.default_rng(seed)
        robot = replace(ROBOT, yaw=2.0 * DEGREE * rng.standard_normal())
        found = fit_headings(measurements(yaws, rng, 0.9e-6, robot), knowledge()).posterior
        ratios.append(np.mean(off(found.correction, robot) ** 2) / found.heading_sigma**2)
    assert 0.3 < np.mean(ratios) < 1.5


@pytest.mark.parametrize("seeds", first_of([2, 8]))
def test_a_street_passed_once_counts_once(seeds):
    ratios = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        robot = replace(ROBOT, yaw=2.0 * DEGREE * rng.standard_normal())
        kept, distance = [], 6.0
        correlation, here = math.exp(-distance / 30.0), 2e-6 * rng.standard_normal(3)
        for yaw in np.repeat(np.linspace(0.0, math.tau, 4, endpoint=False), 10):
            here = correlation * here + 2e-6 * math.sqrt(
                1.0 - correlation**2
            ) * rng.standard_normal(3)
            (measurement,) = measurements([yaw + 0.2 * rng.standard_normal()], rng, 0.0, robot)
            pose = rotation_from_rpy(0.0, 0.0, yaw).T
            bent = measurement.field + robot.distortion @ pose @ here
            kept.append(replace(measurement, field=bent, distance=distance))
        found = fit_headings(kept, knowledge(), SIZES["street"]).posterior
        ratios.append(np.mean(off(found.correction, robot) ** 2) / found.heading_sigma**2)
    assert 0.3 < np.mean(ratios) < 1.5


def by_antennas(seed, drift):
    """The fit to a device's headings along a street, with a gyro bias of .03°/s."""
    rng = np.random.default_rng(seed)
    robot = replace(ROBOT, yaw=2.0 * DEGREE * rng.standard_normal())
    bias = 0.03 * DEGREE * rng.standard_normal()
    yaws = np.cumsum(rng.choice([0.0, 0.0, 0.5 * math.pi, -0.5 * math.pi], 40))
    off, here, kept = drift * DEGREE * rng.standard_normal(), 1e-6 * rng.standard_normal(3), []
    for k, yaw in enumerate(yaws):
        (reported,) = measurements([yaw], rng, 0.0, robot)
        here = math.exp(-1.0) * here + 1e-6 * 0.93 * rng.standard_normal(3)
        off = math.exp(-0.05) * off + drift * DEGREE * 0.31 * rng.standard_normal()
        bent = reported.field + robot.distortion @ rotation_from_rpy(0.0, 0.0, yaw).T @ here
        turned = yaw - yaws[k - 1] + 5.0 * bias + 0.2 * DEGREE * rng.standard_normal()
        by_gyro = {"turned": turned, "turned_sigma": 0.3 * DEGREE} if k else {}
        kept.append(
            replace(
                reported,
                field=bent,
                heading=wrapped(reported.heading + off),
                distance=30.0,
                **by_gyro,
            )
        )
        kept[-1] = replace(kept[-1], seconds=5.0 if k else 0.0, drifts=True)
    return robot, kept


LONG = [pytest.param(drift, 30, marks=pytest.mark.nightly) for drift in (0.0, 2.0, 4.0)]


@pytest.mark.parametrize(("drift", "seeds"), [(4.0, 3), *LONG])
def test_drifting_headings_enlarge_the_sigma_and_correct_ones_hardly(drift, seeds):
    squares = []
    for seed in range(seeds):
        robot, kept = by_antennas(50_000 + seed, drift)
        found = fit_headings(kept, knowledge(), SIZES["street"]).posterior
        squares.append((np.mean(off(found.correction, robot) ** 2), found.heading_sigma**2))
    # Whether one drifts is certain in few runs: all of them together are held against sigma.
    off_by, stated = np.mean(squares, axis=0)
    assert off_by < 1.5 * stated
    if not drift:
        assert stated < (0.9 * DEGREE) ** 2


def test_a_device_that_integrates_a_gyro_may_drift_at_a_constant_rate():
    """By .12°/s, which is 24° in the end."""
    squares = []
    for seed in range(86_200, 86_202):
        robot, kept = by_antennas(seed, 0.0)
        reported = [
            replace(each, heading=wrapped(each.heading + 0.6 * DEGREE * k))
            for k, each in enumerate(kept)
        ]
        found = fit_headings(reported, knowledge(), SIZES["street"]).posterior
        squares.append((np.mean(off(found.correction, robot) ** 2), found.heading_sigma**2))
    off_by, stated = np.mean(squares, axis=0)
    assert off_by < (2.5 * DEGREE) ** 2
    assert off_by < 1.5 * stated


@pytest.mark.parametrize(
    ("read", "named"),
    [
        (lambda yaw: yaw - 0.5 * math.pi, "quarter turn too far to the right"),
        *(
            pytest.param(read, named, marks=pytest.mark.nightly)
            for read, named in (
                (lambda yaw: 0.5 * math.pi - yaw, "compass bearing"),
                (lambda yaw: yaw * DEGREE, "radians where degrees"),
                (lambda yaw: -yaw, "mirrored"),
                (lambda yaw: yaw + math.pi, "half a turn"),
            )
        ),
    ],
)
def test_wrongly_interpreted_headings_are_named(read, named):
    reported = [replace(each, heading=wrapped(read(each.heading))) for each in measurements()]
    with pytest.raises(Refusal, match=named) as refusal:
        fit(reported, knowledge())
    assert refusal.value.reason is Reason.HEADING_CONTRADICTED


def test_the_heading_that_contradicts_the_others_is_named():
    reported = measurements()
    reported[1] = replace(reported[1], heading=reported[1].heading + 0.7)
    with pytest.raises(Refusal, match="Known heading 2 of 3"):
        fit(reported, knowledge())


def test_a_gyro_that_measured_another_turn_is_named():
    reported = measurements()
    for k in (1, 2):
        turned = wrapped(reported[k].heading - reported[k - 1].heading)
        reported[k] = replace(reported[k], turned=turned, turned_sigma=2.0 * DEGREE)
    fit(reported, knowledge())
    reported[2] = replace(reported[2], turned=-reported[2].turned)
    with pytest.raises(Refusal, match="Between known headings 2 and 3"):
        fit(reported, knowledge())


def test_magnetic_headings_given_as_true_are_reported():
    declination = 12.0 * DEGREE
    right = measurements(robot=Robot(), is_true=True)
    known = knowledge(declination)
    assert not declination_hint(fit(right, known), right, known)
    wrong = [replace(each, heading=wrapped(each.heading + declination)) for each in right]
    assert "to magnetic north and not to true north" in declination_hint(
        fit(wrong, known), wrong, known
    )


def test_headings_to_true_north_share_the_declinations_error():
    known = knowledge(10.0 * DEGREE)
    alone = fit_headings(measurements(), known).posterior.heading_sigma
    shared = fit_headings(measurements(is_true=True), known).posterior.heading_sigma
    assert shared**2 - alone**2 == pytest.approx((0.5 * DEGREE) ** 2, rel=0.4)


@pytest.mark.nightly
def test_measurements_accumulate_and_a_repeated_one_is_replaced():
    kept = ()
    for each in measurements():
        found = add_known_heading(kept, each, knowledge())
        assert found.applies
        kept = found.measurements
        assert "One more known heading" in found.outcome.verdict.summary
    assert len(kept) == 3
    assert len(add_known_heading(kept, measurements()[0], knowledge()).measurements) == 3
    wrong = add_known_heading(kept, replace(measurements([1.0])[0], heading=-1.0), knowledge())
    assert wrong.measurements == kept
    assert not wrong.applies
    assert "Earlier known headings that are kept: 3." in wrong.outcome.verdict.summary
