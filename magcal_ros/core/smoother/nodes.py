"""Nodes: means of the samples, with the gyro's rotation between neighbours."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from magcal_ros.core.geometry.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    accumulated,
    block_means,
    trapezoids,
)
from magcal_ros.core.geometry.rotations import chained, exp_rotations, rotation_vectors
from magcal_ros.core.samples.rest import AttachedRest
from magcal_ros.core.samples.spikes import NEIGHBOURS, spikes_replaced, white_noise
from magcal_ros.core.samples.window import Window, working_axes
from magcal_ros.core.smoother.currents import Clock, Currents
from magcal_ros.core.smoother.gyro_steps import gyro_steps
from magcal_ros.core.smoother.unknowns import MICROTESLA

LINKS = ("seconds", "turned", "angle", "force", "along", "samples", "unseen")
"""Fields of `Nodes` that describe the links between nodes."""
NO_GYRO_VARIANCE, NO_GYRO_SECONDS = 10.0, 1000.0
"""Variance of the rotation (radians²) and duration (seconds) of a link without gyro samples."""
WITHOUT_GYRO: Mapping[str, float | FloatArray] = {
    "seconds": NO_GYRO_SECONDS,
    "unseen": NO_GYRO_VARIANCE,
    **dict.fromkeys(("turned", "along"), np.eye(3)),
    **dict.fromkeys(("angle", "samples"), 0.0),
}
"""Values of a link without gyro samples."""
STILL_FIELD = 0.3
"""Change of the mean field between nodes of a robot at rest, in addition to noise, µT."""


@dataclass(frozen=True)
class Spacing:
    """How samples are averaged to nodes."""

    longest: float = 0.6  # seconds of a node
    most_turn: float = math.radians(6.0)  # radians that a robot turns during a node
    most_unseen: float = math.radians(0.1)
    """Rotation within a node that a low sample rate may miss, radians."""
    short: float = 0.3
    """Seconds of a node beside the ends of a window, where rests are short, and without a gyro."""
    most: int = 400  # nodes; in longer windows all nodes become longer


@dataclass(frozen=True, eq=False)
class Nodes:
    """Means of samples, and the links between the middles of neighbouring nodes."""

    time: FloatArray  # seconds of the middles. Shape (n,).
    field: FloatArray  # mean raw field in nominal body axes, microtesla. Shape (n, 3).
    inside: FloatArray
    """Mean rotation from the body axes in the middle to those of the samples. Shape (n, 3, 3)."""
    rate: FloatArray  # mean turn rate by the gyro, rad/s. Shape (n, 3).
    count: FloatArray  # samples in each mean. Shape (n,).
    quiet: BoolArray
    """Whether the field is constant, and force and rate vary as at rest. Shape (n,)."""
    seconds: FloatArray  # between the middles of neighbours. Shape (n - 1,).
    turned: FloatArray
    """Rotation from the body axes of a node to those of the next, by the gyro. Shape (n - 1, 3,
    3)."""
    angle: FloatArray  # the integral of the turn rate between them, radians. Shape (n - 1, 3).
    force: FloatArray  # mean specific force between the middles, m/s². Shape (n - 1, 3).
    along: FloatArray
    """Mean rotation from the body axes of the first node to those of the force's samples. Shape (n
    - 1, 3, 3)."""
    samples: FloatArray  # number of force samples in each mean. Shape (n - 1,).
    unseen: FloatArray
    """Variance of the angle due to a low sample rate, radians². Shape (n - 1, 3)."""
    noise: float  # white noise of a field sample per axis, microtesla
    mean_force: FloatArray
    """Mean specific force of the same samples as the field, m/s². Shape (n, 3)."""
    speed: FloatArray | None = None
    """Mean speed ahead, m/s; NaN where none was measured. Shape (n,)."""
    added_from: float = math.inf  # time from which added iron is present, seconds
    tied_to: FloatArray | None = None
    """Without a gyro: axes as columns, the last one along the axis of the turn. The rates are then
    estimated from the field, and used only for averaging. Shape (3, 3)."""
    currents: Currents | None = None  # of the battery; None if it was not measured
    working: tuple[bool, bool, bool] = (True, True, True)  # which axes of the gyro measure

    def __len__(self) -> int:
        return len(self.time)

    def after(self, start: float) -> Nodes:
        """Return the nodes after `start`, seconds."""
        assert self.currents is None  # A drive's log has no battery.
        first = int(np.searchsorted(self.time, start, side="right"))
        return self._changed(lambda _, value: value[first:])

    def _changed(self, change: Callable[[str, FloatArray], FloatArray]) -> Nodes:
        """Return the nodes with a change of every field that has a value for each node or link."""
        changes: dict[str, Any] = {}
        for each in fields(self):
            value = getattr(self, each.name)
            if isinstance(value, np.ndarray) and each.name != "tied_to":
                changes[each.name] = change(each.name, value)
        return replace(self, **changes)

    @property
    def is_tied(self) -> BoolArray:
        """Whether the gyro has samples all the way between neighbours, shape (n - 1,)."""
        return np.asarray(self.unseen.max(axis=1) < NO_GYRO_VARIANCE)

    def in_axes(self, rotation: FloatArray) -> Nodes:
        """Return the nodes in rotated body axes (3, 3), with the same field and force."""
        back = rotation.T
        return replace(
            self,
            inside=rotation @ self.inside @ back,
            rate=self.rate @ back,
            turned=rotation @ self.turned @ back,
            angle=self.angle @ back,
            along=rotation @ self.along @ back,
            tied_to=None if self.tied_to is None else rotation @ self.tied_to,
        )

    def turned_since(self, delay: float) -> tuple[FloatArray, FloatArray]:
        """Return the turn by the gyro over a delay before each node, and the rate at its start.

        `delay` is in seconds, negative for times after the node. Radians and rad/s, shapes
        (n, 3). The integrated rate is interpolated by cubic Hermite polynomials, and extrapolated
        linearly.
        """
        if delay == 0.0:
            return np.zeros_like(self.rate), self.rate
        angle = np.cumsum(np.insert(self.angle, 0, 0.0, axis=0), axis=0)
        then = self.time - delay
        first = np.clip(np.searchsorted(self.time, then, side="right") - 1, 0, len(self) - 2)
        span = (self.time[first + 1] - self.time[first])[:, None]
        share = (then - self.time[first])[:, None] / span
        x = np.clip(share, 0.0, 1.0)
        start, end = self.rate[first], self.rate[first + 1]
        change = angle[first + 1] - angle[first] - span * start
        bend = span * (end - start) - 2.0 * change
        rate = start + (2.0 * x * (change - bend) + 3.0 * x**2 * bend) / span
        before = angle[first] + x * span * start + x**2 * (change + (x - 1.0) * bend)
        return angle - before - (share - x) * span * rate, rate

    @cached_property
    def usual_count(self) -> float:
        """Median number of samples in a mean of the field."""
        return float(np.median(self.count))

    @cached_property
    def usual_samples(self) -> float:
        """Median number of force samples in a mean that has any."""
        return float(np.median(self.samples[self.samples > 0]))

    @property
    def link_rate(self) -> FloatArray:
        """Mean turn rate between neighbours, rad/s, shape (n - 1, 3)."""
        return np.asarray(self.angle / self.seconds[:, None])


def nodes_of(window: Window, to_body: FloatArray, spacing: Spacing = Spacing()) -> Nodes:
    """Return the nodes of a window with a gyro; `to_body` (3, 3) is `Mounting.to_body`."""
    rate, time, rested = window.angular_rate, window.time, window.rested
    assert rate is not None
    field = _without_spikes(window, spacing) @ to_body.T * MICROTESLA
    steps, unseen, velocity, intervals = gyro_steps(window)
    attitude = chained(exp_rotations(-steps)[None])[0]
    lost = (np.diff(time) > window.longest_step).astype(float)
    first = _first_rows(time, steps, unseen, spacing, lost)
    last = np.append(first[1:], len(time))
    middle = (first + last - 1) // 2
    seconds, back = np.diff(time[middle]), np.swapaxes(attitude[middle], 1, 2)

    def between(steps: FloatArray) -> FloatArray:
        """Return the sums of steps (m - 1, ...) between the middles of neighbours."""
        return np.diff(accumulated(steps)[middle], axis=0)

    if rested is None:
        quiet = _quiet(window, field, first)
    else:
        quiet = np.logical_and.reduceat(rested, first)
    nodes = Nodes(
        time=time[middle],
        field=block_means(field, first),
        inside=block_means(attitude, first) @ back,
        rate=block_means(rate, first),
        count=(last - first).astype(float),
        quiet=quiet,
        seconds=seconds,
        turned=attitude[middle[1:]] @ back[:-1],
        samples=between(intervals),
        angle=between(steps),
        force=between(velocity) / seconds[:, None],
        along=between(trapezoids(time, attitude)) @ back[:-1] / seconds[:, None, None],
        unseen=between(unseen),
        noise=float(np.median(white_noise(field))),
        mean_force=block_means(window.specific_force, first),
        speed=None if window.wheel_speed is None else block_means(window.wheel_speed, first),
        currents=_currents(window, first, quiet),
        working=working_axes(rate),
    )
    without_gyro = between(lost) > 0.0
    for name, value in WITHOUT_GYRO.items():
        getattr(nodes, name)[without_gyro] = value
    for rest in window.rests:
        is_before = rest.beside <= time[len(time) // 2]
        beside = int(np.searchsorted(time, rest.beside).clip(0, len(time) - 1))
        to_rest = rest.turned @ attitude[beside] @ back[0 if is_before else -1]
        nodes = _with_rest(nodes, rest, to_rest, to_body, is_before=is_before)
    return nodes


def _without_spikes(window: Window, spacing: Spacing) -> FloatArray:
    """Return the field (n, 3) without spikes, which would spoil the mean of a node.

    Slow samples are returned as they are: the field changes between them, and a node of few samples
    is an outlier itself if one of them is a spike.
    """
    step = float(np.median(np.diff(window.time))) if len(window) > 1 else math.inf
    is_fast = NEIGHBOURS * step <= spacing.longest
    return spikes_replaced(window.field) if is_fast else window.field


def _first_rows(
    time: FloatArray, steps: FloatArray, unseen: FloatArray, spacing: Spacing, lost: FloatArray
) -> IntArray:
    """Return the first row of each node."""
    turned = np.linalg.norm(steps, axis=1) / spacing.most_turn
    missed = np.sqrt(unseen.max(axis=1)) / spacing.most_unseen
    from_end = np.minimum(time - time[0], time[-1] - time)[:-1]
    # A rest must last two nodes to be detected, and that beside a turn may be short.
    short = min(spacing.short, spacing.longest)
    longest = np.where(from_end < 2.0 * spacing.longest, short, spacing.longest)
    worth = np.maximum.reduce([np.diff(time) / longest, turned, missed])
    clock = accumulated(worth)
    clock /= max(1.0, clock[-1] / spacing.most)
    clock += accumulated(lost)
    first = np.flatnonzero(np.diff(np.floor(clock + 1e-9), prepend=-1.0))
    # A short remainder at the end is dropped: as a node it would look quiet.
    return first[:-1] if len(first) > 1 and clock[-1] - clock[first[-1]] < 0.5 else first


def _currents(window: Window, first: IntArray, quiet: BoolArray) -> Currents | None:
    """Return the currents in the nodes, whose first rows are `first`."""
    if window.battery is None:
        return None
    assert window.angular_rate is not None
    time, last = window.time, np.append(first[1:], len(window)) - 1
    beside = 0.5 * float(np.median(np.diff(time)))
    rests = np.repeat(quiet, np.diff(first, append=len(window)))
    clock = Clock.of(window.battery, time, window.angular_rate, rests)
    return Currents(window.battery, clock, time[first] - beside, time[last] + beside)


def _quiet(window: Window, field: FloatArray, first: IntArray) -> BoolArray:
    """Return in which nodes the robot may be at rest, by field, force and rate, shape (n,).

    The field (n, 3) is in µT. At rest force and rate vary little more than in the quietest tenth of
    the nodes (ten at most), and the field is the same as that of a neighbour, within the noise.
    """
    assert window.angular_rate is not None
    spreads = [_spread(e, first) for e in (field, window.specific_force, window.angular_rate)]
    least = [float(np.quantile(each, min(0.1, 10.0 / len(first)))) for each in spreads]
    quiet = (spreads[1] < 1.6 * least[1] + 0.01) & (spreads[2] < 1.6 * least[2] + 0.002)
    noise = least[0] / np.sqrt(np.diff(first, append=len(window)))
    limit = STILL_FIELD + 3.0 * np.hypot(noise[1:], noise[:-1])
    stays = np.abs(np.diff(block_means(field, first), axis=0)).max(axis=1) < limit
    return np.asarray(quiet & (np.append(stays, False) | np.insert(stays, 0, False)))


def _spread(values: FloatArray, first: IntArray) -> FloatArray:
    """Return the largest standard deviation of the three axes within each node."""
    mean = np.repeat(block_means(values, first), np.diff(first, append=len(values)), axis=0)
    return np.asarray(np.sqrt(block_means((values - mean) ** 2, first)).max(axis=1))


def _with_rest(
    nodes: Nodes, rest: AttachedRest, to_rest: FloatArray, to_body: FloatArray, *, is_before: bool
) -> Nodes:
    """Add a rest before or after a window as two nodes, its start and its end.

    `to_rest` is the rotation from the body axes of the nearest node to those at rest.
    """
    at, side, away = (0, 0, -1.0) if is_before else (len(nodes), len(nodes) - 1, 1.0)
    end = float(nodes.time[side])
    near = end + away * max(abs(end - rest.beside), 0.1)
    far = near + away * rest.seconds
    per_second = nodes.count.sum() / max(np.ptp(nodes.time), 1e-3)
    field, force = np.tile(to_body @ rest.field * MICROTESLA, (3, 1)), np.tile(rest.force, (3, 1))
    kept, gap, to_next = (slice(0, 2), 1, to_rest.T) if is_before else (slice(1, 3), 0, to_rest)
    count, turned, samples = np.ones(3), np.tile(np.eye(3), (2, 1, 1)), np.zeros(2)
    count *= max(0.5 * rest.seconds * per_second, 1.0)
    turned[gap], samples[1 - gap] = to_next, count[0]
    # The node beside the rest, and both ends of the rest.
    made = replace(
        at_rest(np.sort([end, near, far]), field, force),
        count=count,
        turned=turned,
        angle=-rotation_vectors(turned),
        samples=samples,
    )

    def joined(name: str, value: FloatArray) -> FloatArray:
        new, is_link = getattr(made, name), name in LINKS
        return np.insert(value, [min(at, len(value))] * 2, new if is_link else new[kept], axis=0)

    found = nodes._changed(joined)
    if nodes.currents is None:
        return found
    return replace(found, currents=nodes.currents.with_rest(at, *sorted((far, near))))


def at_rest(time: FloatArray, field: FloatArray, force: FloatArray) -> Nodes:
    """Return nodes at rest without samples between them; field and force as those of `Nodes`."""
    n, links = len(time), len(time) - 1
    eyes, zeros = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3))
    return Nodes(
        time=time,
        field=field,
        inside=eyes,
        rate=zeros,
        count=np.ones(n),
        quiet=np.ones(n, dtype=np.bool_),
        seconds=np.diff(time),
        turned=eyes[1:],
        angle=zeros[1:],
        force=force[1:],
        along=eyes[1:],
        samples=np.zeros(links),
        unseen=zeros[1:],
        noise=0.0,
        mean_force=force,
        speed=np.zeros(n),
    )
