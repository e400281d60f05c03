"""The current of a battery in each node."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray, integral
from magcal_ros.core.samples.battery import Battery

FAR = 1e4  # seconds beyond the first and the last message, up to which the current stays


@dataclass(frozen=True, eq=False)
class Currents:
    """Means of the current over the nodes."""

    battery: Battery
    begin: FloatArray
    end: FloatArray  # of each node's samples, seconds. Shapes (n,).

    def at(self, delay: float) -> tuple[FloatArray, FloatArray]:
        """Return the currents beyond the reference, A, and their change by the delay, A/s, (n,).

        A message tells the current that flowed `delay` seconds before its stamp.
        """
        time, current = self.battery.time, self.battery.current
        time = np.concatenate([[time[0] - FAR], time, [time[-1] + FAR]])
        current = np.concatenate([current[:1], current, current[-1:]])
        done = integral(time, current)
        moments = np.stack([self.begin, self.end]) + delay
        row = np.searchsorted(time, moments).clip(1, len(time) - 1) - 1
        now = np.interp(moments, time, current)
        up_to = done[row] + 0.5 * (current[row] + now) * (moments - time[row])
        seconds = self.end - self.begin
        mean = (up_to[1] - up_to[0]) / seconds - self.battery.reference
        return mean, (now[1] - now[0]) / seconds

    def with_rest(self, at: int, begin: float, end: float) -> Currents:
        """Return the currents with a rest from one moment to another as two nodes, from `at` on."""
        nodes = np.array([at, at])
        return Currents(
            self.battery, np.insert(self.begin, nodes, begin), np.insert(self.end, nodes, end)
        )

    def part(self, rows: slice) -> Currents:
        """Return the currents of some nodes."""
        return Currents(self.battery, self.begin[rows], self.end[rows])
