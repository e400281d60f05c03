"""The faults that each sensor stream shows by itself."""

from __future__ import annotations

import math

import numpy as np

from magcal_ros.core.assessment.verdict import gravity_fault
from magcal_ros.core.doctor.doctor_tuning import HEALTH
from magcal_ros.core.doctor.finding import Finding, ok_or_severe, ok_or_warning, vector_in_words
from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, accumulated, runs
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, usual_size
from magcal_ros.core.samples.bursts import bursts_in_words
from magcal_ros.core.samples.samples_tuning import STREAMS
from magcal_ros.core.samples.spikes import white_noise, without_spikes
from magcal_ros.core.samples.streams import SWAY
from magcal_ros.core.samples.units import likely_field_unit, slow_words
from magcal_ros.core.samples.window import SensorLog

WRONG_UNIT = "field_unit"  # `Finding.key`
COMPARED = 4  # steps of the numbers below an extreme that are compared with it


TURN_ON_THE_SPOT = (
    "a turn on the spot between two rests can be calibrated all the same, a drive cannot"
)


def stamps_finding(name: str, time: FloatArray) -> Finding:
    """Check a stream's stamps: seconds, increasing, at least two."""
    gaps = np.diff(time)
    usual = float(np.median(gaps))
    deviations = np.clip(gaps / usual - 1.0, -1.0, 3.0)
    jitter = float(np.sqrt(np.mean(deviations**2)))
    evidence = (
        f"{1.0 / usual:.1f} Hz, gaps of {usual * 1e3:.1f} ms ± {jitter:.0%}, "
        f"at most {gaps.max():.2f} s"
    )
    slow = slow_words(usual) if name == "IMU" else ""
    if name != "IMU" and usual > SWAY:
        slow = (
            f"the field comes at {1.0 / usual:.2g} Hz: for a turn or a drive with a gyro, publish "
            "or record it at 10 Hz or more, or let the driver average its readings"
        )
    if slow:
        return ok_or_warning("slow", f"{name}: stamps", evidence, slow)
    if words := bursts_in_words(time):
        # The median gap is within a burst and does not give the rate.
        rate = len(gaps) / float(time[-1] - time[0])
        evidence = f"{rate:.1f} Hz in bursts, gaps of at most {gaps.max():.2f} s"
        return ok_or_severe("bursts", f"{name}: stamps", evidence, words)
    remedy = (
        "the stamps jitter: stamp each sample in the driver when it is measured, if possible by "
        "the sensor's own clock"
    )
    if are_samples_lost(deviations):
        remedy = "samples are lost: check the load of computer and network, and the queues' lengths"
    return ok_or_warning("stamps", f"{name}: stamps", evidence, remedy * (jitter > HEALTH.jitter))


def are_samples_lost(deviations: FloatArray) -> bool:
    """Return whether the gaps' `deviations` (n,) come from lost samples rather than jitter.

    A late stamp makes one gap longer and the next shorter: the sum of many gaps does not change.
    Lost samples add to this sum like the steps of a random walk. Its variance decides.
    """
    own = deviations - np.mean(deviations)
    path = accumulated(own)
    many = math.isqrt(len(own))
    return bool(np.var(path[many:] - path[:-many]) > 0.5 * many * np.var(own))


def repeats_finding(name: str, values: FloatArray) -> Finding:
    """Check for duplicate samples in values (n, d).

    Coarse numbers repeat by chance, independently on each axis. Long runs are of a frozen sensor,
    and are not counted.
    """
    same, long = repeats(values), in_long_runs(values)
    axes = (np.diff(values, axis=0) == 0.0)[~long[1:]]
    share = float(same[~long].mean()) if not long.all() else 0.0
    chance = float(np.prod(axes.mean(axis=0))) if len(axes) else 0.0
    words = "the driver publishes faster than the sensor measures: lower its rate to the sensor's"
    too_many = share - chance > HEALTH.share and share > 2.0 * chance
    return ok_or_warning("repeats", f"{name}: repeats", f"{share:.0%} repeated", words * too_many)


def in_long_runs(values: FloatArray) -> BoolArray:
    """Return which rows (n, d) are in a run of ten or more that equal the row before."""
    out = np.zeros(len(values), dtype=np.bool_)
    for first, end in runs(repeats(values)):
        out[first:end] = end - first >= 10
    return out


def repeats(values: FloatArray) -> BoolArray:
    """Return which rows (n, d) equal the row before, shape (n,)."""
    same = np.zeros(len(values), dtype=np.bool_)
    same[1:] = (np.diff(values, axis=0) == 0.0).all(axis=1)
    return same


def _in_words(field: float, unit: str) -> str:
    """Write a field in microtesla, or as published if `unit` says that the unit is wrong."""
    return f"{field:.3g} T as published" if unit else f"{field * 1e6:.3g} µT"


def field_findings(field: FloatArray) -> list[Finding]:
    """Check raw field samples, tesla, shape (n, 3), in the order of arrival."""
    size = usual_size(field)
    unit = likely_field_unit(size)
    usually = f"usually {_in_words(size, unit)}, hard iron included"
    step = max(_step(field[:, axis]) for axis in range(3))
    steps = f"steps of {_in_words(step, unit)}" if step else "no steps seen"
    finer = "choose a finer range of the sensor, or average in the driver"
    is_coarse = step > HEALTH.coarse and not unit
    full = [axis for axis in range(3) if saturated(field, axis).any()]
    largest = f"at most {_in_words(float(np.abs(field).max()), unit)} on an axis"
    wider = (
        f"{_axes(full)} reached the end of the range: choose a wider range, or move the sensor "
        "away from magnets"
    )
    return [
        ok_or_severe(WRONG_UNIT, "field: unit", usually, unit),
        ok_or_warning("resolution", "field: resolution", steps, finer * is_coarse),
        ok_or_severe("saturation", "field: range", largest, wider * bool(full)),
        alive_finding("field", field),
    ]


def gravity_size_finding(force: FloatArray, size: float) -> Finding:
    """Check the size of gravity that specific forces (n, 3) show, m/s² as published."""
    off = size / STANDARD_GRAVITY - 1.0
    evidence = f"{vector_in_words(np.median(force, axis=0))} m/s², {size:.2f} in all, "
    evidence += f"{round(off, 3) + 0.0:+.1%} off gravity"
    return ok_or_warning("force_unit", "accelerometer: unit", evidence, gravity_fault(size))


def alive_finding(name: str, values: FloatArray, force: FloatArray | None = None) -> Finding:
    """Check for axes of values (n, 3) that never change; `force` (m, 3) gives the vertical."""
    still = unchanging(values)
    evidence = f"{3 - len(still)} of 3 axes change"
    if not still:
        return ok_or_warning("frozen", f"{name}: axes alive", evidence)
    verb, them = ("never changes", "it") if len(still) == 1 else ("never change", "them")
    words = f"the {name}'s {_axes(still)} {verb}: the driver does not read {them}"
    if force is not None:
        up = up_axis(force)
        if up not in still:
            words = f"{words}, or the {name} does not measure {them}; {TURN_ON_THE_SPOT}"
            return ok_or_warning("frozen", f"{name}: axes alive", evidence, words)
        if len(still) == 2:
            words += f", and publishes the turn about {'xyz'[up]} as {'xyz'[3 - sum(still)]}"
    return ok_or_severe("frozen", f"{name}: axes alive", evidence, words)


def up_axis(force: FloatArray) -> int:
    """Return the axis closest to the vertical, by specific force (n, 3)."""
    return int(np.argmax(np.abs(force.mean(axis=0))))


def unchanging(values: FloatArray) -> list[int]:
    """Return the axes of values (n, 3) that never change."""
    return [axis for axis in range(3) if np.ptp(values[:, axis]) == 0.0]


def stuck_axes(field: FloatArray) -> list[int]:
    """Return the axes of a field (n, 3) that never change although noise would change them.

    Noise and resolution are those of the other axes. An axis of a quiet sensor with a coarse
    resolution may be constant by chance.
    """
    stuck = unchanging(field)
    others = np.delete(field, stuck, axis=1)
    if not 0 < len(stuck) < 3 or len(field) < HEALTH.fewest:
        return []
    steps = np.array([_step(axis) for axis in others.T])
    # Rounding looks like noise, most on a slow rise, but does not change a constant number.
    own = white_noise(others) ** 2 - 0.5 * steps**2
    noise = math.sqrt(max(0.0, float(own.min())))
    if noise < STREAMS.smallest:
        return []
    stays = math.erf(float(steps.max()) / (math.sqrt(8.0) * noise)) ** len(field)
    return stuck if stays < HEALTH.by_chance else []


def saturated(field: FloatArray, axis: int) -> BoolArray:
    """Return which samples (n, 3) are at the end of the range of `axis`, shape (n,).

    A saturated axis is at its extreme for many different values of the other two axes. Without
    saturation (a robot at rest, or coarse numbers near a maximum), there are hardly more such
    values than just below the extreme. If all numbers of an axis are a few coarse ones, there is
    nothing to compare.
    """
    values, others = field[:, axis], np.delete(field, axis, axis=1)
    none = np.zeros(len(values), dtype=np.bool_)
    levels, times = np.unique(values, return_counts=True)
    # Numbers that are not coarse hardly repeat, except at the end of the range.
    if len(levels) == 1 or (len(levels) <= COMPARED and np.median(times) > 1):
        return none
    cell = max(float(np.ptp(field, axis=0).max()) / 40.0, 1e-12)
    places = np.floor(others / cell).astype(np.int64)
    step = _step(values)
    for extreme in (values.max(), values.min()):
        at = np.asarray(values == extreme)
        below = ~at & (np.abs(values - extreme) < (COMPARED + 0.5) * step)
        stands = len(np.unique(places[at], axis=0))
        if (
            stands >= HEALTH.saturated[0]
            and stands > HEALTH.saturated[1] * len(np.unique(places[below], axis=0))
            and abs(extreme) == np.abs(values).max()
        ):
            return at
    return none


def _axes(which: list[int]) -> str:
    names = ["xyz"[axis] for axis in which]
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _step(values: FloatArray) -> float:
    """Return the step of numbers (n,) on a regular grid; zero if they are on none."""
    gaps = np.diff(np.unique(values))
    # Conversion to float32 makes grids slightly uneven.
    gaps = gaps[gaps > 1e-6 * float(np.abs(values).max())]
    if len(gaps) < 3:
        return 0.0
    step = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    near = gaps[gaps < 9.5 * step] / step
    # The usual deviation of numbers on no grid from whole numbers is a quarter.
    off = float(np.abs(near - np.rint(near)).mean())
    return step if len(near) > 0.5 * len(gaps) and off < HEALTH.lattice else 0.0


def noise_findings(log: SensorLog, factor: float) -> list[Finding]:
    """Check the noise of both sensors, by clean streams of three samples or more.

    `factor` converts the gyro's numbers to rad/s.
    """
    field = float(white_noise(log.field).max())
    unit = likely_field_unit(usual_size(log.field))
    is_noisy = field > HEALTH.field_noise and not unit
    words = (
        "the field is noisy: average in the driver, and move the sensor away from motors and their "
        "wires"
    )
    evidence = f"{_in_words(field, unit)} per sample"
    found = [ok_or_warning("field_noise", "field: noise", evidence, words * is_noisy)]
    found += _spikes(log)
    if log.has_gyro:
        rate = factor * float(white_noise(log.rate).max())
        force = float(white_noise(log.force).max())
        words = "the gyro is noisy: check its range, its low-pass filter and its mounting"
        evidence = f"gyro {math.degrees(rate):.2f} °/s, accelerometer {force:.3f} m/s² per sample"
        found.append(
            ok_or_warning("imu_noise", "IMU: noise", evidence, words * (rate > HEALTH.rate_noise))
        )
    return found


def _spikes(log: SensorLog) -> list[Finding]:
    """Check for single wrong samples of a field that comes fast enough to show them."""
    # With fewer samples in half a period, a sway looks like spikes.
    usual_gap = float(np.median(np.diff(log.field_time)))
    if len(log.field) < HEALTH.fewest or usual_gap > SWAY / 3.0:
        return []
    share = 1.0 - float(np.mean(without_spikes(log.field)))
    words = (
        "single samples are wrong: check the sensor's wires and bus (on I2C: shorter wires, "
        "stronger pull-up resistors or a slower clock)"
    )
    evidence = f"{share:.0%} of the samples deviate from their neighbours"
    return [ok_or_warning("spikes", "field: spikes", evidence, words * (share > HEALTH.share))]
