"""Faults of incoming samples, and the units that they may be in."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from magcal_ros.core.errors import Reason
from magcal_ros.core.geometry.arrays import FloatArray, block_means, trapezoids
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, unit, usual_size
from magcal_ros.core.geometry.rotations import chained, exp_rotations
from magcal_ros.core.samples.samples_tuning import COMPLAINTS, STREAMS
from magcal_ros.core.samples.streams import DropReason, Streams
from magcal_ros.core.samples.window import Window

LOCAL_STRENGTH = (
    "the field's strength there (tesla), divided by the published one without hard iron,"
)


@dataclass(frozen=True)
class FieldUnit:
    """A unit in which a driver may publish the field instead of tesla."""

    name: str
    factor: str  # from this unit to tesla
    strengths: tuple[float, float]  # range of the Earth's field in it
    sizes: tuple[float, float]  # range of raw samples in it, hard iron included
    drivers: str = ""  # drivers that are known to publish it


FIELD_UNITS: tuple[FieldUnit, ...] = (
    FieldUnit("gauss", "1e-4", (0.2, 0.7), (0.05, 5.0), "VectorNav, imu_3dm_gx4, Gazebo"),
    FieldUnit("a relative unit (1 on Earth)", LOCAL_STRENGTH, (0.7, 1.2), (0.7, 1.3), "Xsens MTi"),
    FieldUnit(
        "a relative unit (1.4 on Earth)", LOCAL_STRENGTH, (1.2, 1.9), (1.2, 1.9), "Inertial Sense"
    ),
    FieldUnit("microtesla", "1e-6", (20.0, 70.0), (5.0, 150.0)),
    FieldUnit("milligauss", "1e-7", (200.0, 700.0), (150.0, 5000.0)),
    FieldUnit("nanotesla", "1e-9", (20_000.0, 70_000.0), (5000.0, 150_000.0)),
    FieldUnit(
        "a thousand times milligauss", "1e-10", (2e5, 7e5), (80_000.0, 5e6), "MAVROS with ArduPilot"
    ),
)
UNLIKELY = 0.05  # probability below which a unit is not named


def likely_field_unit(size: float) -> str:
    """Say in words which units raw samples of `size` "tesla" may have; empty if none fits."""
    fitting = [unit for unit in FIELD_UNITS if unit.sizes[0] <= size < unit.sizes[1]]
    return _named(fitting, f"a field of {size:.3g} T")


def unit_by_strength(strength: float, sigma: float = 0.0) -> str:
    """Say in words which units a field of this strength without hard iron may have.

    `strength` and `sigma` are in "tesla" as published. The likeliest unit comes first; empty if it
    may be tesla. If no unit gives the Earth's field, the unit of raw samples of this size.
    """
    shares = {unit: _share_within(unit.strengths, strength, sigma) for unit in FIELD_UNITS}
    by_size = likely_field_unit(strength)
    if sum(shares.values()) < UNLIKELY or not by_size:
        return by_size
    # In each unit every strength is as likely.
    density = {u: share / (u.strengths[1] - u.strengths[0]) for u, share in shares.items()}
    least = UNLIKELY * sum(density.values())
    fitting = [u for u in sorted(density, key=density.__getitem__)[::-1] if density[u] > least]
    return _named(fitting, f"a field of {strength:.3g} T without hard iron")


def _share_within(limits: tuple[float, float], value: float, sigma: float) -> float:
    """Return the probability that a value lies within limits."""
    spread = math.sqrt(2.0) * max(sigma, 1e-9 * abs(value), 1e-300)
    below, above = (math.erf((limit - value) / spread) for limit in limits)
    return 0.5 * (above - below)


def _named(fitting: list[FieldUnit], what: str) -> str:
    """Return a sentence about one unit, or a question about several; empty of none."""
    if not fitting:
        return ""
    published = " published as tesla"
    by = [f" (as by {unit.drivers})" * bool(unit.drivers) for unit in fitting]
    if len(fitting) == 1:
        looks = f"{fitting[0].name}{published}{by[0]}"
    else:
        named = [unit.name + who for unit, who in zip(fitting, by, strict=True)]
        looks = f"{' or '.join(named)}{published}"
    factors = [*dict.fromkeys(unit.factor for unit in fitting)]
    if len(factors) == 1:
        remedy = f"multiply by {factors[0]} in the driver"
    else:
        remedy = (
            f"look up which one the driver publishes, and multiply by {' or '.join(factors)}, "
            "respectively"
        )
    return f"{what} looks like {looks}; {remedy}"


def slow_words(gap: float) -> str:
    """Say that an IMU with a gap of so many seconds is too slow; empty if it is not."""
    if not gap > STREAMS.max_gap:
        return ""
    return (
        f"the IMU comes at {1.0 / gap:.2g} Hz by its stamps, too slowly: the node does not "
        f"interpolate over gaps of more than {STREAMS.max_gap:g} s; publish or record it at 10 Hz "
        "or more, if possible at 50 Hz"
    )


def slow_field_words(gap: float) -> str:
    """Say that a field with a gap of so many seconds is too slow for a drive; else empty."""
    if not gap > STREAMS.longest_field_gap:
        return ""
    return (
        f"the field comes at {1.0 / gap:.2g} Hz, too slowly: the gyro is integrated over "
        f"at most {STREAMS.longest_field_gap:g} s; a drive needs the field at "
        f"{1.0 / STREAMS.longest_field_gap:.1g} Hz or more, if possible at 10 Hz; `magcal fit` can "
        "use a slower recording"
    )


Z_NOT_UP = (
    "z points down or sideways at rest, but REP-103 requires z up; stand the robot upright or turn "
    "the axes in the driver, and check that acceleration is not published as gravity (+9.81 "
    "upwards at rest)"
)

ROLLED = (
    "the robot was rolled or pitched rather than turned; turn it a full circle about its vertical "
    "axis"
)
TURNED_OVER = (
    "the sensor was turned over, through all orientations; the method ellipsoid is for this, if "
    "the axes of magnetometer and IMU are parallel; without it, turn the robot upright, about its "
    "vertical axis"
)

ACCELERATION_UNITS: tuple[tuple[float, float, str, str], ...] = (
    (0.8, 1.2, "g", "9.80665"),
    (800.0, 1200.0, "milli-g", "0.00980665"),
)
"""Size range of gravity when published in another unit, its name, its factor."""


def likely_acceleration_unit(size: float) -> str:
    """Say in words which unit gravity of `size` "m/s²" probably has; empty if none fits."""
    for low, high, name, factor in ACCELERATION_UNITS:
        if low <= size < high:
            return f"it looks like {name} published as m/s²; multiply by {factor} in the driver"
    return ""


MISLED_BY_AXES = (
    Reason.AMBIGUOUS,
    Reason.AXES_DISAGREE,
    Reason.AXIS_ALONG_FIELD,
    Reason.AXIS_HORIZONTAL,
    Reason.FIELD_NOT_ON_A_PLANE,
    Reason.FIELD_TOO_STEEP,
    Reason.NO_SOLUTION,
)
"""Refusals that wrong axes can cause."""

LEAST_UPRIGHT = 0.5
"""Component of gravity along body z, over its size, from which z counts as up: less than 60 degrees
of tilt. Also the least length of the mean direction of gravity of a sensor that is not turned
over."""


def was_turned_over(window: Window) -> bool:
    """Return whether the sensor had no usual orientation, as if turned over by hand.

    The mean direction of gravity is then short, and the robot's up is unknown.
    """
    up = usual_up(window.time, window.specific_force, window.angular_rate)
    return float(np.linalg.norm(up)) < LEAST_UPRIGHT


def usual_up(time: FloatArray, force: FloatArray, rate: FloatArray | None) -> FloatArray:
    """Return the mean direction (3,) of `gravity_in_body`, which is short if directions vary."""
    return np.asarray(unit(gravity_in_body(time, force, rate)).mean(axis=0))


NOT_NUMBERS = "samples are not finite (NaN or infinite): let the driver leave them out"

NOTHING_READ = "the driver reads nothing: check the wiring, and the driver's error messages"
WORDS = {
    DropReason.NOT_FINITE: NOT_NUMBERS,
    DropReason.ZERO: f"samples are all zero: {NOTHING_READ}",
    DropReason.ABSENT: "messages carry no acceleration: choose a topic of the IMU that has one",
    DropReason.ZERO_STAMP: "stamps are zero: the driver must stamp its messages",
    DropReason.BACKWARD_STAMP: "stamps go backward: let one driver stamp them, with one clock",
    DropReason.UNPAIRED: "samples have no IMU sample within window.max_gap_s: check both stamps",
    DropReason.UNREADABLE: "messages are damaged: their bytes do not match their type",
}

IMU_WORDS = WORDS | {
    DropReason.TOO_LARGE: "samples are too large for an acceleration in m/s² or a rate in rad/s"
}


@dataclass(frozen=True)
class InputCounts:
    """Counts of the messages of one topic."""

    topic: str
    messages: int
    drops: Counter[DropReason] = field(default_factory=Counter)  # messages not used, by reason

    def since(self, earlier: InputCounts) -> InputCounts:
        """Return the counts since an earlier count of the same topic."""
        drops = Counter({drop: n - earlier.drops[drop] for drop, n in self.drops.items()})
        return InputCounts(self.topic, self.messages - earlier.messages, drops)


def complaints(streams: Streams, imu: InputCounts, mag: InputCounts) -> list[str]:
    """Return the faults of two streams in words, with remedies; empty if there is none."""
    found = []
    if mag.drops[DropReason.TOO_LARGE]:
        unit = likely_field_unit(streams.largest_field)
        found.append(unit or f"a field of {streams.largest_field:.3g} T is not the Earth's")
    for counts, all_words in ((imu, IMU_WORDS), (mag, WORDS)):
        found += [
            f"{counts.topic}: {counts.drops[drop]} of {counts.messages} {words}"
            for drop, words in all_words.items()
            if counts.drops[drop] > COMPLAINTS.worth_a_word * max(counts.messages, 1)
        ]
    if streams.turned_unchanged > COMPLAINTS.frozen_turn:
        found.append(
            f"{mag.topic} repeats one value although the robot has turned by "
            f"{math.degrees(streams.turned_unchanged):.0f}°: the sensor is frozen, restart its "
            "driver"
        )
    elif mag.drops[DropReason.REPEATED] > COMPLAINTS.most_repeats * max(mag.messages, 1):
        found.append(f"{mag.topic} repeats one value: the sensor is frozen or at rest")
    for counts, stamps in ((imu, streams.imu_stamps), (mag, streams.field_stamps)):
        found += [f"{counts.topic}: {words}"] if (words := stamps.bursts_in_words) else []
    offset = stamp_offset(streams)
    if offset:
        found.append(
            f"the stamps of field and IMU are {offset:+.1f} s apart: "
            "let one clock stamp both sensors"
        )
    return found


def stamp_offset(streams: Streams) -> float:
    """Return the lead of the field's stamps over the IMU's, seconds; zero if there is no fault.

    The true lead lies between the leads at the newest sample of each sensor. Neither of these grows
    if a sensor dies.
    """
    least, most = streams.lead_at_imu, streams.lead_at_field
    if math.isfinite(least) and least > min(
        COMPLAINTS.largest_offset, COMPLAINTS.ahead_in_gaps * streams.max_gap
    ):
        return least
    return most if math.isfinite(most) and most < -COMPLAINTS.largest_offset else 0.0


MEAN_OVER = 4.0  # seconds of one mean; a hand changes its velocity by little over this time


def gravity_in_body(time: FloatArray, force: FloatArray, rate: FloatArray | None) -> FloatArray:
    """Return gravity in specific forces (n, 3) of a moved sensor, m/s² as published, (n, 3).

    The sensor's own acceleration, by a lever arm or a hand, averages out over some seconds in axes
    that do not rotate. The means replace the forces if their usual length is nearer to gravity: a
    difference that motion explains is not the accelerometer's, and a faulty gyro does no harm.

    `time` (n,) increases, seconds. `rate` (n, 3) is in rad/s; without a gyro forces are returned.
    """
    if rate is None or len(time) < 2:
        return force
    attitude = chained(exp_rotations(-trapezoids(time, rate))[None])[0]
    span = float(time[-1] - time[0])
    count = max(1, round(span / MEAN_OVER))
    # Not an array of all blocks: after a jump of the clock nearly all of them are empty.
    block = np.floor((time - time[0]) * (count / max(span, 1e-9)))
    first = np.unique(np.minimum(block, count - 1.0), return_index=True)[1]
    means = block_means(np.einsum("nij,ni->nj", attitude, force), first)
    mean = np.repeat(means, np.diff(np.append(first, len(time))), axis=0)
    averaged = np.einsum("nij,nj->ni", attitude, mean)
    return min(force, averaged, key=lambda each: abs(usual_size(each) - STANDARD_GRAVITY))


def gravity_size(time: FloatArray, force: FloatArray, rate: FloatArray | None) -> float:
    """Return the usual length of `gravity_in_body`, m/s² as published."""
    return usual_size(gravity_in_body(time, force, rate))
