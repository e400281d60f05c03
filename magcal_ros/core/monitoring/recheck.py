"""Whether a calibration still holds: the corrected field of a new turn or drive is checked.

A field that is corrected well has the same strength, the same dip and the same level part at
every heading, and its yaw turns as the gyro does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.assessment.grading import Aspect, Bound, Check, Grade
from magcal_ros.core.assessment.verdict import Verdict
from magcal_ros.core.calibration.calibration import Calibration, Estimate, GyroSwing
from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.geometry.attitude import level_part, unit, yaw_from_up_and_field
from magcal_ros.core.knowledge import (
    INCLINATION_SIGMA_DEG,
    STRENGTH_SIGMA_UT,
    Belief,
    Knowledge,
    ReferenceField,
)
from magcal_ros.core.monitoring.recheck_chance import (
    RecheckTuning,
    chances,
    check_beside_chance,
    gyro_compass,
    own_swings,
    sectors,
)
from magcal_ros.core.samples.coverage import Coverage
from magcal_ros.core.samples.drive_log import DriveLog
from magcal_ros.core.samples.streams import STREAMS
from magcal_ros.core.samples.window import Window
from magcal_ros.core.smoother.drives import drive_nodes, fit_iron
from magcal_ros.core.up import propagated_up

STATES = {
    Grade.EXCELLENT: "holds",
    Grade.GOOD: "holds",
    Grade.WARN: "doubtful",
    Grade.REFUSED: "stale",
}
"""What a grade says of a calibration that is in force."""

SENTENCES = {
    "holds": "The calibration holds",
    "doubtful": "The calibration is doubtful",
    "stale": "The calibration is stale, calibrate again",
}

NO_GYRO = "whether the compass turns as the robot does: there is no gyro"
LOST_GYRO = (
    "whether the compass turns as the robot does: the gyro is followed for "
    f"{STREAMS.longest_gyro_step:g} s at most between field samples, and these are further apart"
)
NO_YAW = "an error of the yaw that is the same at every heading"


@dataclass(frozen=True, eq=False)
class Recheck:
    """What came of a recheck."""

    verdict: Verdict
    """Its quality says whether the calibration holds, its confidence how much of it was seen."""
    estimate: Estimate
    """The old numbers with the fresh residuals, as a report shows them."""

    @property
    def findings(self) -> tuple[Check, ...]:
        """Everything that says whether the calibration holds."""
        return tuple(c for c in self.verdict.checks if c.aspect is Aspect.QUALITY)

    @property
    def state(self) -> str:
        """One of `STATES`."""
        return STATES[self.verdict.quality]


def check(
    window: Window,
    calibration: Calibration,
    tuning: RecheckTuning = RecheckTuning(),
    drive: DriveLog | None = None,
) -> Recheck:
    """Look at a fresh turn through a calibration.

    Parameters
    ----------
    window : Window
        Samples of at least a good part of a turn.
    calibration : Calibration
        What is to be tried.
    tuning : RecheckTuning
    drive : DriveLog, optional
        All that was driven, where the samples are a drive's: it tells iron from streets.

    Returns
    -------
    Recheck
    """
    up = up_of(window)
    field = calibration.correction.apply(window.field)
    heading = yaw_from_up_and_field(up, field)
    before = figures(window, up, heading, Correction.identity(), calibration, tuning)[0]
    after, compared = figures(window, up, heading, calibration.correction, calibration, tuning)
    arc = Coverage.of(heading).arc
    found = after | {Figure.ARC: arc}
    chance = _chances(window, up, heading, calibration, compared, tuning)
    swing = None if compared is None else compared[0]
    added = iron_added(drive, calibration) if drive is not None and len(drive) else None
    checks = tuple(
        check_beside_chance(
            bound,
            found[bound.figure],
            chance.get(bound.figure, 0.0),
            before.get(bound.figure),
            decided=added is not None,
        )
        for bound in tuning.bounds
        if bound.figure in found
    )
    checks += () if added is None else (added,)
    gaps = np.diff(window.time)
    is_lost = window.angular_rate is not None and np.median(gaps) > STREAMS.longest_gyro_step
    no_swing = LOST_GYRO if is_lost else NO_GYRO
    not_shown = (NO_YAW, no_swing) if swing is None else (NO_YAW,)
    verdict = Verdict(checks, not_shown, "")
    estimate = _on_fresh_samples(calibration, window, up, arc, swing)
    return Recheck(replace(verdict, summary=_summary(verdict)), estimate)


def _chances(
    window: Window,
    up: FloatArray,
    heading: FloatArray,
    calibration: Calibration,
    compared: tuple[GyroSwing, IntArray] | None,
    tuning: RecheckTuning,
) -> dict[Figure, float]:
    """Return what of each figure the calibration's uncertainty and the places may explain."""
    size, level, dip = _parts(calibration.correction.apply(window.field), up)
    seen = {
        Figure.HEADING_SWING: level / max(float(level.mean()), 1e-12),
        Figure.STRENGTH_SPREAD: size / calibration.strength,
        Figure.DIP_SPREAD: dip,
    }
    visit = ((window.time - window.time[0]) / tuning.visit).astype(np.int64)
    around = sectors(heading, tuning.bins)
    own = own_swings(calibration, unit(up.mean(axis=0)))
    most = {b.figure: tuning.own_share * b.warn / b.scale for b in tuning.bounds}
    return chances(seen, visit, around, compared, own, most, tuning.bins)


def _parts(field: FloatArray, up: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return strength, level part and dip (radians) of corrected fields, each shape (n,)."""
    size = np.linalg.norm(field, axis=1)
    rise = np.sum(field * up, axis=1)
    level = np.sqrt(np.maximum(size**2 - rise**2, 0.0))
    return size, level, np.arctan2(-rise, level)


def _summary(verdict: Verdict) -> str:
    """Return the state, and what speaks against the calibration."""
    state = STATES[verdict.quality]
    if state == "holds":
        return f"{SENTENCES[state]}."
    causes = (c for c in verdict.checks if c.aspect is Aspect.QUALITY)
    words = "; ".join(c.words for c in causes if STATES[c.grade] == state)
    return f"{SENTENCES[state]}: {words}."


def _on_fresh_samples(
    calibration: Calibration, window: Window, up: FloatArray, arc: float, swing: GyroSwing | None
) -> Estimate:
    """Return the old numbers with what is left of the fresh samples."""
    correction = calibration.correction
    field = correction.apply(window.field)
    misfit = field - expected_field(field, up, calibration.strength, calibration.inclination)
    return Estimate(
        method=calibration.evidence.method,
        correction=correction,
        covariance=calibration.covariance,
        installation=None,
        axis=unit(up.mean(axis=0)),
        arc=arc,
        strength=calibration.strength,
        inclination=calibration.inclination,
        noise_field=calibration.noise_field,
        noise_up=calibration.noise_up,
        inliers=np.ones(len(window), dtype=np.bool_),
        residual=np.asarray(np.linalg.solve(correction.matrix, misfit.T).T, dtype=np.float64),
        message="checked on other samples than it was made from",
        swing=swing,
    )


def expected_field(
    field: FloatArray, up: FloatArray, strength: float, inclination: float
) -> FloatArray:
    """Return the field (n, 3) of given strength and inclination at the heading of `field`."""
    level = unit(level_part(field, up))
    return np.asarray(strength * (math.cos(inclination) * level - math.sin(inclination) * up))


def figures(
    window: Window,
    up: FloatArray,
    heading: FloatArray,
    correction: Correction,
    calibration: Calibration,
    tuning: RecheckTuning,
) -> tuple[dict[Figure, float], tuple[GyroSwing, IntArray] | None]:
    """Measure the field of a window after a correction.

    Parameters
    ----------
    window : Window
        The samples.
    up : ndarray, shape (n, 3)
        Unit, body axes.
    heading : ndarray, shape (n,)
        Where the robot looked as far as is known, radians.
    correction : Correction
        What is tried.
    calibration : Calibration
        Tells strength and inclination.
    tuning : RecheckTuning

    Returns
    -------
    dict of Figure to float
        As in the bounds; radians and ratios.
    tuple of GyroSwing and ndarray of int, or None
        Compass against gyro and the rows that are compared, where there is a gyro.
    """
    field = correction.apply(window.field)
    size, level, dip = _parts(field, up)
    around = sectors(heading, tuning.bins)

    def spread(values: FloatArray) -> float:
        return _spread(values, around, tuning.bins)

    found = {
        Figure.HEADING_SWING: spread(level) / max(float(level.mean()), 1e-12),
        Figure.STRENGTH_SPREAD: spread(size) / calibration.strength,
        Figure.DIP_SPREAD: spread(dip),
        Figure.STRENGTH_OFFSET: abs(float(size.mean()) / calibration.strength - 1.0),
        Figure.DIP_OFFSET: abs(float(dip.mean()) - calibration.inclination),
    }
    yaw = yaw_from_up_and_field(up, field)
    compared = gyro_compass(window, up, yaw, heading, tuning)
    if compared is None:
        return found, None
    return found | {Figure.GYRO_COMPASS_DIFFERENCE: compared[0].rms}, compared


def up_of(window: Window) -> FloatArray:
    """Return up at each sample, propagated by the gyro where samples follow each other closely."""
    if window.angular_rate is None:
        return unit(window.specific_force)
    gaps = np.flatnonzero(np.diff(window.time) > STREAMS.longest_gyro_step)
    pieces = np.split(np.arange(len(window)), gaps + 1)
    return np.concatenate([propagated_up(window.take(rows)) for rows in pieces])


def _spread(values: FloatArray, around: IntArray, bins: int) -> float:
    """Return how the values' mean varies with the heading, root mean square.

    The mean over each heading takes the noise out of it, which the spread is not about.
    """
    counts = np.bincount(around, minlength=bins)
    filled = counts >= min(3, int(counts.max()))
    means = np.bincount(around, values, bins)[filled] / counts[filled]
    return float(means.std())


CHANGE = Bound(
    Figure.HARD_IRON_CHANGE,
    6.0,
    12.0,
    "hard iron that was added since, against the level field, as the drive shows it",
    "the robot's own field has changed",
    unit="%",
)


@dataclass(frozen=True)
class IronAddedTuning:
    """When a drive shows iron that was added."""

    largest_sigma: float = 0.06
    """Of the iron, against the level field, beyond which a drive shows nothing of it."""
    chance: float = 2.0
    """Its sigmas that chance may be."""


TUNING = IronAddedTuning()


def iron_added(drive: DriveLog, calibration: Calibration) -> Check | None:
    """Weigh the hard iron that was added; None where the drive is too short to show it.

    Parameters
    ----------
    drive : DriveLog
    calibration : Calibration
        In force since before the drive.
    """
    reference = ReferenceField(
        Belief(calibration.strength, STRENGTH_SIGMA_UT * 1e-6),
        Belief(calibration.inclination, math.radians(INCLINATION_SIGMA_DEG)),
    )
    known = Knowledge(reference)
    correction = calibration.correction
    found = fit_iron(drive_nodes(drive, known.mounting.to_body), correction, known)
    if found is None:
        return None
    # On the level across body z; an iron along it is a matter of slopes.
    matrix = correction.matrix[:2]
    added = matrix @ (found.posterior.correction.hard_iron - correction.hard_iron)
    covariance = matrix @ found.posterior.covariance[9:, 9:] @ matrix.T
    level = calibration.strength * math.cos(calibration.inclination)
    share = math.hypot(*added) / level
    sigma = math.sqrt(float(covariance.trace()) / 2.0) / level
    if sigma > TUNING.largest_sigma:
        return None
    excess = math.sqrt(max(share**2 - (TUNING.chance * sigma) ** 2, 0.0))
    return CHANGE.check(share, excess=excess)
