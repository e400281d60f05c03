"""Calibration at rest at known headings, without a turn."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from magcal_ros.core.assessment.grading import DEGREES
from magcal_ros.core.calibration.calibration import Estimate, Installation
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.attitude import unit, wrapped
from magcal_ros.core.knowledge import CLEAR, Knowledge, in_level_axes
from magcal_ros.core.samples.coverage import Coverage
from magcal_ros.core.smoother.headings import (
    HeadingAgreement,
    KnownHeadingMeasurement,
    KnownHeadingModel,
    agreement_of,
    fit_headings,
)
from magcal_ros.core.smoother.posterior import posterior_at
from magcal_ros.core.smoother.unknowns import DISTURBANCE_AT_REST, ROLL_PITCH, YAW, Size

METHOD = "known_headings"
LEAST_CHANCE = 1e-3
"""Least probability of a larger misfit by chance (p-value), and of the headings as they were given,
against another interpretation of them."""
QUARTER = 0.5 * math.pi
READINGS: dict[str, tuple[float, float]] = {
    "they count clockwise from north, as a compass bearing does: give the yaw to the left from "
    "east (ENU), which is 90° minus the bearing": (-1.0, QUARTER),
    "their sign is wrong, or the antennas are mirrored: yaw counts to the left from east (ENU)": (
        -1.0,
        0.0,
    ),
    "they are half a turn off: front and back, or the two antennas, are exchanged": (1.0, math.pi),
    "they are a quarter turn too far to the right: yaw is zero to the east, not to the north, "
    "and two antennas mounted across the vehicle have another yaw than the vehicle": (1.0, QUARTER),
    "they are a quarter turn too far to the left: two antennas mounted across the vehicle have "
    "another yaw than the vehicle": (1.0, -QUARTER),
    "they are in radians where degrees are expected": (DEGREES, 0.0),
}
"""Common mistakes of headings, and the factor and shift (radians) that correct them."""


@in_level_axes
def fit(
    measurements: Sequence[KnownHeadingMeasurement],
    knowledge: Knowledge,
    place: Size = DISTURBANCE_AT_REST,
) -> Estimate:
    """Find the twelve numbers from known headings.

    Returns
    -------
    Estimate
        Includes the yaw of the installation. Its samples are the measurements.

    Raises
    ------
    Refusal
        If headings, field and gyro contradict each other; the text names what is likely wrong.
    """
    try:
        found = fit_headings(measurements, knowledge, place)
    except np.linalg.LinAlgError:
        words = "the samples do not determine a calibration; stand at another known heading"
        raise Refusal(Reason.NO_SOLUTION, words) from None
    words = _contradiction(found.agreement, measurements, knowledge, place)
    if words:
        raise Refusal(Reason.HEADING_CONTRADICTED, words)
    shared, posterior = found.state.shared, found.posterior
    roll, pitch = shared[ROLL_PITCH]
    count = len(measurements)
    figures = {
        Figure.KNOWN_HEADINGS: float(count),
        Figure.INSTALLATION_YAW_SIGMA: math.sqrt(found.covariance[YAW, YAW]),
        Figure.SOFT_IRON: 1.0,
    }
    if count > 1:
        figures[Figure.HEADING_MISFIT] = found.agreement.times
    return Estimate(
        method=METHOD,
        correction=posterior.correction,
        covariance=posterior.covariance,
        installation=Installation(float(roll), float(pitch), float(shared[YAW])),
        axis=unit(np.mean([unit(each.force) for each in measurements], axis=0)),
        arc=math.tau - Coverage.of(np.array([each.heading for each in measurements])).gap,
        strength=posterior.strength,
        inclination=posterior.inclination,
        noise_field=max(each.noise_field for each in measurements),
        noise_up=max(each.noise_up for each in measurements),
        inliers=np.ones(count, dtype=bool),
        residual=found.residual,
        figures=figures,
        message="converged",
    )


def _contradiction(
    agreement: HeadingAgreement,
    measurements: Sequence[KnownHeadingMeasurement],
    knowledge: Knowledge,
    place: Size,
) -> str:
    """Say how field and gyro contradict the headings, with the likely mistake; empty if not."""
    if not agreement.freedom:
        return ""
    count, reference = len(measurements), knowledge.reference
    norths = [reference.to_magnetic(each.by_declination) or 0.0 for each in measurements]
    rivals = {
        words: agreement_of(read, knowledge, place)
        for words, read in _other_readings(measurements, norths).items()
    }
    words = min(rivals, key=lambda each: rivals[each].cost)
    is_likelier = agreement.cost - rivals[words].cost > -2.0 * math.log(LEAST_CHANCE)
    if is_likelier and rivals[words].chance > LEAST_CHANCE:
        return f"The known headings contradict the field: {words}. Corrected so, they agree."
    if agreement.chance >= LEAST_CHANCE:
        return ""
    apart = [replace(each, turned_sigma=math.inf) for each in measurements]
    if agreement_of(apart, knowledge, place).chance > LEAST_CHANCE:
        return _by_gyro(measurements)
    if count > 2:
        found = [agreement_of(_without(measurements, k), knowledge, place) for k in range(count)]
        k = min(range(count), key=lambda j: found[j].cost)
        if found[k].chance > LEAST_CHANCE:
            odd = measurements[k]
            given = wrapped(odd.heading - norths[k]) * DEGREES
            return (
                f"Known heading {k + 1} of {count} ({given:.0f}° to "
                f"{'true' if odd.by_declination else 'magnetic'} north) contradicts the others, by "
                "the field: check that it was typed correctly, and that no iron stood beside the "
                "robot there."
            )
    return (
        f"The known headings contradict the field by {agreement.times:.1f} times what their "
        "sigmas explain: check headings and sigmas, and stand away from iron."
    )


def _other_readings(
    measurements: Sequence[KnownHeadingMeasurement], norths: Sequence[float]
) -> dict[str, list[KnownHeadingMeasurement]]:
    """Return other interpretations of headings, by their words.

    `norths` are the headings to magnetic north minus the given ones, radians.
    """
    found, pairs = {}, list(zip(measurements, norths, strict=True))
    for words, (factor, shift) in READINGS.items():
        yaws = [factor * wrapped(each.heading - north) for each, north in pairs]
        # No yaw in radians is beyond half a turn.
        if max(map(abs, yaws)) <= math.pi:
            found[words] = [
                replace(each, heading=wrapped(yaw + shift + north))
                for (each, north), yaw in zip(pairs, yaws, strict=True)
            ]
    return found


def _by_gyro(measurements: Sequence[KnownHeadingMeasurement]) -> str:
    """Say between which headings the gyro measured another turn."""

    def off(k: int) -> float:
        one, next_ = measurements[k], measurements[k + 1]
        return wrapped(next_.heading - one.heading - next_.turned)

    k = max(
        range(len(measurements) - 1), key=lambda j: abs(off(j)) / measurements[j + 1].turned_sigma
    )
    given = wrapped(measurements[k + 1].heading - measurements[k].heading) * DEGREES
    seen = wrapped(measurements[k + 1].turned) * DEGREES
    return (
        f"Between known headings {k + 1} and {k + 2} the robot should have turned by {given:.0f}°, "
        f"but the gyro measured {seen:.0f}° (to the left): check both headings, and the sign and "
        "unit (rad/s) of the gyro."
    )


def _without(
    measurements: Sequence[KnownHeadingMeasurement], left_out: int
) -> list[KnownHeadingMeasurement]:
    """Return all measurements but one, without the gyro's turn across the gap."""
    rest = [each for k, each in enumerate(measurements) if k != left_out]
    if left_out < len(rest):
        next_ = rest[left_out]
        distance = measurements[left_out].distance + next_.distance
        rest[left_out] = replace(next_, turned_sigma=math.inf, distance=distance)
    return rest


def declination_hint(
    estimate: Estimate, measurements: Sequence[KnownHeadingMeasurement], knowledge: Knowledge
) -> str:
    """Say that the headings may be to the other north; empty if that is unlikely.

    A heading to the wrong north looks like a magnetometer that is rotated by the declination. Only
    the size of this rotation separates the two.
    """
    declination = knowledge.reference.declination
    assert estimate.installation is not None
    yaw, sigma = estimate.installation.yaw, estimate.figures[Figure.INSTALLATION_YAW_SIGMA]
    if declination is None or abs(declination) < CLEAR * sigma:
        return ""
    told_true = [each.by_declination for each in measurements]
    # Given to true north but counted from magnetic, the yaw comes out as minus the declination.
    expected = -declination if all(told_true) else declination
    if all(told_true) is not any(told_true) or abs(yaw - expected) > abs(yaw):
        return ""
    if abs(yaw) < CLEAR * sigma:
        return ""
    given, other = ("true", "magnetic") if all(told_true) else ("magnetic", "true")
    return (
        f"the magnetometer would be mounted at a yaw of {yaw * DEGREES:.0f}°, as much as the "
        f"declination here ({declination * DEGREES:.0f}°): if it is mounted straight, the "
        f"headings are to {other} north and not to {given} north"
    )


@in_level_axes
def next_in_words(measurements: Sequence[KnownHeadingMeasurement], knowledge: Knowledge) -> str:
    """Return the most informative further heading, and the sigma of the compass with it, in words.

    The next measurement is assumed to have the sigma and `forward` of the last one.
    """
    shared, last = fit_headings(measurements, knowledge).state.shared, measurements[-1]
    sigmas = {}
    for shift in (k * 0.5 * QUARTER for k in range(1, 8)):
        heading = wrapped(last.heading + shift)
        new = replace(last, heading=heading, turned_sigma=math.inf, distance=math.inf)
        model = KnownHeadingModel.of([*measurements, new], knowledge)
        # The covariance does not depend on the new field.
        state = replace(model.start, shared=shared)
        known = model.optimum(DISTURBANCE_AT_REST.rms, state, rounds=0).covariance
        sigmas[heading] = posterior_at(state, known, knowledge.mounting.matrix).heading_sigma
    best = min(sigmas, key=lambda heading: sigmas[heading])
    way = wrapped(best - last.heading) * DEGREES
    side = "" if abs(way) > 179.0 else " to the left" if way > 0.0 else " to the right"
    return (
        f"One more known heading, {abs(way):.0f}°{side} of this one, would give "
        f"±{sigmas[best] * DEGREES:.1f}°"
    )
