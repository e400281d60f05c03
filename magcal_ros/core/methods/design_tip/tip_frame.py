"""The frame of the design tip: samples enter it here, and its answer leaves.

Inside, axes are forward-right-down and gravity reads +1 downwards. A passive tip rotation
Rx(roll) Ry(pitch) is the installation of a URDF with the same roll and the opposite pitch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_ros.core.calibration.calibration import Installation
from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import FRD_FROM_FLU
from magcal_ros.core.knowledge import Mounting
from magcal_ros.core.samples.window import Window

ROUNDING = 1e-9
"""Share of gravity, or of the field, below which noise is rounding."""


@dataclass(frozen=True, eq=False)
class TipSamples:
    """A window as the design tip sees it."""

    down: FloatArray
    """Gravity in body axes, forward-right-down, scaled to a mean length of one. Shape (n, 3)."""
    raw: FloatArray
    """Raw field in the sensor's own axes, tesla. Shape (n, 3)."""
    field: FloatArray
    """Field with gains and nominal pose taken off, forward-right-down, tesla. Shape (n, 3)."""
    mounting: FloatArray
    """Takes `field` back to `raw`. Shape (3, 3)."""
    turned: FloatArray | None
    """Rotation between neighbouring samples by the gyro, body axes, radians. Shape (n - 1, 3)."""


def enter(window: Window, mounting: Mounting) -> TipSamples:
    """Take a window into the tip's frame."""
    matrix = mounting.matrix @ FRD_FROM_FLU
    down = -window.specific_force @ FRD_FROM_FLU
    turned = None
    if window.angular_rate is not None:
        rate = window.angular_rate @ FRD_FROM_FLU
        turned = 0.5 * (rate[1:] + rate[:-1]) * np.diff(window.time)[:, None]
    return TipSamples(
        down=down / np.linalg.norm(down, axis=1).mean(),
        raw=window.field,
        field=window.field @ np.linalg.inv(matrix).T,
        mounting=matrix,
        turned=turned,
    )


def leave(
    roll: float, pitch: float, centre: FloatArray, mounting: Mounting
) -> tuple[Correction, Installation]:
    """Return the tip's answer in the package's own frame.

    Parameters
    ----------
    roll, pitch : float
        Installation in the tip's sense, radians.
    centre : ndarray, shape (3,)
        Hard iron in `TipSamples.field` axes, tesla.
    mounting : Mounting
        The one that was taken off.
    """
    installation = Installation(roll, -pitch)
    matrix = installation.pose @ mounting.to_body
    return Correction(matrix, mounting.matrix @ FRD_FROM_FLU @ centre), installation
