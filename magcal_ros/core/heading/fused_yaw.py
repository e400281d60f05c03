"""A smooth yaw: the gyro propagates it, and the compass corrects it.

North is kept as a level direction in body axes and propagated by the gyro. The level part of the
field corrects it about up alone, so that a disturbed field never tilts the attitude (the projection
of DIY IMU, part 3). A Kalman filter estimates yaw, gyro bias and local disturbance, which is
correlated over tens of metres: the samples of a second count as one.
"""

from __future__ import annotations

import cmath
import math
from collections import deque
from typing import NamedTuple

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import wrapped
from magcal_ros.core.geometry.vec3 import (
    Triple,
    cross,
    dot,
    interpolate,
    length,
    minus,
    propagated,
    scaled,
)
from magcal_ros.core.heading.base_heading import BaseHeading
from magcal_ros.core.heading.compass import CompassReading, Heading, levelled, yaw_between
from magcal_ros.core.heading.disturbance import FieldDeviation, FieldJump, FieldUse, LevelField
from magcal_ros.core.heading.heading_tuning import FUSION, PLACE_FIELD
from magcal_ros.core.heading.yaw_filter import (
    BY_COMPASS,
    BY_REST,
    BY_YAW,
    GyroDrift,
    YawFilter,
    errors_of,
)
from magcal_ros.core.knowledge import CLEAR, UNKNOWN_YAW, level_rotation
from magcal_ros.core.samples.samples_tuning import STREAMS
from magcal_ros.core.samples.streams import enclosing
from magcal_ros.core.up.filter import GYRO
from magcal_ros.core.up.follower import Up, UpFollower
from magcal_ros.core.up.propagation import GyroBias


class _YawRecord(NamedTuple):
    """North as propagated to a stamp, and the sum of the yaw's corrections until then."""

    stamp: float
    north: Triple
    shift: float


class FusedYaw:
    """The gyro-aided yaw of one calibration; a field that deviates for `patience` s is accepted."""

    def __init__(self, calibration: Calibration, patience: float) -> None:
        self._path: deque[_YawRecord] = deque(maxlen=STREAMS.remembered)
        self._filter, self._gyro_drift = YawFilter(), GyroDrift()
        self._measure_by(calibration, patience)
        self.restart()

    def use(self, calibration: Calibration, patience: float) -> None:
        """Continue with another calibration, while another device gives the yaw."""
        learnt = self.detector.amplitude_variance
        self._measure_by(calibration, patience)
        # The local disturbance does not depend on the calibration.
        self.detector.amplitude_variance = learnt
        self._filter.use_another_calibration()

    def _measure_by(self, calibration: Calibration, patience: float) -> None:
        self.detector = FieldDeviation(calibration, patience)
        # The yaw of an x axis that points upwards is not defined; that of level axes is.
        self._level = BaseHeading(level_rotation(calibration.upward))
        self._gyro_scale = calibration.evidence.figure(Figure.GYRO_SCALE, 0.0)

    def restart(self) -> None:
        """Forget north until the next compass sample."""
        self._north: Triple | None = None
        self._up = Up((0.0, 0.0, 1.0), 0.0)
        self._stamp = -math.inf
        self._rate: Triple = (0.0, 0.0, 0.0)
        self._shift = self._drift = self._seconds_unlearned = self._contradicted_seconds = 0.0
        self._known = GyroBias((0.0, 0.0, 0.0), math.inf)
        self._filter.begin(0.0, FUSION.bias_sigma**2, 0.0)
        self._is_at_rest = self._rate_is_old = False
        self._corrected = self._start_stamp = self._heading_stamp = -math.inf
        self.last_heading_gap = 0.0  # last heading of another device minus the yaw, radians
        self.field_jump: FieldJump | None = None
        """Two hypotheses of the last field that overruled the yaw; None if none did."""
        self._jump_shift = 0.0
        self._heading_variance = 0.0  # of the yaw by errors of the headings, rad²
        self._gyro_drift.begin_means()
        self._path.clear()

    def propagate_by(self, stamp: float, follower: UpFollower) -> None:
        """Propagate to an IMU message that `follower` has received; without a gyro, start anew."""
        up = follower.at(stamp, 0.0)
        if up is None or not follower.is_propagated:
            self.restart()
            return
        self._rate_is_old = follower.rate_is_old
        self.propagate(stamp, up, follower.mean_rate, follower.gyro_bias, follower.is_at_rest)

    def propagate(
        self, stamp: float, up: Up, rate: Triple, known: GyroBias, is_at_rest: bool = False
    ) -> None:
        """Propagate to the next IMU message.

        `up` belongs to the message. `rate` is the mean since the previous message without the bias
        `known`, rad/s. At rest the field of the place is constant.
        """
        seconds = stamp - self._stamp
        if not 0.0 < seconds <= STREAMS.longest_gyro_step:
            self.restart()
        self._stamp, self._up, self._rate, self._is_at_rest = stamp, up, rate, is_at_rest
        if known is not self._known:
            self._take_bias(known)
        if self._north is None:
            self._propagate_without_north(seconds)
            return
        if self._heading_variance and not self.has_external_yaw:
            self._end_headings()
        bias = self._filter.bias + self._gyro_scale * dot(rate, up.direction)
        turn = scaled(minus(rate, scaled(up.direction, bias)), seconds)
        north = propagated(self._north, turn)
        level = levelled(north, up.direction)
        if level is None:
            self.restart()
            return
        self._north = level
        self._path.append(_YawRecord(stamp, level, self._shift))
        walk = GYRO.walk_variance(length(rate) * seconds, seconds)
        drift = self._gyro_drift
        self._filter.propagate(seconds, drift.share * walk, drift.walked * seconds)
        self._drift += (bias + dot(self._known.rate, up.direction)) * seconds
        drift.walk_variance += walk

    def _propagate_without_north(self, seconds: float) -> None:
        """Propagate any level direction until a sample, which may be old, shows where north is."""
        up, turn = self._up.direction, scaled(self._rate, seconds)
        level = levelled(propagated(self._path[-1].north, turn), up) if self._path else None
        if level is None:
            self._path.clear()
            level = levelled((1.0, 0.0, 0.0), up) or levelled((0.0, 1.0, 0.0), up)
        assert level is not None
        self._path.append(_YawRecord(self._stamp, level, self._shift))

    def _take_bias(self, known: GyroBias) -> None:
        """Keep the estimate of the whole bias when the subtracted part changes."""
        variance, following = known.variance + FUSION.bias_sigma**2, self._filter
        change = minus(known.rate, self._known.rate)
        self._known = known
        following.bias -= dot(change, self._up.direction)
        if self._north is None:
            return
        own = following.bias_variance
        if variance < own:
            # With this noise the posterior variance of the bias is the known one.
            noise = variance * own / (own - variance)
            self._turn(following.observe(BY_REST, 0.0, noise))
            self._gyro_drift.begin(dot(known.rate, self._up.direction), variance)
        at_rest = known.at_rest and (dot(known.at_rest[0], self._up.direction), known.at_rest[1])
        mean = self._gyro_drift.add_rest(self._stamp, at_rest)
        if mean is not None:
            left, noise = mean[0] - dot(known.rate, self._up.direction), mean[1]
            self._turn(following.observe(BY_REST, left, noise + self._gyro_drift.rest_turn))

    def correct(self, reading: CompassReading) -> None:
        """Correct the yaw by a reading of the compass; without a heading it is left out."""
        stamp, field, up, heading, *_ = reading
        if up is None or heading is None:
            return
        heading = self._level.heading(heading)
        measured = levelled(field, up.direction)
        if measured is None or abs(stamp - self._stamp) > STREAMS.longest_gyro_step:
            return
        self.detector.add(stamp, field, up.direction, up.variance, heading.yaw)
        if self._north is None:
            self._begin(stamp, measured, up.direction, heading)
            return
        then = self._at(stamp)
        if then is None or stamp <= self._corrected:
            return
        since = min(stamp - self._corrected, STREAMS.longest_gyro_step)
        self._corrected = stamp
        yaw_gap = yaw_between(then.north, measured, up.direction)
        compass = errors_of(heading.lasting)
        error = float(self._filter.errors @ compass)
        innovation = wrapped(yaw_gap - (self._shift - then.shift) - error)
        self._seconds_unlearned += since
        if self._seconds_unlearned >= PLACE_FIELD.block:
            self._change_disturbance(self._seconds_unlearned, innovation, heading)
            self._seconds_unlearned = 0.0
        if self.has_external_yaw:
            # A compass that is calibrated by headings adds no information to them.
            self.field_jump = None
            return
        seen = stamp, dot(field, measured), heading.yaw, yaw_gap + then.shift
        if self.field_jump is not None:
            self.field_jump.add(self._level_field(*seen), since / FUSION.moving_tau)
        is_ignored = self.detector.use is FieldUse.IGNORED
        # A gyro that repeats its rate for long may be frozen: then the compass shows the turn.
        if self.detector.is_accepted or (self._rate_is_old and not is_ignored):
            self._filter.add_variance(innovation**2)
        elif is_ignored:
            self._contradicted_seconds = 0.0
            if stamp - self._start_stamp < FUSION.start:
                # A field that is disturbed soon after the start was so at the start.
                self._filter.add_variance(max(0.0, UNKNOWN_YAW - self._filter.yaw_variance))
            return
        if self._correct(innovation, heading, compass, min(since, FUSION.noise_tau)):
            self._jump_shift = then.shift
            before = self.field_jump
            variance = self._filter.known_spread(heading.variance_by_tilt + heading.noise_variance)
            odds = 0.0 if before is None else before.after(innovation, variance)
            self.field_jump = FieldJump(stamp, innovation, self._level_field(*seen), odds)

    def take_heading(
        self, stamp: float, yaw: float, variance: float, forward: Triple
    ) -> float | None:
        """Correct the yaw by the heading of another device, such as two antennas.

        `yaw` is the heading of `forward`, a direction in body axes, ENU to magnetic north, radians,
        with its `variance`, rad². Returns its normalised innovation; beyond the gate it is not
        used. None while north is not known at the stamp.
        """
        north = self.north_at(stamp)
        if north is None or stamp <= self._heading_stamp:
            return None
        since = min(stamp - self._heading_stamp, FUSION.heading_tau)
        self._heading_stamp = stamp
        east = cross(north, self._up.direction)
        own = math.atan2(dot(north, forward), dot(east, forward))
        innovation = self.last_heading_gap = wrapped(yaw - own)
        own = self._filter.own_error_variance
        missed = abs(innovation) / math.sqrt(self._filter.yaw_variance + own + variance)
        if missed > FUSION.heading_gate:
            return missed
        noise = variance * max(1.0, 2.0 * self._gyro_drift.heading_error_time / since)
        gap = innovation + self._shift - self._drift
        if self._gyro_drift.add_heading(stamp, gap, variance, since):
            mean, covariance = self._gyro_drift.yaw_gap()
            off = float(mean[0]) - self._shift + self._drift
            self._heading_variance = float(covariance[0, 0]) + off**2
        self._turn(self._filter.observe(BY_YAW, innovation, noise))
        return missed

    def _end_headings(self) -> None:
        """Continue without headings, with the variance by a possible drift of the headings."""
        self._gyro_drift.propagate(self._stamp)
        self._heading_variance = 0.0
        mean, covariance = self._gyro_drift.yaw_gap()
        if covariance[0, 0] > self._filter.yaw_variance:
            bias = self._filter.bias + dot(self._known.rate, self._up.direction)
            off = mean - (self._shift - self._drift, -bias)
            self._filter.use_larger_covariance(covariance + np.outer(off, off))

    @property
    def has_external_yaw(self) -> bool:
        """Whether a source other than the compass gave the yaw lately."""
        return self._north is not None and self._stamp - self._heading_stamp < FUSION.heading_tau

    def heading(self) -> Heading | None:
        """Return the attitude at the newest IMU message; None while north is not known."""
        north, up = self._north, self._up.direction
        if north is None:
            return None
        east = cross(north, up)
        yaw = math.atan2(north[0], east[0])
        roll, pitch = math.atan2(up[1], up[2]), math.atan2(-up[0], math.hypot(up[1], up[2]))
        variance = max(self.yaw_variance, self._heading_variance) + self._filter.own_error_variance
        return Heading(roll, pitch, yaw, self._up.variance, variance, 0.0, 0.0)

    def north_at(self, stamp: float) -> Triple | None:
        """Return level north at a stamp, body axes; None while it is not known there."""
        if self._north is None or abs(stamp - self._stamp) > STREAMS.longest_gyro_step:
            return None
        then = self._at(stamp)
        if then is None:
            return None
        # Corrections since then apply to the earlier record as well.
        return propagated(then.north, scaled(self._up.direction, self._shift - then.shift))

    @property
    def yaw_variance(self) -> float:
        """Variance of the propagated yaw without the calibration's part, rad²."""
        return self._filter.yaw_variance + (self.field_jump.variance if self.field_jump else 0.0)

    @property
    def is_ambiguous(self) -> bool:
        """Whether most of the yaw's variance is due to the ambiguity of a jump."""
        return self.yaw_variance > 2.0 * self._filter.yaw_variance

    @property
    def _disturbance_variance(self) -> float:
        """Variance of the compass's yaw by local disturbances, rad²."""
        return self.detector.amplitude_variance / self.detector.level_share**2

    def _begin(self, stamp: float, measured: Triple, up: Triple, heading: Heading) -> None:
        then = self._at(stamp)
        if then is None:
            return
        turn = scaled(self._up.direction, yaw_between(then.north, measured, up))
        self._north = propagated(self._path[-1].north, turn)
        self._path.clear()
        variance = heading.yaw_variance - heading.lasting_variance
        bias = self._known.variance + FUSION.bias_sigma**2
        bent = self._disturbance_variance
        self._filter.begin(variance, min(bias, 1.0), bent, errors_of(heading.lasting))
        self._gyro_drift.begin(dot(self._known.rate, self._up.direction), min(bias, 1.0))
        self._start_stamp = self._stamp
        self._path.append(_YawRecord(self._stamp, self._north, self._shift))

    def _change_disturbance(self, seconds: float, innovation: float, heading: Heading) -> None:
        """Let the disturbance change with the place, and learn its size."""
        known = self._filter.yaw_variance + heading.variance_by_tilt
        across = max(0.0, innovation**2 - known) * self.detector.level_share**2
        self._filter.widen(self.detector.learn(seconds, self._up.variance, across))
        tau = FUSION.standing_tau if self._is_at_rest else FUSION.moving_tau
        self._filter.change_disturbance(max(0.0, 1.0 - seconds / tau), self._disturbance_variance)

    def _level_field(self, stamp: float, level: float, yaw: float, gap: float) -> LevelField:
        """Return the level field by the yaw before the jump.

        `level` is the size of the measured one, tesla, `yaw` that of the compass, and `gap` its
        difference from the yaw before all corrections, radians.
        """
        strength, gap = self.detector.strength, gap - self._jump_shift
        expected = strength * self.detector.level_share
        seconds = 0.0 if self.field_jump is None else stamp - self.field_jump.stamp
        drifted = self._filter.bias_variance * seconds**2
        variance = strength**2 * self.detector.usual_variance + expected**2 * drifted
        return LevelField(cmath.rect(level, gap), yaw - gap, expected, variance)

    def _correct(
        self, innovation: float, heading: Heading, compass: FloatArray, seconds: float
    ) -> bool:
        """Correct yaw and bias by the innovation; return whether the field overrules the yaw."""
        following, by_tilt = self._filter, heading.variance_by_tilt
        bent = self._disturbance_variance
        by_noise = heading.noise_variance + FUSION.small_iron * bent
        contradiction = (innovation / CLEAR) ** 2 / following.spread(by_tilt + by_noise, compass)
        is_good = self.detector.use is FieldUse.GOOD
        clear = (contradiction - 1.0) / (contradiction + 1.0)
        more = max(0.0, self._contradicted_seconds + clear * seconds)
        self._contradicted_seconds = more if is_good else 0.0
        is_overruled = self._contradicted_seconds > FUSION.tilt_tau
        if is_overruled:
            following.add_variance(innovation**2)
            self._contradicted_seconds = contradiction = 0.0
        disturbed, larger = self.detector.yaw_variance, max(1.0, contradiction)
        noise = by_tilt * FUSION.tilt_tau + by_noise * FUSION.noise_tau
        noise = larger * (noise + disturbed * FUSION.moving_tau) / seconds
        momentary = larger * (by_tilt + heading.noise_variance + disturbed + bent)
        spread = following.known_spread(noise)
        share = min(1.0, seconds / FUSION.noise_tau)
        if momentary < following.yaw_variance and share * spread > following.yaw_variance:
            # Errors by tilt are common to both: if the present compass is better, a mean is not.
            following.follow(share, momentary, compass)
            turned = share * innovation
        else:
            turned = following.observe(BY_COMPASS, innovation, noise, compass)
        self._turn(turned)
        return is_overruled

    def _turn(self, angle: float) -> None:
        assert self._north is not None
        self._north = propagated(self._north, scaled(self._up.direction, angle))
        self._shift += angle

    def _at(self, stamp: float) -> _YawRecord | None:
        """Return north at a stamp; after the newest message the turn rate is constant."""
        found = enclosing(self._path, stamp)
        if found is None:
            return None
        record, after = found
        since = stamp - record.stamp
        if after is None:
            north = propagated(record.north, scaled(self._rate, since))
        else:
            north = interpolate(record.north, after.north, since / (after.stamp - record.stamp))
        return record._replace(north=north)
