"""The assumptions of the fused yaw: each number with its unit and its reason."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class DisturbanceTuning:
    """How a disturbed field is recognised, and how far it may turn the yaw."""

    strength: float = 0.02
    dip: float = math.radians(1.0)
    """Share of its strength, and radians of its inclination, by which a good field varies from
    place to place (1 sigma)."""
    noise_share: float = 2.0  # sigmas of the calibration's field noise that are added to both
    gate: float = 3.0
    """Sigmas of deviation from which a field is no compass, and from which a sample has less
    weight; amplitudes that a single deviation counts for at most, or passing iron would be taken
    for the street."""
    believed_below: float = 2.0  # sigmas to which an ignored field must come back
    memory: float = 0.3  # seconds over which strength and dip are averaged
    amplitude: float = 0.01
    """Share of the field's strength per axis that places add to it, before any was seen: 0.5 µT, as
    on open land. However clean the field looks, half of it remains."""
    amplitude_memory: float = 100.0
    """Seconds over which the amplitude is learnt: a few hundred metres of road."""


@dataclass(frozen=True)
class FusionTuning:
    """The Kalman filter on yaw, gyro bias and the field's disturbance."""

    angle_walk: float = 1e-3  # radians per root second that a gyro loses
    turn_error: float = 0.005  # share of a turn that the gyro's scale gets wrong, per root radian
    bias_sigma: float = 0.001  # rad/s about up that the up filter left, at the least
    bias_walk: float = 1.8e-5
    walk_spread: float = 1.0
    """Median of how much a gyro's bias walks, rad/s per root second, and standard deviation of its
    natural logarithm: cheap gyros drift in a minute by a thousandth to a hundredth of a degree per
    second."""
    loss_spread: float = 1.5
    """Standard deviation of the natural logarithm of the share of `angle_walk` and `turn_error`,
    squared, that a gyro has."""
    tilt_tau: float = 3.0
    """Seconds over which errors by tilt are correlated: more samples add no information."""
    noise_tau: float = 0.5  # the same for the field's noise and for small iron on the way
    small_iron: float = 0.3  # share of the disturbance's variance that changes within two metres
    moving_tau: float = 12.0
    """Seconds over which the disturbance of a moving robot is correlated: streets bend the field
    over 25 to 30 m, which is 0.7 after a second and gone after 12 s."""
    standing_tau: float = 300.0  # the same of a robot that stands
    learning_step: float = 0.1  # seconds after which the disturbance is learnt anew
    overruled_after: float = 3.0
    """Seconds of a good field that disagrees beyond all doubt, after which rather the propagated
    yaw is wrong."""
    beyond_doubt: float = 4.0
    """Squared gates of disagreement that count fully; what disagrees less needs longer."""
    heading_tau: float = 2.0
    """Seconds over which the error of a heading from another device is correlated."""
    heading_gate: float = 4.0  # sigmas by which such a heading may miss
    unknown: float = 0.5  # radians of uncertainty of a start in a field that is not expected
    start: float = 5.0  # seconds from the start in which that may be found out


DISTURBANCE, FUSION = DisturbanceTuning(), FusionTuning()
