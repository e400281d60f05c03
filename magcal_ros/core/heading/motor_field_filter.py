"""The present field of the motors.

The inputs have latency and no ripple: a current is reported some tenths of a second late, and
motion is detected after the motors have started. The field of the place cannot change as fast,
except by the turn that the gyro measures. A Kalman filter on the field of the place and on the
residual of the motors' field therefore separates the two.

The filter runs once per block of samples. Within a block the gyro propagates the prediction, and
each sample is compared with it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from magcal_ros.core.calibration.correction import MotorField, MotorState
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import IDENTITY, exp_rotation, skew
from magcal_ros.core.geometry.vec3 import Triple, interpolate, minus, plus, propagated, scaled
from magcal_ros.core.heading.heading_tuning import DISTURBANCE, MOTION, PLACE_FIELD
from magcal_ros.core.heading.motor_inputs import MICROTESLA, FieldByInputs, MotorInputs
from magcal_ros.core.samples.samples_tuning import STREAMS

ZERO: Triple = (0.0, 0.0, 0.0)
PLACE, RESIDUAL = slice(0, 3), slice(3, 6)
"""The states, vectors in µT and body axes: field of the place, and residual of the motors' field.
"""
SUM = np.hstack([IDENTITY, IDENTITY])  # of both, which a sample shows
FLAT = PLACE_FIELD.field**2 * IDENTITY  # prior of the field of the place, µT²


def _log_normal(median: float, steps: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return sizes on a grid of the natural logarithm, whose sigma is one, and their prior odds."""
    odds = np.exp(-0.5 * steps**2)
    return median * np.exp(steps), odds / odds.sum()


_SHARES, _SHARE_ODDS = _log_normal(MOTION.unseen, np.linspace(-1.5, 2, 6))
_STREETS, _STREET_ODDS = _log_normal(PLACE_FIELD.street, np.linspace(-1.2, 1.2, 3))
UNSEEN, STREET = (each.ravel() for each in np.meshgrid(_SHARES, _STREETS))
"""Tried pairs: relative residual of the motors' field, and size of the local disturbance, µT."""
ODDS = np.outer(_STREET_ODDS, _SHARE_ODDS).ravel()
"""Their prior odds."""
_LATE = np.log([[1.0 - MOTION.late_share], [MOTION.late_share]])
"""Logarithms of the prior probabilities that motors run as the inputs show, and that they do not:
they started or stopped undetected."""


class MotorCovariance(NamedTuple):
    """Errors of a sample's field after the motors' field was subtracted, tesla².

    The subtracted field contains a part of the sample's noise, which cancels.
    """

    lasting: FloatArray  # covariance (3, 3) without the sample's noise
    noise: FloatArray  # covariance (3, 3) of the remaining noise of the sample


@dataclass
class _Block:
    """The samples since the filter ran, which are compared with the mean over the tried pairs.

    The first of two outcomes is for motors that run as the inputs show, the other for motors that
    do not. `late` is the probability of the other at the newest sample.
    """

    begin: float
    until: float
    """Stamps, seconds: of its first sample, and from which a sample begins the next block."""
    inputs: MotorInputs  # at the beginning, like the rate in rad/s
    rate: Triple
    place: Triple  # prediction for the newest sample, µT
    residual: Triple
    odds: float  # logarithm of the odds of the other outcome, for a sample as predicted
    inverse: FloatArray  # of the covariance of a sample's innovation, 1/µT², (2, 3, 3)
    gain: FloatArray  # what an innovation adds to the predicted field of the place, (2, 3, 3)
    errors: FloatArray  # the two covariances of `MotorCovariance`, tesla², (2, 2, 3, 3)
    off: Triple = ZERO  # sum of the innovations, µT
    count: int = 0
    late: float = 0.0
    turned: Triple = ZERO  # radians
    path: float = 0.0  # metres

    def add(self, sample: Triple) -> tuple[Triple, MotorCovariance]:
        """Add a sample minus K u, µT; return the field of the place in tesla, and its errors.

        The field contains the sample's remaining noise.
        """
        off = minus(sample, plus(self.place, self.residual))
        self.off, self.count = plus(self.off, off), self.count + 1
        innovation = np.array(off)
        shown, not_shown = ((self.inverse @ innovation) @ innovation).tolist()
        ratio = math.exp(min(0.5 * (not_shown - shown) - self.odds, 300.0))
        late = self.late = 1.0 / (1.0 + ratio)
        one, other = self.gain @ innovation / MICROTESLA
        apart = other - one
        x, y, z = (one + late * apart).tolist()
        lasting, noise = self.errors[0] + late * (self.errors[1] - self.errors[0])
        lasting = lasting + late * (1.0 - late) * (apart[:, None] * apart)
        predicted = scaled(self.place, 1.0 / MICROTESLA)
        return plus(predicted, (x, y, z)), MotorCovariance(lasting, noise)


class MotorFieldFilter:
    """Estimates the field of the place and the residual of the motors' field.

    The size of the residual is unknown: there is a filter for each pair of `UNSEEN` and `STREET`,
    and `odds` are their posterior probabilities.

    `matrix` (3, 3) is from the magnetometer's axes to those of the body, and `noise` (3, 3) the
    covariance of a corrected sample, tesla². `iron` (3, 3) is the covariance of the corrected field
    by that of the calibration, tesla², which does not rotate like the field of the place.
    """

    def __init__(
        self, motors: MotorField, matrix: FloatArray, iron: FloatArray, noise: FloatArray
    ) -> None:
        self._matrix = matrix
        self._iron = iron * MICROTESLA**2
        self._of_sample = noise
        self._noise = noise * MICROTESLA**2 + 1e-4 * IDENTITY
        self._mean = np.zeros((len(UNSEEN), 6))
        self._covariance = np.zeros((len(UNSEEN), 6, 6))
        self.odds: FloatArray = ODDS
        self._block: _Block | None = None
        self._stamp, self._rate = -math.inf, ZERO
        self._late_since = math.nan
        self._change = np.zeros(0)
        self.use(motors)

    def use(self, motors: MotorField) -> None:
        """Use another estimate of the motors' field from now on."""
        self._field = FieldByInputs(motors, self._matrix)
        # Motors within the noise of a sample are not worth the computation.
        usual = self._field.usual(self._share())
        self._is_felt = bool(np.trace(usual) > np.trace(self._noise))
        if len(self._change) != len(motors.inputs):
            self._change = np.zeros(len(motors.inputs))
        if self._block is not None:
            self._block.inputs = self._field.at(self._block.inputs.motor_state)

    def add(
        self, stamp: float, field: Triple, rate: Triple | None, motor_state: MotorState
    ) -> tuple[Triple, MotorCovariance]:
        """Add a corrected sample; return it minus K u and the residual, and its errors.

        `field` is in tesla, body axes, `rate` in rad/s without the gyro's bias, None without a
        gyro.
        """
        if not self._is_felt or rate is None:
            return self._by_inputs(field, motor_state)
        block = self._block_at(stamp, rate, motor_state)
        return block.add(self._field.subtracted(scaled(field, MICROTESLA), motor_state))

    def _by_inputs(self, field: Triple, motor_state: MotorState) -> tuple[Triple, MotorCovariance]:
        """Return a sample minus K u alone, for a residual that samples cannot show."""
        inputs = self._field.at(motor_state)
        spread = inputs.level + self._share() * inputs.square + inputs.unknown
        if not spread.any():
            return field, MotorCovariance(spread, self._of_sample)
        known = self._field.subtracted(scaled(field, MICROTESLA), motor_state)
        errors = MotorCovariance(spread / MICROTESLA**2, self._of_sample)
        return scaled(known, 1.0 / MICROTESLA), errors

    def _block_at(self, stamp: float, rate: Triple, motor_state: MotorState) -> _Block:
        """Return the block of a sample; the filter runs where one ends."""
        seconds, self._stamp = stamp - self._stamp, stamp
        mean_rate, self._rate = interpolate(self._rate, rate, 0.5), rate
        block = self._block
        if block is None or not 0.0 < seconds < STREAMS.longest_field_gap:
            inputs = self._field.at(motor_state)
            self._change = np.zeros(len(inputs.values))
            by_residual = np.multiply.outer(UNSEEN**2, inputs.square)
            self._forget(PLACE, FLAT)
            self._forget(RESIDUAL, inputs.level + by_residual)
            # A flat prior is of use to one sample.
            block = self._begin(inputs, rate, 0.0)
        else:
            # A robot at rest has a gyro's noise and no turn, unless its motors run undetected.
            moves = 1.0 if motor_state.moving > 0.0 else block.late
            turn = scaled(mean_rate, moves * seconds)
            block.turned = plus(block.turned, turn)
            block.path += moves * seconds * PLACE_FIELD.path(motor_state.speed, rate)
            block.place = propagated(block.place, turn)
            if stamp >= block.until or block.inputs.differ(motor_state):
                self._update(block)
                inputs = self._field.at(motor_state)
                self._predict(block, inputs, rate)
                block = self._begin(inputs, rate, PLACE_FIELD.block)
        self._block = block
        return block

    def _begin(self, inputs: MotorInputs, rate: Triple, seconds: float) -> _Block:
        """Begin a block, whose samples are compared with the mean over the tried pairs."""
        mean, noise = self.odds @ self._mean, self._noise
        off = self._mean - mean
        joint = np.tensordot(self.odds, self._covariance, 1) + (self.odds * off.T) @ off
        shared = joint @ SUM.T
        spread = SUM @ shared + inputs.unknown + noise
        spreads = np.array([spread, spread + inputs.otherwise])
        inverse = np.linalg.inv(spreads)
        shared = shared[PLACE] + noise
        gain = shared @ inverse
        # The motors' field contains a part of the sample's noise, which cancels in the difference.
        cancelled = IDENTITY - gain
        lasting = (joint[PLACE, PLACE] + noise) - gain @ shared.T
        lasting = lasting - cancelled @ noise @ cancelled.swapaxes(1, 2)
        errors = np.empty((2, 2, 3, 3))
        errors[:, 0], errors[:, 1] = lasting, gain @ noise @ gain.swapaxes(1, 2)
        one, other = (_LATE[:, 0] - 0.5 * np.linalg.slogdet(spreads)[1]).tolist()
        x, y, z, p, q, r = mean.tolist()
        return _Block(
            self._stamp,
            self._stamp + seconds,
            inputs,
            rate,
            (x, y, z),
            (p, q, r),
            other - one,
            inverse,
            gain,
            errors / MICROTESLA**2,
        )

    def _share(self) -> float:
        """Return the mean square of the relative residual."""
        return float(self.odds @ UNSEEN**2)

    def _update(self, block: _Block) -> None:
        """Update by the mean of a block.

        The mixture of the updates for both kinds of motors (`_LATE`) has mean and covariance of
        one.
        """
        inverse, weighted, likelihood = self._innovation(block)
        odds = np.logaddexp(likelihood[0], likelihood[1])
        late = np.exp(likelihood[1] - odds)
        if self._lasts(block, late):
            # A lasting change is no start or stop: it is another motor, or at rest the place.
            is_place = block.inputs.motor_state.moving == 0.0 and not block.inputs.holds
            which, unknown = (PLACE, FLAT) if is_place else (RESIDUAL, block.inputs.otherwise)
            x, y, z = (block.count * self.odds @ self._mean[:, which]).tolist()
            block.off = plus(block.off, (x, y, z))
            self._forget(which, unknown)
            inverse, weighted, _ = self._innovation(block)
            late = np.zeros(len(UNSEEN))
        elif block.inputs.is_moving:
            odds = self.odds * np.exp(odds - odds.max())
            self.odds = odds / odds.sum()
        part, apart = late[:, None, None], (weighted[1] - weighted[0])[:, :, None]
        shared = self._covariance @ SUM.T
        step = shared @ (weighted[0][:, :, None] + part * apart)
        known = inverse[0] + part * (inverse[1] - inverse[0])
        known = known - (part * (1.0 - part) * apart) * apart.swapaxes(1, 2)
        covariance = self._covariance - shared @ known @ shared.swapaxes(1, 2)
        self._mean = self._mean + step[:, :, 0]
        self._covariance = 0.5 * (covariance + covariance.swapaxes(1, 2))

    def _innovation(self, block: _Block) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Compare a block's mean with its prediction, for both kinds of motors (`_LATE`).

        Returns the inverse of the innovation's covariance (2, g, 3, 3), the same times the
        innovation (2, g, 3), and the logarithm of prior and likelihood (2, g).
        """
        mean, off = self._mean @ SUM.T, np.array(block.off) / block.count
        off = off + self.odds @ mean - mean
        spread = SUM @ self._covariance @ SUM.T + block.inputs.unknown + self._noise / block.count
        spreads = np.array([spread, spread + block.inputs.otherwise])
        inverse = np.linalg.inv(spreads)
        weighted = (inverse @ off[:, :, None])[..., 0]
        square = np.einsum("gi,kgi->kg", off, weighted)
        return inverse, weighted, _LATE - 0.5 * (np.linalg.slogdet(spreads)[1] + square)

    def _lasts(self, block: _Block, late: FloatArray) -> bool:
        """Whether motors run undetected for too long, so that the change is another one."""
        if self.odds @ late < 0.5:
            self._late_since = math.nan
            return False
        if math.isnan(self._late_since):
            self._late_since = block.begin
        if self._stamp - self._late_since <= MOTION.longest:
            return False
        self._late_since = math.nan
        return True

    def _predict(self, block: _Block, now: MotorInputs, rate: Triple) -> None:
        """Predict the states after a block, for the inputs and the rate at its end."""
        seconds, changed = self._stamp - block.begin, now.values - block.inputs.values
        share = min(seconds / MOTION.latency, 1.0)
        self._change = self._change + share * (changed / seconds - self._change)
        lasts = math.inf if now.holds else MOTION.body_length
        keeps = math.exp(-seconds / lasts) if now.goes_on(block.inputs) else 0.0
        # Within the latency, the residual changes by as much as the inputs.
        late = 0.5 * MOTION.body_length / MOTION.latency * (self._field.latency * self._change) ** 2
        level, fresh = now.level + (self._field.gains.T * late) @ self._field.gains, 1.0 - keeps**2
        turned = np.array(block.turned)
        step = np.zeros((6, 6))
        step[PLACE, PLACE], step[RESIDUAL, RESIDUAL] = exp_rotation(-turned), keeps * IDENTITY
        self._mean = self._mean @ step.T
        covariance = step @ self._covariance @ step.T
        place = self.odds @ self._mean[:, PLACE]
        faster = np.array(minus(rate, block.rate))
        across = skew(turned)
        iron = across @ self._iron @ across.T / max(math.hypot(*block.turned), 1e-12)
        covariance[:, PLACE, PLACE] += (
            iron
            + PLACE_FIELD.change(place, turned, faster, block.path, seconds)
            + PLACE_FIELD.path_variance(block.path) * np.multiply.outer(STREET**2, IDENTITY)
        )
        covariance[:, RESIDUAL, RESIDUAL] += (
            fresh * level
            + keeps**2 * self._field.by_gains(changed)
            + fresh * np.multiply.outer(UNSEEN**2, now.square)
        )
        self._covariance = covariance
        if now.is_moving:
            share = seconds / DISTURBANCE.amplitude_memory
            self.odds = self.odds + share * (ODDS - self.odds)

    def _forget(self, which: slice, prior: FloatArray) -> None:
        """Reset the field of the place, or the residual, to a prior covariance."""
        self._mean[:, which] = 0.0
        self._covariance[:, which] = self._covariance[:, :, which] = 0.0
        self._covariance[:, which, which] = prior
