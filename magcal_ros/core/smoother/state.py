"""A value of all unknowns."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import exp_rotations
from magcal_ros.core.smoother.unknowns import ATTITUDE, EARTH, SHARED


@dataclass(frozen=True, eq=False)
class State:
    """A value of all unknowns."""

    attitude: FloatArray
    """Magnetic ENU to body axes. Shape (n, 3, 3)."""
    local: FloatArray
    """The nodes' other unknowns; the attitude's columns are zero. Shape (n, LOCAL)."""
    shared: FloatArray
    """Shape (SHARED,)."""
    centres: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    """Local disturbance at the centres of `Places`, µT, world axes. Shape (k, 3)."""

    def moved(self, local: FloatArray, shared: FloatArray) -> State:
        """Return the state after a step; `shared` holds the steps of the centres at its end."""
        turned = exp_rotations(local[:, ATTITUDE]) @ self.attitude
        values = self.local + local
        values[:, ATTITUDE] = 0.0
        centres = self.centres + shared[SHARED:].reshape(-1, 3)
        return State(turned, values, self.shared + shared[:SHARED], centres)

    @property
    def earth(self) -> FloatArray:
        """The Earth's field in magnetic ENU, µT."""
        level, down = self.shared[EARTH]
        return np.array([0.0, level, -down])


def damped(seconds: FloatArray, damping: float, pace: float) -> FloatArray:
    """Return exp(A t) for A = [[0, 1], [-pace^2, -damping]], shape (2, 2, n).

    By it a value and its change follow after so many seconds (n,) where the change is damped and
    the value is drawn back to zero.
    """
    root = np.sqrt(complex(0.25 * damping**2 - pace**2))
    root = root if abs(root) > 1e-6 else complex(1e-6)
    fades = np.exp(-0.5 * damping * seconds)
    even = np.real(fades * np.cosh(root * seconds))
    odd = np.real(fades * np.sinh(root * seconds) / root)
    half = 0.5 * damping * odd
    return np.array([[even + half, odd], [-(pace**2) * odd, even - half]])
