"""A body that weakens the level field: soft iron far beyond what is believed of soft iron.

A sensor in the boot of a car, between steel sheets, sees half or a third of the level field. No
prior of a few percent leads there. The circle itself says how much is left where the reference is
known, and that share is taken for a gain of the two level axes before the fit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.geometry.circle3d import fit_circle_robustly
from magcal_ros.core.knowledge import Knowledge, SoftIron
from magcal_ros.core.samples.window import Window


@dataclass(frozen=True)
class WeakenedTuning:
    """When a body is taken to weaken the level field."""

    weak: float = 0.75
    """Share of the reference's level field below which a circle is taken for weakened."""
    weakest: float = 0.15
    """Share below which little more than noise is left."""
    earths_field: tuple[float, float] = (20e-6, 70e-6)
    """Tesla. A reference outside is none, and no circle is weak beside it."""
    least_phases: int = 30
    phases: int = 36
    """A circle's radius is believed where so many of so many sectors were seen."""
    largest_lean: float = math.radians(25.0)
    """Radians of the circle's plane from the level."""
    sideways: float = 0.95
    """Share of up along one of the magnetometer's axes from which the other two are the level
    ones."""


TUNING = WeakenedTuning()


UNEVEN = SoftIron(0.15, 0.1, always=True)
"""What takes away so much of the field is hardly the same in all directions."""


def level_share(window: Window, knowledge: Knowledge) -> float:
    """Return the circle's radius over the reference's level field; one where nobody can tell.

    Parameters
    ----------
    window : Window
        Samples of a turn.
    knowledge : Knowledge
        Its reference field, and the mounting.
    """
    reference = knowledge.reference
    if not reference.is_complete or len(window) < TUNING.least_phases:
        return 1.0
    if not TUNING.earths_field[0] <= reference.strength.value <= TUNING.earths_field[1]:
        return 1.0
    points = window.field @ knowledge.mounting.to_body.T
    circle = fit_circle_robustly(points)
    ups = unit(window.specific_force)
    up = unit(ups.mean(axis=0))
    if abs(float(circle.normal @ up)) < math.cos(TUNING.largest_lean):
        return 1.0
    x, y = np.linalg.svd(circle.normal[None])[2][1:] @ (points - circle.centre).T
    phases = np.floor((np.arctan2(y, x) + math.pi) / math.tau * TUNING.phases)
    if len(np.unique(phases)) < TUNING.least_phases:
        return 1.0
    # On a slope the axis may lean towards the field, and then a correct circle is smaller.
    slope = float(np.median(np.arccos(np.clip(ups @ up, -1.0, 1.0))))
    steepest = min(abs(reference.inclination.value) + slope, math.radians(89.0))
    return circle.radius / (reference.strength.value * math.cos(steepest))


def weakened(knowledge: Knowledge, share: float) -> Knowledge | None:
    """Return what is known with the level axes' gains so much smaller.

    None where the field is not weakened, or where no axis of the sensor points upwards.
    """
    if not TUNING.weakest < share < TUNING.weak:
        return None
    mounting = knowledge.mounting
    upwards = np.abs(mounting.pose[2])
    if upwards.max() < TUNING.sideways:
        return None
    gains = np.where(upwards > TUNING.sideways, 1.0, share) * mounting.gains
    return replace(knowledge, mounting=replace(mounting, gains=gains), soft_iron=UNEVEN)
