"""What a new calibration says about the one in force, and grades of figures beside chance."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.assessment.grading import Bound, Check, Grade, shown
from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import fields_on_level, heading_swing


@dataclass(frozen=True)
class ChangeTuning:
    """Assumptions about places, sensors and driving."""

    correlation_time: float = 30.0  # of errors, seconds
    chance: float = 2.0  # sigmas that chance may reach


CHANGE = ChangeTuning()

ADDED = (
    "the hard iron has changed (by about {x:+.1f}, {y:+.1f} µT in the IMU's x, y): something "
    "magnetic was added to the robot, taken off or moved"
)
MOVED = "the mounting has changed: the magnetometer or the IMU was moved on the robot"
BENT = "the soft iron has changed: iron near the sensor, or a gain of the sensor"
OTHER_ROBOT = "check that the calibration was made for this robot and this sensor"
ELSEWHERE = "another place, or the hard iron along the turn's axis has changed"

SWING_BOUND = Bound(
    Figure.HEADING_SWING,
    (None, 4.0, 7.0),
    "the calibration makes the heading swing by",
    "the hard iron, the soft iron or the mounting has changed",
)
STRENGTH_BOUND = Bound(
    Figure.STRENGTH_OFFSET,
    (None, 5.0, 15.0),
    "field strength differs from the calibrated one by",
    ELSEWHERE,
    unit="%",
)
DIP_BOUND = Bound(
    Figure.DIP_OFFSET,
    (None, 3.0, 8.0),
    "inclination differs from the calibrated one by",
    ELSEWHERE,
    when_refused=f"{ELSEWHERE}; {OTHER_ROBOT}",
)


def checks_of_change(
    old: Calibration,
    new: Correction,
    place: tuple[float, float],
    chance: float,
    local: float,
    before: float | None = None,
) -> tuple[Check, Check, Check]:
    """Grade an old calibration by a new correction: the swing of the heading, strength and dip.

    `place` are strength (tesla) and inclination (rad) of the new correction. `chance` is the
    largest swing by chance, radians, and `local` the largest relative difference of strength and
    dip. `before` is the swing of the raw field.
    """
    known = old.correction
    left, _, right = np.linalg.svd(new.matrix @ np.linalg.inv(known.matrix))
    rotation = left @ right
    x, y, _ = 1e6 * (known.matrix @ (new.hard_iron - known.hard_iron))
    parts = {
        ADDED.format(x=x, y=y): Correction(known.matrix, new.hard_iron),
        MOVED: Correction(rotation @ known.matrix, known.hard_iron),
        BENT: Correction(rotation.T @ new.matrix, known.hard_iron),
    }
    cause = max(parts, key=lambda words: heading_swing(parts[words], known, *place))
    bound = replace(SWING_BOUND, remedy=cause, when_refused=f"{cause}; {OTHER_ROBOT}")
    swing = heading_swing(new, known, *place)
    # Means over level headings of the corrected and of the raw field, minus the calibration's.
    strengths, dips = [], []
    for seen in (known, Correction.identity()):
        up, _, field = fields_on_level(new, seen, *place)
        size = np.linalg.norm(field, axis=1)
        down = np.arcsin(np.clip(-np.sum(field * up, axis=1) / np.maximum(size, 1e-12), -1.0, 1.0))
        strengths.append(abs(float(size.mean()) / old.strength - 1.0))
        dips.append(abs(float(down.mean()) - old.inclination))
    strength, dip = (
        check_beside_chance(bound, by_old, local, raw)
        for bound, (by_old, raw) in ((STRENGTH_BOUND, strengths), (DIP_BOUND, dips))
    )
    return check_beside_chance(bound, swing, chance, before), strength, dip


def local_chance(local_field: float, seconds: float) -> float:
    """Return the sigma of the mean of a field by local disturbances, in the unit of their size.

    Disturbances within half a minute are correlated.
    """
    return local_field / math.sqrt(max(seconds / CHANGE.correlation_time, 1.0))


def check_beside_chance(
    bound: Bound, figure: float, chance: float, before: float | None = None
) -> Check:
    """Grade the part of a figure that chance does not explain.

    If chance alone reaches the bound of stale, the samples are inconclusive: doubtful, unless the
    figure is small.
    """
    excess = math.sqrt(max(figure**2 - chance**2, 0.0))
    seen = chance * bound.scale
    note = ""
    if seen > 0.5 * bound.good:
        left = f"{shown(excess * bound.scale)}{bound.unit} are left, by squares"
        note = f", more than the {shown(seen)}{bound.unit} that chance explains: {left}"
        note = ", no more than chance explains" if chance >= figure else note
    good, warn = (f"{limit:g}{bound.unit}" for limit in (bound.good, bound.warn))
    rule = f"doubtful beyond {good}, stale beyond {warn}"
    check = bound.check(figure, excess=excess, note=note, before=before, rule=rule)
    is_small = figure * bound.scale <= bound.good
    if is_small or seen <= bound.warn or check.grade.rank >= Grade.WARN.rank:
        return check
    words = f"{check.words}: too uncertain to judge; turn once, in one place away from iron"
    return replace(check, grade=Grade.WARN, words=words, is_judged=False)
