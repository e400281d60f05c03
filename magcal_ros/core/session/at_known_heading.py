"""Calibrating where a robot stands and its heading is known: collected, joined, judged."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.assessment.verdict import judge
from magcal_ros.core.calibrate import Outcome
from magcal_ros.core.calibration.calibration import Calibration, yaw_jacobian
from magcal_ros.core.calibration.heading_sigma import calibration_sigma
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import unit, wrapped
from magcal_ros.core.geometry.vec3 import Triple
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.methods.known_headings import METHOD, declination_hint, fit, next_heading
from magcal_ros.core.samples.rest import mean_and_sigma
from magcal_ros.core.samples.streams import Pair
from magcal_ros.core.session.external_heading import DEGREES, TUNING, ExternalHeading, TurnSince
from magcal_ros.core.smoother.standings import Standing
from magcal_ros.core.smoother.unknowns import MICROTESLA, STANDING


def _declination(knowledge: Knowledge) -> float:
    if knowledge.reference.declination is None:
        raise Refusal(
            Reason.NO_SOLUTION,
            "the heading is to true north, and the declination here is not known: give "
            "reference.latitude_deg and longitude_deg (or reference.declination_deg), wait "
            "for gps/fix, or give the heading to magnetic north",
        )
    return knowledge.reference.declination


def _refuse_motion(field: FloatArray, rate: FloatArray, noise: float) -> None:
    half = len(field) // 2
    moved = np.abs(field[:half].mean(axis=0) - field[half:].mean(axis=0)).max()
    turned = float(np.linalg.norm(rate.mean(axis=0))) if np.isfinite(rate).all() else 0.0
    if turned > TUNING.rate or moved > TUNING.creep + 4.0 * noise * math.sqrt(2.0 / half):
        what = (
            f"the gyro turned at {turned * DEGREES:.1f} °/s"
            if turned > TUNING.rate
            else f"the field moved by {moved * MICROTESLA:.1f} µT"
        )
        raise Refusal(
            Reason.HEADING_CONTRADICTED,
            f"{what} meanwhile: the robot has to stand still for {TUNING.seconds:g} s at the known "
            "heading, with nothing magnetic moving beside it",
        )


@dataclass(frozen=True, eq=False)
class HeadingResult:
    """What came of a standing at a known heading."""

    standings: tuple[Standing, ...]
    """All that count from now on."""
    outcome: Outcome
    applies: bool
    """Whether what was found is to be put in force."""
    words: str
    """What is known now, and what the next heading would show."""


@dataclass(frozen=True, eq=False)
class CollectedSamples:
    """What was collected where a robot stood at a known heading."""

    pairs: tuple[Pair, ...]
    given: ExternalHeading
    knowledge: Knowledge
    """With the declination, if the heading is to true north."""
    forward: FloatArray
    """Direction in the IMU's axes whose heading it is. Shape (3,)."""
    since: TurnSince | None = None
    """By the gyro since the standing before."""
    bias: Triple = (0.0, 0.0, 0.0)
    """The gyro's, as far as it is known, rad/s."""

    def standing(self) -> Standing:
        """Return what the robot measured while it stood.

        Raises
        ------
        Refusal
            If it did not stand, samples are too few, or the declination is missing.
        """
        declination = _declination(self.knowledge) if self.given.is_true else 0.0
        if len(self.pairs) < TUNING.fewest:
            raise Refusal(
                Reason.TOO_FEW_SAMPLES,
                f"only {len(self.pairs)} samples of field and acceleration came in "
                f"{TUNING.seconds:g} s; "
                f"{TUNING.fewest} are needed: see whether both sensors publish, and their stamps",
            )
        time = np.array([pair.field.stamp for pair in self.pairs])
        field = np.array([pair.field.field for pair in self.pairs])
        force = np.array([pair.imu.force for pair in self.pairs])
        rate = np.array([pair.imu.rate for pair in self.pairs]) - self.bias
        noise = float(np.sqrt(np.mean(np.diff(field, axis=0) ** 2) / 2.0))
        _refuse_motion(field, rate, noise)
        mean, _ = mean_and_sigma(time, field)
        up = unit(force)
        sigma = math.inf if self.since is None else self.since.sigma
        return Standing(
            mean,
            force.mean(axis=0),
            wrapped(self.given.yaw + declination),
            self.given.sigma,
            by_declination=self.given.is_true,
            forward=self.forward,
            turned=0.0 if self.since is None else self.since.angle,
            turned_sigma=sigma,
            noise_field=max(noise, 1e-9),
            noise_up=float(np.sqrt(np.mean(np.diff(up, axis=0) ** 2) / 2.0)),
        )


def calibrate_standing(
    before: tuple[Standing, ...],
    collected: CollectedSamples,
    in_force: Calibration | None = None,
) -> HeadingResult:
    """Make a standing of what was collected, and calibrate with those before."""
    try:
        new = collected.standing()
    except Refusal as refusal:
        return _refused(before, refusal)
    return add_standing(before, new, collected.knowledge, in_force)


def _refused(before: tuple[Standing, ...], refusal: Refusal) -> HeadingResult:
    kept = f" The {len(before)} before it stay." if before else ""
    words = str(refusal).rstrip(".")
    return HeadingResult(before, Outcome.refused(refusal), False, f"Refused: {words}.{kept}")


def add_standing(
    before: tuple[Standing, ...],
    new: Standing,
    knowledge: Knowledge,
    in_force: Calibration | None = None,
) -> HeadingResult:
    """Join a standing to those before, fit, and judge.

    A calibration in force that is not of known headings stays where it is the more certain one,
    and refuses a heading that contradicts it. Bad data raise nothing: those before stay.
    """
    other = None if in_force is None or in_force.evidence.method == METHOD else in_force
    standings = (*_apart_from(before, new), new)[-TUNING.most :]
    try:
        gap, sigma = (0.0, math.inf) if other is None else _gap(other, new)
        if abs(gap) > TUNING.contradicted * sigma:
            raise Refusal(Reason.HEADING_CONTRADICTED, _contradicted(gap, sigma))
        estimate = fit(standings, knowledge)
    except Refusal as refusal:
        return _refused(before, refusal)
    verdict = judge(estimate, knowledge)
    calibration = Calibration.from_estimate(estimate, verdict.evidence(estimate))
    outcome = Outcome(verdict, calibration, estimate)
    words = [verdict.summary, declination_hint(estimate, standings, knowledge)]
    words.append(_next_in_words(standings, knowledge))
    applies = verdict.accepted
    if applies and other is not None:
        own, theirs = (calibration_sigma(each) for each in (calibration, other))
        if theirs < own:
            applies = False
            words.insert(
                0,
                f"The calibration in force agrees with this heading (off by {gap * DEGREES:.1f}°) "
                f"and promises ±{theirs * DEGREES:.1f}°, so that it stays. By known headings:",
            )
    said = " ".join(each[0].upper() + each[1:].rstrip(".") + "." for each in words if each)
    return HeadingResult(standings, outcome, applies, said.replace(":.", ":"))


def _apart_from(before: tuple[Standing, ...], new: Standing) -> tuple[Standing, ...]:
    """Return the standings that do not say the same as a new one."""
    kept: list[Standing] = []
    lost = False
    for each in before:
        near = abs(wrapped(each.heading - new.heading)) < TUNING.same
        is_same = near and np.linalg.norm(each.field - new.field) * MICROTESLA < STANDING.usual
        if not is_same:
            # Across one that is left out nobody knows the turn.
            kept.append(replace(each, turned_sigma=math.inf) if lost else each)
        lost = bool(is_same)
    return tuple(kept)


def _gap(calibration: Calibration, new: Standing) -> tuple[float, float]:
    """Return by how much a calibration misses a known heading, and the sigma of that, radians."""
    field, up = calibration.correction.apply(new.field), unit(new.force)
    east = unit(np.cross(field, up))
    north = np.cross(up, east)
    yaw = math.atan2(float(north @ new.forward), float(east @ new.forward))
    level = max(float(np.linalg.norm(np.cross(field, up))), 1e-9)
    jacobian = yaw_jacobian(calibration.correction, up, field)
    by_twelve = float(jacobian @ calibration.covariance @ jacobian)
    place = STANDING.usual * math.exp(STANDING.spread**2) / MICROTESLA / level
    return wrapped(yaw - new.heading), math.sqrt(by_twelve + place**2 + new.sigma**2)


def _contradicted(gap: float, sigma: float) -> str:
    return (
        f"the calibration in force shows a heading {abs(gap) * DEGREES:.0f}° further to the "
        f"{'left' if gap > 0.0 else 'right'} than is told, and ±{sigma * DEGREES:.1f}° would be "
        "usual. Either the heading is wrong (its sign, its north, its zero to the east), or "
        "the calibration is out of date or its sensor turned: then call ~/reset, and this again"
    )


def _next_in_words(standings: Sequence[Standing], knowledge: Knowledge) -> str:
    """Say what the next known heading would show."""
    heading, sigma = next_heading(standings, knowledge)
    shift = wrapped(heading - standings[-1].heading) * DEGREES
    side = "" if abs(shift) > 179.0 else " to the left" if shift > 0.0 else " to the right"
    return (
        f"One more known heading, {abs(shift):.0f}°{side} of this one, would bring "
        f"±{sigma * DEGREES:.1f}°"
    )
