"""Whether a calibration still holds: the corrected field of a new turn or drive is checked."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.assessment.grading import Aspect, Bound, Check, Grade
from magcal_ros.core.assessment.verdict import LEVEL_ONLY, NO_REFERENCE, TUNING, Verdict
from magcal_ros.core.calibration.calibration import Calibration, Estimate, GyroSwing
from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import (
    CHECKED_TILT,
    calibration_sigma,
    known_sigma,
)
from magcal_ros.core.doctor.latency import drove_while_turning
from magcal_ros.core.geometry.arrays import FloatArray, integral
from magcal_ros.core.geometry.attitude import level_part, unit, yaw_from_up_and_field, yaw_rate
from magcal_ros.core.knowledge import (
    INCLINATION_SIGMA_DEG,
    STRENGTH_SIGMA_UT,
    Belief,
    Knowledge,
    ReferenceField,
)
from magcal_ros.core.monitoring.change import (
    CHANGE,
    GYRO_BOUND,
    check_beside_chance,
    compass_minus_gyro,
    doubtful,
    fit_harmonics,
    harmonics,
    records_of,
)
from magcal_ros.core.samples.coverage import Coverage
from magcal_ros.core.samples.streams import STREAMS
from magcal_ros.core.samples.window import SensorLog, Window
from magcal_ros.core.smoother.drives import drive_nodes, fit_iron
from magcal_ros.core.up.follower import propagated_up

STATES = {
    Grade.EXCELLENT: "holds",
    Grade.GOOD: "holds",
    Grade.WARN: "doubtful",
    Grade.REFUSED: "stale",
}
"""The state of a calibration in force by its grade."""

SENTENCES = {
    "holds": "The calibration holds",
    "doubtful": "The calibration is doubtful",
    "stale": "The calibration is stale, calibrate again",
}

NO_GYRO = "whether the compass turns as the robot does: there is no gyro"
LOST_GYRO = (
    "whether the compass turns as the robot does: the field samples are more than "
    f"{STREAMS.longest_field_gap:g} s apart, too far to follow the gyro between them"
)
NO_YAW = "an error of the yaw that is the same at every heading"
MOVED = "the hard iron has changed, or the field is distorted here"
OTHER_ROBOT = (
    f"{GYRO_BOUND.remedy}; check that the calibration was made for this robot and this sensor"
)
ELSEWHERE = "another place, or the hard iron along the turn's axis has changed"

RECHECK_BOUNDS: tuple[Bound, ...] = (
    Bound(
        Figure.HEADING_SWING, (None, 4.0, 7.0), "the level field makes the heading swing by", MOVED
    ),
    replace(GYRO_BOUND, when_refused=OTHER_ROBOT),
    Bound(
        Figure.STRENGTH_SPREAD,
        (None, 3.0, 6.0),
        "field strength varies with heading by",
        MOVED,
        unit="%",
    ),
    Bound(Figure.DIP_SPREAD, (None, 2.0, 4.0), "inclination varies with heading by", MOVED),
    Bound(
        Figure.STRENGTH_OFFSET,
        (None, 5.0, 15.0),
        "field strength differs from the calibrated one by",
        ELSEWHERE,
        unit="%",
    ),
    Bound(
        Figure.DIP_OFFSET,
        (None, 3.0, 8.0),
        "inclination differs from the calibrated one by",
        ELSEWHERE,
    ),
    Bound(
        Figure.ARC,
        (None, 270.0, 0.0),
        "the turn covers",
        "the headings that were not seen are not checked",
        aspect=Aspect.CONFIDENCE,
        at_least=True,
    ),
)
"""There is no grade above good: a recheck can only confirm a calibration."""
IRON_BOUND = Bound(
    Figure.HARD_IRON_CHANGE,
    (None, 6.0, 12.0),
    "iron added since, over level field",
    "the robot's own field has changed",
    unit="%",
)


@dataclass(frozen=True, eq=False)
class Recheck:
    """The result of a recheck."""

    verdict: Verdict
    """Quality is whether the calibration holds, confidence how much of it was tested."""
    estimate: Estimate  # the old calibration with the residuals of the new samples, for a report
    sentence: str = ""  # the state in words, and where it holds

    @property
    def findings(self) -> tuple[Check, ...]:
        """The checks of whether the calibration holds."""
        return tuple(c for c in self.verdict.checks if c.aspect is Aspect.QUALITY)

    @property
    def is_judged(self) -> bool:
        """Whether any of the checks is conclusive."""
        return any(finding.is_judged for finding in self.findings)

    @property
    def state(self) -> str:
        """One of `STATES`."""
        return STATES[self.verdict.quality]


def check(window: Window, calibration: Calibration, drive: Window | None = None) -> Recheck:
    """Test a calibration by a new turn; `drive` separates added iron from local disturbances."""
    up = propagated_up(window)
    heading = yaw_from_up_and_field(up, calibration.correction.apply(window.field))
    corrected = _records(window, up, heading, calibration.correction)
    raw = _records(window, up, heading, Correction.identity())
    before, _ = _figures(raw, corrected[:, 1], calibration)
    found, swing = _figures(corrected, corrected[:, 1], calibration)
    arc = Coverage.of(heading).arc
    found[Figure.ARC] = arc, 0.0
    iron = _iron_of(drive, calibration) if drive is not None and len(drive) else None
    drove = iron is not None and drove_while_turning(SensorLog.of_window(window))
    chance = CHANGE.clearly if drove else CHANGE.chance
    added = None if iron is None else _check_iron(*iron, chance)
    # On a street that is driven once, a local disturbance looks like iron in the robot.
    is_street = iron is not None and (added is None or (drove and added.grade is not Grade.REFUSED))
    is_round = Coverage.of(corrected[:, 1]).gap <= CHANGE.widest_hole
    checks = []
    for bound in RECHECK_BOUNDS:
        if bound.figure in found:
            figure, places = found[bound.figure]
            raw_figure, _ = before.get(bound.figure, (None, 0.0))
            most = CHANGE.own_share * bound.warn / bound.scale
            chance = math.hypot(min(_own(bound.figure, calibration), most), places)
            # In a part of a turn, the test of iron does not exclude an error of up.
            is_decided = added is not None and (is_round or bound.figure is not GYRO_BOUND.figure)
            graded = check_beside_chance(bound, figure, chance, raw_figure, is_decided)
            is_stale = graded.grade is Grade.REFUSED
            checks.append(doubtful(graded) if is_stale and is_street else graded)
    checks += [] if added is None else [added]
    gaps = np.diff(window.time)
    is_lost = window.angular_rate is not None and np.median(gaps) > STREAMS.longest_field_gap
    no_swing = LOST_GYRO if is_lost else NO_GYRO
    not_shown = (NO_YAW, no_swing) if swing is None else (NO_YAW,)
    slopes = _slopes_of(calibration)
    verdict = Verdict(tuple(checks), not_shown + ((slopes,) if slopes else ()))
    estimate = _on_fresh_samples(calibration, window, up, arc, swing)
    state = STATES[verdict.quality]
    sentence = SENTENCES[state] + (" on level ground" if slopes and state == "holds" else "")
    return Recheck(replace(verdict, says=_summary(verdict, sentence)), estimate, sentence)


def _slopes_of(calibration: Calibration) -> str:
    """Return why a calibration's file does not show the heading on slopes; empty if it does."""
    unseen = calibration.evidence.not_shown
    level, tilted = calibration_sigma(calibration), calibration_sigma(calibration, CHECKED_TILT)
    least, times = TUNING.costly
    is_costly = tilted > max(times * level, least)
    if NO_REFERENCE not in unseen or not (is_costly or LEVEL_ONLY in unseen):
        return ""
    error = f"±{math.degrees(tilted):.1f}°{'' if is_costly else ' or more'} (1σ) at 10° of tilt"
    return (
        "the heading on slopes: the calibration was made without a position, so its hard iron "
        f"along the vertical axis is uncertain, and the heading error is {error}; give the "
        "position when you calibrate again, or turn on ramps"
    )


def _own(figure: Figure, calibration: Calibration) -> float:
    """Return the swing of a figure by hard iron of the calibration's sigma."""
    level, upright = math.cos(calibration.inclination), math.sin(calibration.inclination)
    shares = {
        Figure.HEADING_SWING: 1.0,
        Figure.GYRO_COMPASS_DIFFERENCE: 1.0,
        Figure.STRENGTH_SPREAD: level**2,
        Figure.DIP_SPREAD: abs(level * upright),
    }
    return shares.get(figure, 0.0) * known_sigma(calibration)


def _records(
    window: Window, up: FloatArray, heading: FloatArray, correction: Correction
) -> FloatArray:
    """Return one record (n, 7) of each visit to a sector of heading, with columns of `Record`."""
    field = correction.apply(window.field)
    is_good = up[:, 0] ** 2 < CHANGE.steepest_nose
    turned = rate = np.full(len(window), math.nan)
    if window.angular_rate is not None:
        rate = yaw_rate(window.angular_rate, up)
        turned = np.where(is_good, integral(window.time, rate), math.nan)
    is_parted = (np.diff(window.time) > STREAMS.longest_field_gap) | (np.diff(is_good) != 0)
    path = np.append(0, np.cumsum(is_parted))
    strength, rise = np.linalg.norm(field, axis=1), np.sum(field * up, axis=1)
    yaw = yaw_from_up_and_field(up, field)
    samples = [window.time, yaw, strength, rise, turned, path, rate]
    return records_of(np.column_stack(samples), heading)


def _figures(
    records: FloatArray, heading: FloatArray, calibration: Calibration
) -> tuple[dict[Figure, tuple[float, float]], GyroSwing | None]:
    """Return figures of records, each with its largest size by chance, and compass minus gyro."""
    stamp, size, rise = records[:, 0], records[:, 2], records[:, 3]
    level = np.sqrt(np.maximum(size**2 - rise**2, 0.0))
    dip = np.arctan2(-rise, level)
    swings = {
        Figure.HEADING_SWING: level / max(float(level.mean()), 1e-12),
        Figure.STRENGTH_SPREAD: size / calibration.strength,
        Figure.DIP_SPREAD: dip,
    }
    columns = harmonics(heading)
    waves = {k: fit_harmonics(columns, v, stamp, CHANGE.chance) for k, v in swings.items()}
    found = {figure: each.spread for figure, each in waves.items()}
    for figure, of, off in (
        (Figure.STRENGTH_OFFSET, Figure.STRENGTH_SPREAD, size / calibration.strength - 1.0),
        (Figure.DIP_OFFSET, Figure.DIP_SPREAD, dip - calibration.inclination),
    ):
        found[figure] = abs(float(off.mean())), waves[of].chance_of_mean
    gyro = compass_minus_gyro(records, heading, CHANGE.chance)
    if gyro is None:
        return found, None
    rms = gyro.rms
    # A deviation that does not depend on the heading is not due to the calibration.
    if gyro.waves is None:
        # The error of up across the field is assumed to be that along the field.
        tilt = waves[Figure.DIP_SPREAD].scatter(dip, stamp)
        swing, chance = rms, abs(math.tan(calibration.inclination)) * tilt
    else:
        swing, chance = gyro.waves.spread
    elsewhere = math.sqrt(max(rms**2 - swing**2, 0.0))
    found[Figure.GYRO_COMPASS_DIFFERENCE] = rms, math.hypot(chance, elsewhere)
    return found, GyroSwing(heading[gyro.rows], gyro.deviation, rms)


def _summary(verdict: Verdict, sentence: str) -> str:
    """Return the sentence on the state, and the findings against the calibration."""
    state = STATES[verdict.quality]
    if state == "holds":
        return f"{sentence}."
    causes = (c for c in verdict.checks if c.aspect is Aspect.QUALITY)
    words = "; ".join(c.words for c in causes if STATES[c.grade] == state)
    return f"{sentence}: {words}."


def _on_fresh_samples(
    calibration: Calibration, window: Window, up: FloatArray, arc: float, swing: GyroSwing | None
) -> Estimate:
    """Return the old calibration with the residuals of the new samples."""
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
        message="checked with other samples than those it was made from",
        swing=swing,
    )


def expected_field(
    field: FloatArray, up: FloatArray, strength: float, inclination: float
) -> FloatArray:
    """Return the field (n, 3) of given strength and inclination at the heading of `field`."""
    level = unit(level_part(field, up))
    return np.asarray(strength * (math.cos(inclination) * level - math.sin(inclination) * up))


def _iron_of(drive: Window, calibration: Calibration) -> tuple[float, float, float] | None:
    """Return added iron over the level field, its sigma, and this field, T; None if unknown."""
    reference = ReferenceField(
        Belief(calibration.strength, STRENGTH_SIGMA_UT * 1e-6),
        Belief(calibration.inclination, math.radians(INCLINATION_SIGMA_DEG)),
    )
    known = Knowledge(reference)
    correction = calibration.correction
    found = fit_iron(drive_nodes(drive, known.mounting.to_body), correction, known)
    if found is None:
        return None
    # Only the part across body z: iron along z matters on slopes only.
    matrix = correction.matrix[:2]
    added = matrix @ (found.posterior.correction.hard_iron - correction.hard_iron)
    covariance = matrix @ found.posterior.covariance[9:, 9:] @ matrix.T
    level = calibration.strength * math.cos(calibration.inclination)
    sigma = math.sqrt(float(covariance.trace()) / 2.0) / level
    return math.hypot(*added) / level, sigma, level


def _check_iron(share: float, sigma: float, level: float, chance: float) -> Check | None:
    """Grade added iron, with `chance` sigmas explained by chance; None if too uncertain."""
    beyond = share - CHANGE.clearly * sigma
    if sigma > CHANGE.largest_sigma and beyond * IRON_BOUND.scale < IRON_BOUND.warn:
        return None
    size = f"iron added since ({1e6 * share * level:.1f} µT)"
    bound = replace(IRON_BOUND, words=IRON_BOUND.words.replace("iron added since", size))
    return check_beside_chance(bound, share, chance * sigma, decided=True)
