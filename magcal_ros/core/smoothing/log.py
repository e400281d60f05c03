"""A drive as it is remembered: sensors averaged over a tenth of a second."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.samples.window import Window
from magcal_ros.core.smoothing.nodes import Means, Nodes, Track, nodes_of
from magcal_ros.core.smoothing.tuning import TUNING

if TYPE_CHECKING:
    from magcal_ros.core.smoothing.level import Level


@dataclass(frozen=True, eq=False)
class DriveLog:
    """Means over short stretches, one row each."""

    time: FloatArray
    """Seconds, increasing. Shape (m,)."""
    field: FloatArray
    """Raw field, tesla. Shape (m, 3)."""
    force: FloatArray
    """Specific force, m/s², body axes; the vehicle's own acceleration taken off where it is known.
    Shape (m, 3)."""
    rate: FloatArray
    """rad/s, body axes. Shape (m, 3)."""
    speed: FloatArray
    """m/s; NaN where nobody measures it. Shape (m,)."""
    bias_sigma: float = math.inf
    """rad/s per axis by which `rate` may still be biased, where a rest has shown the gyro's bias
    and it was taken off; infinite where none has."""

    def __len__(self) -> int:
        return len(self.time)

    @property
    def seconds(self) -> float:
        """How long it is."""
        return float(self.time[-1] - self.time[0]) if len(self) else 0.0

    @property
    def window(self) -> Window:
        """The same rows as samples."""
        rows = (self.time, self.field, self.force, self.rate)
        return Window(*rows, sigma_before=self.bias_sigma)

    def between(self, start: float, end: float) -> DriveLog:
        """Return the rows of a span of stamps, both ends included, seconds."""
        rows = slice(*np.searchsorted(self.time, [start, np.nextafter(end, np.inf)]))
        columns = ("time", "field", "force", "rate", "speed")
        return replace(self, **{name: getattr(self, name)[rows] for name in columns})

    @cached_property
    def level(self) -> Level:
        """Up at each row, and what goes with it."""
        # What only remembers a drive, as a running node does, needs none of this.
        from magcal_ros.core.smoothing.level import level_of

        return level_of(self.time, self.force, self.rate, self.bias_sigma)

    @cached_property
    def driven(self) -> FloatArray | None:
        """Speed at each row, m/s: zero for who stays, None where nothing tells it."""
        known = np.isfinite(self.speed)
        if known.mean() > 0.5:
            return np.interp(self.time, self.time[known], self.speed[known])
        return np.zeros(len(self)) if self.level.stays else None

    def nodes(self, to_body: FloatArray) -> Nodes:
        """Return the nodes of all of it; `to_body` as for `nodes_of`."""
        level = self.level
        rows = (self.time, self.field, level.up, self.rate, self.driven)
        track = Track(*rows, level.doubt, level.wander)
        return nodes_of(track, to_body)


def log_of(window: Window, speed: FloatArray | None = None) -> DriveLog:
    """Average a window that has a gyro.

    Parameters
    ----------
    window : Window
    speed : ndarray, shape (n,), optional
        m/s at its samples.
    """
    assert window.angular_rate is not None
    block = ((window.time - window.time[0]) / TUNING.row).astype(int)
    means = Means(np.flatnonzero(np.diff(block, prepend=-1)), len(window))
    return DriveLog(
        means.of(window.time),
        means.of(window.field),
        means.of(window.specific_force),
        means.of(window.angular_rate),
        np.full(len(means.first), np.nan) if speed is None else means.of(speed),
        window.bias_sigma,
    )
