"""A yaw that is smooth and never trapped: the gyro carries it, the compass corrects it.

North is kept as a level direction in body axes and carried by the gyro; the level part of the
field corrects it about up alone, so a bent field never tips the attitude (the projection of
DIY IMU, part 3). A small Kalman filter on yaw and gyro bias weighs the two.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from magcal_ros.core.attitude import wrapped
from magcal_ros.core.calibration import Calibration
from magcal_ros.core.field_watch import Expected, FieldWatch, Trust
from magcal_ros.core.heading import SMALLEST_LEVEL_SHARE, Heading
from magcal_ros.core.streams import LONGEST_CARRY
from magcal_ros.core.triples import Triple, between, carried, cross, dot, length
from magcal_ros.core.up import Up

ANGLE_WALK = 1e-3
"""Radians per root second that a gyro loses."""
TURN_ERROR = 0.005
"""Share of a turn that the gyro's scale gets wrong, per root radian."""
BIAS_SIGMA, BIAS_WALK = 0.004, 5e-5
"""rad/s about up that the tilt filter left, and rad/s per root second."""
TILT_ALIKE = 3.0
"""Seconds over which errors by tilt are alike: more samples do not tell more."""
NOISE_ALIKE = 0.5
"""The same for the field's noise, of which small iron on the way is a part."""
GATE = 3.0
"""Sigmas of disagreement from which a compass sample is weighed down."""
OVERRULED_AFTER = 3.0
"""Seconds of a good field that disagrees, after which rather the carried yaw is wrong."""
UNKNOWN = 0.5
"""Radians of uncertainty of a start in a field that is not the expected one."""
START = 5.0
"""Seconds from the start in which that may come out."""
HISTORY = 512
"""IMU messages within which the moment of a field message is looked for."""


class _Moment(NamedTuple):
    """North as it was carried to a stamp, and how far the compass had turned the yaw by then."""

    stamp: float
    north: Triple
    shift: float


class FusedYaw:
    """The gyro-aided yaw of one calibration.

    Parameters
    ----------
    calibration : Calibration
        What is in force; tells the field to expect.
    patience : float
        Seconds after which a departed field is taken for the expected one.
    """

    def __init__(self, calibration: Calibration, patience: float) -> None:
        expected = Expected(calibration.strength, calibration.inclination)
        self.watch = FieldWatch(expected, calibration.noise_field, patience)
        self._path: deque[_Moment] = deque(maxlen=HISTORY)
        self.restart()

    def restart(self) -> None:
        """Forget where north is; the next compass sample tells."""
        self._north: Triple | None = None
        self._up = Up((0.0, 0.0, 1.0), 0.0)
        self._stamp = -math.inf
        self._rate: Triple = (0.0, 0.0, 0.0)
        self._bias = self._shift = 0.0
        self._yaw_variance, self._cross, self._bias_variance = 0.0, 0.0, BIAS_SIGMA**2
        self._lasting = 0.0
        self._corrected = self._begun = -math.inf
        self._overruled = 0.0
        self._path.clear()

    def carry(self, stamp: float, up: Up, rate: Triple) -> None:
        """Go on to the next IMU message.

        Parameters
        ----------
        stamp : float
            Seconds.
        up : Up
            Up after the message.
        rate : tuple of float
            Mean turn rate since the one before, less the bias that is known of it, rad/s.
        """
        seconds = stamp - self._stamp
        if not 0.0 < seconds <= LONGEST_CARRY and self._north is not None:
            self.restart()
        self._stamp, self._up, self._rate = stamp, up, rate
        if self._north is None:
            return
        x, y, z = up.direction
        b = self._bias
        p, q, r = rate
        north = carried(
            self._north,
            ((p - b * x) * seconds, (q - b * y) * seconds, (r - b * z) * seconds),
        )
        level = _levelled(north, up.direction)
        if level is None:
            self.restart()
            return
        self._north = level
        self._path.append(_Moment(stamp, level, self._shift))
        bias_part = self._bias_variance * seconds
        self._yaw_variance += (bias_part - 2.0 * self._cross) * seconds
        self._yaw_variance += (ANGLE_WALK**2 + TURN_ERROR**2 * length(rate)) * seconds
        self._cross -= bias_part
        self._bias_variance += BIAS_WALK**2 * seconds

    def correct(self, stamp: float, field: Triple, up: Up, heading: Heading) -> None:
        """Let the compass correct the yaw.

        Parameters
        ----------
        stamp : float
            Of the field, seconds.
        field : tuple of float
            Corrected field, tesla, body axes.
        up : Up
            Of the field's moment.
        heading : Heading
            What the compass makes of both.
        """
        seen = _levelled(field, up.direction)
        if seen is None or abs(stamp - self._stamp) > LONGEST_CARRY:
            return
        is_new = self.watch.add(stamp, field, up.direction, up.variance, heading.yaw)
        self._lasting = heading.lasting_variance
        if self._north is None:
            self._begin(seen, heading.yaw_variance)
            return
        then = self._at(stamp)
        if then is None or stamp <= self._corrected:
            return
        seconds = min(stamp - self._corrected, NOISE_ALIKE)
        self._corrected = stamp
        # North that lies further to the left is a yaw further to the right.
        angle = math.atan2(dot(cross(then.north, seen), up.direction), dot(then.north, seen))
        innovation = wrapped(-angle - (self._shift - then.shift))
        if is_new:
            self._yaw_variance += innovation**2
        elif self.watch.trust is Trust.IGNORED:
            self._overruled = 0.0
            if stamp - self._begun < START:
                # What turns out to be bent soon after the start was so at the start.
                self._yaw_variance = max(self._yaw_variance, UNKNOWN**2)
            return
        self._weigh(self._north, innovation, heading, seconds)

    def heading(self) -> Heading | None:
        """Return the attitude at the newest IMU message; None while north is not known."""
        north, up = self._north, self._up.direction
        if north is None:
            return None
        east = cross(north, up)
        yaw = math.atan2(north[0], east[0])
        roll, pitch = math.atan2(up[1], up[2]), math.atan2(-up[0], math.hypot(up[1], up[2]))
        variance = self._yaw_variance + self._lasting
        return Heading(roll, pitch, yaw, self._up.variance, variance, 0.0, 0.0)

    def _begin(self, seen: Triple, variance: float) -> None:
        level = _levelled(seen, self._up.direction)
        if level is None:
            return
        self._north = level
        self._yaw_variance, self._begun = variance, self._stamp
        self._path.append(_Moment(self._stamp, level, self._shift))

    def _weigh(self, north: Triple, innovation: float, heading: Heading, seconds: float) -> None:
        """Correct yaw and bias by what the compass says beyond the carried yaw."""
        spread = self._yaw_variance + heading.yaw_variance
        doubt = innovation**2 / (GATE**2 * spread)
        is_good = self.watch.trust is Trust.GOOD
        self._overruled = self._overruled + seconds if doubt > 1.0 and is_good else 0.0
        if self._overruled > OVERRULED_AFTER:
            self._yaw_variance += innovation**2
            self._overruled = doubt = 0.0
        doubt = max(1.0, doubt) * max(1.0, self.watch.departure**4)
        by_noise, lasting = heading.noise_variance, heading.lasting_variance
        by_tilt = max(0.0, heading.yaw_variance - by_noise - lasting)
        noise = lasting + (by_tilt * TILT_ALIKE + by_noise * NOISE_ALIKE) / seconds
        spread = self._yaw_variance + noise * doubt
        gain, bias_gain = self._yaw_variance / spread, self._cross / spread
        lost = heading.yaw_variance * doubt - self._yaw_variance
        share = min(1.0, seconds / NOISE_ALIKE)
        if lost < 0.0 and share > gain:
            # Errors by tilt are common to both: where the compass of the moment is the better
            # one, a mean of both is not.
            self._yaw_variance += share * lost
            gain, bias_gain = share, 0.0
        else:
            self._bias_variance -= bias_gain * self._cross
            self._yaw_variance *= 1.0 - gain
        self._turn(north, gain * innovation)
        self._bias += bias_gain * innovation
        self._cross *= 1.0 - gain

    def _turn(self, north: Triple, angle: float) -> None:
        x, y, z = self._up.direction
        self._north = carried(north, (angle * x, angle * y, angle * z))
        self._shift += angle

    def _at(self, stamp: float) -> _Moment | None:
        """Return north at a stamp; after the newest message the body is taken to turn on."""
        after = None
        for moment in reversed(self._path):
            since = stamp - moment.stamp
            if since >= 0.0:
                if after is None:
                    x, y, z = self._rate
                    north = carried(moment.north, (x * since, y * since, z * since))
                else:
                    share = since / (after.stamp - moment.stamp)
                    north = between(moment.north, after.north, share)
                return moment._replace(north=north)
            after = moment
        return None


def _levelled(vector: Triple, up: Triple) -> Triple | None:
    """Return the direction of a vector's level part; None where it has hardly one."""
    rise = dot(vector, up)
    level = (vector[0] - rise * up[0], vector[1] - rise * up[1], vector[2] - rise * up[2])
    size = length(level)
    if size <= SMALLEST_LEVEL_SHARE * length(vector):
        return None
    return (level[0] / size, level[1] / size, level[2] / size)
