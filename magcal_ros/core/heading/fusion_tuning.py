"""The assumptions of the fused yaw: each number with its unit and its reason."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from magcal_ros.core.samples.streams import STREAMS


@dataclass(frozen=True)
class DisturbanceTuning:
    """How a bent field is told from the calibrated one, and how much it may bend the compass.

    Parameters
    ----------
    strength : float
        Share of its strength by which a good field varies from place to place (1 sigma).
    dip : float
        Radians by which its inclination does.
    noise_share : float
        Sigmas of the calibration's field noise that are added to both.
    ignored_from : float
        Sigmas of departure from which a field is no compass.
    believed_below : float
        Sigmas to which an ignored field must come back.
    memory : float
        Seconds over which strength and dip are averaged.
    amplitude : float
        Share of the field's strength per axis that places add to it, before any was seen: 0.5 µT,
        as on open land.
    smallest_amplitude : float
        The same at the least, however clean the field looks.
    amplitude_memory : float
        Seconds over which the amplitude is learnt: a few hundred metres of road.
    largest_step : float
        Amplitudes. A single departure counts for no more, or passing iron would be taken for the
        street.
    """

    strength: float = 0.02
    dip: float = math.radians(1.0)
    noise_share: float = 2.0
    ignored_from: float = 3.0
    believed_below: float = 2.0
    memory: float = 0.3
    amplitude: float = 0.01
    smallest_amplitude: float = 0.005
    amplitude_memory: float = 100.0
    largest_step: float = 3.0


@dataclass(frozen=True)
class FusionTuning:
    """The Kalman filter on yaw, gyro bias and the field's disturbance.

    Parameters
    ----------
    angle_walk : float
        Radians per root second that a gyro loses.
    turn_error : float
        Share of a turn that the gyro's scale gets wrong, per root radian.
    bias_sigma : float
        rad/s about up that the up filter left, at the least.
    bias_walk, walk_spread : float
        Median of how much a gyro's bias walks, rad/s per root second, and standard deviation of
        its natural logarithm: cheap gyros drift in a minute by a thousandth to a hundredth of a
        degree per second.
    loss_spread : float
        Standard deviation of the natural logarithm of the share of `angle_walk` and `turn_error`,
        squared, that a gyro has.
    tilt_tau : float
        Seconds over which errors by tilt are correlated: more samples do not tell more.
    noise_tau : float
        The same for the field's noise and for small iron on the way.
    small_iron : float
        Share of the disturbance's variance that changes within two metres.
    moving_tau : float
        Seconds over which the disturbance of a moving robot is correlated: streets are bent over
        25 to 30 m, which is 0.7 after a second and gone after 12 s.
    standing_tau : float
        The same of a robot that stands.
    learning_step : float
        Seconds after which the disturbance is looked at anew.
    gate : float
        Sigmas of disagreement from which a compass sample is weighed down.
    overruled_after : float
        Seconds of a good field that disagrees beyond all doubt, after which rather the propagated
        yaw is wrong.
    beyond_doubt : float
        Squared gates of disagreement that count fully; what disagrees less needs longer.
    heading_tau : float
        Seconds over which the error of a heading that somebody else measures is correlated.
    told_gate : float
        Sigmas by which such a heading may miss; beyond, it is not taken.
    unknown : float
        Radians of uncertainty of a start in a field that is not the expected one.
    start : float
        Seconds from the start in which that may come out.
    """

    angle_walk: float = 1e-3
    turn_error: float = 0.005
    bias_sigma: float = 0.001
    bias_walk: float = 1.8e-5
    walk_spread: float = 1.0
    loss_spread: float = 1.5
    tilt_tau: float = 3.0
    noise_tau: float = 0.5
    small_iron: float = 0.3
    moving_tau: float = 12.0
    standing_tau: float = 300.0
    learning_step: float = 0.1
    gate: float = 3.0
    overruled_after: float = 3.0
    beyond_doubt: float = 4.0
    heading_tau: float = 2.0
    told_gate: float = 4.0
    unknown: float = 0.5
    start: float = 5.0
    disturbance: DisturbanceTuning = field(default_factory=DisturbanceTuning)


@dataclass(frozen=True)
class SeveralTuning:
    """How several magnetometers are joined.

    Parameters
    ----------
    lost : float
        Seconds after which a magnetometer that is silent, or says the same again and again, takes
        no part. A gyro propagates over as long a gap.
    memory : float
        Seconds over which a magnetometer's yaw is averaged before it is held against the others':
        as long as a field is before it counts as disturbed.
    left_out_from, believed_below : float
        Sigmas of disagreement from which one is left out, and below which it is heard again.
    lasting : float
        Seconds over which a disagreement without a reason is remembered for the time when only
        one of them still speaks.
    offset_memory : float
        Seconds over which it is learnt how their fields differ in the axes of the body.
    """

    lost: float = STREAMS.longest_gyro_step
    memory: float = DisturbanceTuning.memory
    left_out_from: float = DisturbanceTuning.ignored_from
    believed_below: float = DisturbanceTuning.believed_below
    lasting: float = 3.0
    offset_memory: float = DisturbanceTuning.amplitude_memory
