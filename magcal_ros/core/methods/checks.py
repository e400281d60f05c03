"""What no method can work without, and what cannot carry a calibration."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.geometry.planes import plane_normal
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.streams import STREAMS, SWAY
from magcal_ros.core.samples.window import Window, without_spikes

WEAKEST_FORCE = 0.8
"""m/s². Gravity in any unit that can be named is larger, one g published as m/s² the least."""

NO_UNIT_EXPLAINS = {"magnetometer": 1e7, "accelerometer": 1e7, "gyro": 1e6}
"""Tesla, m/s², rad/s. The Earth's field, gravity and every turn are far below, even in nanotesla,
micro-g and millidegrees published as these."""


def refuse_empty(window: Window, min_samples: int) -> None:
    """Refuse a window that says too little to begin with.

    Raises
    ------
    Refusal
        For numbers that no unit explains, too few samples, an accelerometer without gravity, or
        a field of zero.
    """
    _refuse_nonsense(window)
    if len(window) < min_samples:
        raise Refusal(
            Reason.TOO_FEW_SAMPLES,
            f"Only {len(window)} samples; at least {min_samples} are needed. Turn more "
            "slowly or check the rate of the topics.",
        )
    if _usual_size(window.specific_force) < WEAKEST_FORCE:
        raise Refusal(
            Reason.GRAVITY_ABSENT,
            "The accelerometer shows no gravity. It must publish specific force in m/s², +9.81 "
            "upwards at rest, with gravity not taken off.",
        )
    if _usual_size(window.field) < STREAMS.smallest:
        raise Refusal(
            Reason.FIELD_ABSENT, "The magnetometer reads zero. Check its driver and its topic."
        )


def too_slow(window: Window, knowledge: Knowledge) -> Refusal | None:
    """Return why samples come too slowly for any fit that believes their gyro; None if not."""
    if window.angular_rate is None or len(window) < 2 or knowledge.exact_sensors:
        return None
    step = float(np.median(np.diff(window.time)))
    if step <= SWAY:
        return None
    return Refusal(
        Reason.TOO_SLOW,
        f"The samples of field and IMU come at {1.0 / step:.2g} Hz, and what the gyro measures "
        "does not say how the robot turned and swayed between them. Publish or record both at 10 "
        "Hz or more, or let the driver average its readings and turn more slowly.",
    )


def _usual_size(vectors: FloatArray) -> float:
    return float(np.median(np.linalg.norm(vectors, axis=1)))


def _refuse_nonsense(window: Window) -> None:
    """Refuse numbers so large that their squares and fourth powers would leave the floats."""
    rate = np.zeros(3) if window.angular_rate is None else window.angular_rate
    readings = (window.field, window.specific_force, rate)
    for (sensor, limit), values in zip(NO_UNIT_EXPLAINS.items(), readings, strict=True):
        largest = float(np.abs(values).max(initial=0.0))
        if largest > limit:
            raise Refusal(
                Reason.NOT_FINITE,
                f"The {sensor} reads up to {largest:.0e}, which no unit explains. "
                "Check its driver.",
            )


@dataclass(frozen=True)
class Screening:
    """Bounds beyond which a turn is refused."""

    fewest_samples: int = 20
    least_motion: float = 2.5
    """The raw field must move by this many times its own noise."""
    smallest_motion: float = 0.005
    """Spread of the field, or of the force, over its own size."""
    least_arc: float = math.radians(45.0)
    least_arc_alone: float = math.radians(90.0)
    """Radians; the latter without a known field or a gyro."""
    full_arc: float = math.radians(300.0)
    """Radians from which a full circle is not asked for again."""
    arc_tolerance: float = math.radians(1.5)
    """Radians: the ends of an arc are known to no better."""
    smallest_radius: float = 0.1
    """Of the circle, over the field's strength: below it the heading drowns in noise."""
    steepest: float = math.radians(84.0)
    """Radians of inclination at which too little of the field is level. Up to there the heading's
    sigma tells what the steepness costs."""
    worst_field_noise: float = 0.15
    """Over the field's strength."""
    worst_wobble: float = math.radians(30.0)
    """Radians: such a robot does not turn about an axis."""
    fewest_inliers: float = 0.4
    """Share of the samples."""
    widest_rival: float = math.radians(5.0)
    """Radians of heading by which rival solutions may differ."""


SCREENING = Screening()


def check_window(window: Window, knowledge: Knowledge) -> None:
    """Refuse what no fit can help.

    Raises
    ------
    Refusal
        As of `refuse_empty`, and `FIELD_TOO_STEEP`, `NO_MOTION` or `AXIS_ALONG_FIELD`.
    """
    refuse_empty(window, SCREENING.fewest_samples)
    dip = knowledge.reference.inclination
    if not dip.is_unknown and abs(dip.value) > SCREENING.steepest:
        raise _too_steep(dip.value)
    _check_motion(window)


def _check_motion(window: Window) -> None:
    if visible_motion(window.field):
        return
    if visible_motion(window.specific_force):
        raise Refusal(
            Reason.AXIS_ALONG_FIELD,
            "the robot turned but its field did not change: the axis lies along the field; turn"
            " about another axis",
        )
    turned = _turned_by_gyro(window)
    if turned > SCREENING.least_arc:
        raise Refusal(
            Reason.FIELD_TOO_STEEP,
            f"the gyro shows {math.degrees(turned):.0f} degrees of turn in which the field did not "
            "change: it is too steep for a compass here, or the magnetometer does not measure it",
        )
    raise Refusal(
        Reason.NO_MOTION,
        "the field did not change, so the robot did not turn; turn it once about its upright axis",
    )


def _turned_by_gyro(window: Window) -> float:
    """Return how far the gyro says the robot turned, radians; zero without one."""
    if window.angular_rate is None or len(window) < 2:
        return 0.0
    steps = 0.5 * (window.angular_rate[1:] + window.angular_rate[:-1])
    steps = steps * np.diff(window.time)[:, None]
    return float(np.ptp(np.cumsum(steps @ unit(window.specific_force.mean(axis=0)))))


def visible_motion(values: FloatArray) -> bool:
    """Return whether vectors (n, 3) spread by more than their sample-to-sample noise."""
    clean = values[without_spikes(values)]
    if len(clean) < SCREENING.fewest_samples // 2:
        clean = values
    noise = float(np.median(np.abs(np.diff(clean, axis=0)))) / 0.954
    spread = math.sqrt(max(float(plane_normal(clean)[1][-1]), 0.0))
    size = float(np.median(np.linalg.norm(clean, axis=1)))
    return spread > max(SCREENING.smallest_motion * size, SCREENING.least_motion * noise)


def check_rival(rival_gap: float, knowledge: Knowledge, arc: float) -> None:
    """Refuse a turn that two calibrations explain; `rival_gap` is radians of heading between them.

    Raises
    ------
    Refusal
        `AMBIGUOUS`.
    """
    if rival_gap <= SCREENING.widest_rival:
        return
    raise Refusal(
        Reason.AMBIGUOUS,
        f"two calibrations explain this turn equally well and differ by"
        f" {math.degrees(rival_gap):.0f} degrees of heading; {_other_turn(arc)}"
        f"{'' if knowledge.reference.is_complete else ', or give the reference field'}",
    )


def _other_turn(arc: float) -> str:
    """Say which turn would tell two calibrations apart: another than the one that was made."""
    if arc < SCREENING.full_arc:
        return "turn a full circle on level ground"
    return "turn once more on other ground, more slowly, with the robot upright"


def check_agreement(deviation: float, wobble: float, inliers: float) -> None:
    """Refuse a field that follows no turn.

    Parameters
    ----------
    deviation : float
        What the field deviates by, over its strength.
    wobble : float
        Radians.
    inliers : float
        Share of the samples.

    Raises
    ------
    Refusal
        `FIELD_NOT_ON_A_PLANE`.
    """
    causes = []
    if deviation > SCREENING.worst_field_noise:
        causes.append(f"the field deviates by {deviation:.0%} of its strength")
    if wobble > SCREENING.worst_wobble:
        causes.append(f"the turn's axis wobbles by {math.degrees(wobble):.0f} degrees")
    if inliers < SCREENING.fewest_inliers:
        causes.append(f"only {inliers:.0%} of the samples fit")
    if causes:
        raise Refusal(
            Reason.FIELD_NOT_ON_A_PLANE,
            f"the field does not follow one turn of the robot ({', '.join(causes)}); turn about one"
            " axis, away from iron and running motors",
        )


def check_radius(across: float, inclination: float) -> None:
    """Refuse a circle of which too little is level; `across` is its radius over the strength.

    Raises
    ------
    Refusal
        `FIELD_TOO_STEEP`, `AXIS_ALONG_FIELD` or `CIRCLE_TOO_SMALL`.
    """
    if abs(inclination) > SCREENING.steepest:
        raise _too_steep(inclination)
    if across >= SCREENING.smallest_radius:
        return
    if math.cos(inclination) > 2.0 * SCREENING.smallest_radius:
        raise Refusal(
            Reason.AXIS_ALONG_FIELD,
            "the robot turned about an axis along the field, which shows nothing of the heading;"
            " turn about an upright axis",
        )
    raise Refusal(
        Reason.CIRCLE_TOO_SMALL,
        f"the field drew a circle of only {across:.0%} of its strength; turn about an axis further"
        " away from the field, or check the field's strength",
    )


def check_arc(arc: float, *, solved_by_knowledge: bool) -> None:
    """Refuse a turn that is too short; `solved_by_knowledge` says that a field or a gyro is known.

    Raises
    ------
    Refusal
        `ARC_TOO_SHORT`.
    """
    least = SCREENING.least_arc if solved_by_knowledge else SCREENING.least_arc_alone
    if arc >= least - SCREENING.arc_tolerance:
        return
    remedy = (
        "turn further, at best a full circle"
        if arc < SCREENING.least_arc
        else "turn further, or give the field's strength and inclination, or use a gyro"
    )
    raise Refusal(
        Reason.ARC_TOO_SHORT,
        f"the robot turned by {math.degrees(arc):.0f} degrees, which is too little; {remedy}",
    )


def _too_steep(inclination: float) -> Refusal:
    # A search may leave the quarter circle in which inclinations are told.
    steep = math.degrees(math.asin(math.sin(inclination)))
    return Refusal(
        Reason.FIELD_TOO_STEEP,
        f"at an inclination of {steep:.0f} degrees too little of the field is"
        " level for a compass; use another source of heading here",
    )
