"""Compare all hypotheses on the axes of gyro and magnetometer by how well they fit the samples.

The accelerometer's axes are assumed to be the body's. If these are wrong, gyro and magnetometer
differ from them in the same way. Rows of a hypothesis' two matrices are the sensor's axes in the
body's. For the field, rotating the gyro's axes is the same as rotating the magnetometer's back, and
a mirrored gyro turns the other way. So the gyro is fitted to the field in 24 orientations and two
senses, and to gravity with 48 matrices. Only pairs that pass both are fitted jointly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from magcal_ros.core.doctor.alignment import (
    BIAS,
    FIELD,
    IRON,
    LAG,
    NO_BIAS,
    PARAMETERS,
    SCALE,
    UP,
    Alignment,
    align,
)
from magcal_ros.core.doctor.doctor_tuning import AXES, WIDE
from magcal_ros.core.doctor.prepared import Segment, segment_of_log
from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, IntArray, accumulated
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, unit
from magcal_ros.core.geometry.rotations import signed_permutations, skews
from magcal_ros.core.knowledge import Belief
from magcal_ros.core.samples.window import SensorLog


class AxesHypothesis(NamedTuple):
    """One hypothesis on the axes of gyro and magnetometer, as in `AxesHypotheses`."""

    gyro: FloatArray
    field: FloatArray  # axes of both sensors in the accelerometer's, shape (3, 3)
    state: FloatArray
    sigma: FloatArray
    """The parameters of `Alignment`, but field and hard iron in tesla, and their standard
    deviations. Shape (23,)."""
    part: Segment  # the samples of the fit
    log: SensorLog  # all samples, in rad/s and body axes

    @property
    def is_as_given(self) -> bool:
        """Whether all axes are right."""
        return bool((self.gyro == np.eye(3)).all() and (self.field == np.eye(3)).all())


@dataclass(frozen=True, eq=False)
class AxesHypotheses:
    """The results of all k hypotheses that were compared."""

    gyro: FloatArray
    field: FloatArray
    """Axes of the two sensors in the accelerometer's. Shape (k, 3, 3)."""
    base: FloatArray
    """Chi-square, in independent samples, minus the best, without the inclination. Shape (k,)."""
    fit: Alignment  # with the total latency; its `misfit` is not used
    part: Segment  # the samples of the fit
    log: SensorLog  # all samples
    inclination: Belief  # distinguishes a field from its opposite

    @cached_property
    def cost(self) -> FloatArray:
        """Chi-square with the inclination, shape (k,)."""
        return np.asarray(self.base + self._inclination_misfit())

    @property
    def field_right(self) -> float:
        """The smallest chi-square with the magnetometer's axes as given."""
        return float(self.cost[_are_right(self.field)].min())

    @property
    def as_given(self) -> int:
        """The index of the hypothesis that all axes are right."""
        return int(np.argmax(_are_right(self.gyro) & _are_right(self.field)))

    @property
    def best(self) -> int:
        """The index of the hypothesis with the best fit."""
        return int(np.argmin(self.cost))

    def explains(self, worst: float) -> bool:
        """Whether the residual of the movement, with the gyro's unit, is less than `worst`.

        In less than a quarter turn, some axes fit a field that varies from place to place, whatever
        the gyro's unit: then only the axes as given count.
        """
        is_short = abs(self.turned[self.best]) < 0.5 * math.pi
        return bool(self.fit.rms[self.as_given if is_short else self.best] < worst)

    def hypothesis(self, k: int) -> AxesHypothesis:
        """Return hypothesis `k`."""
        scale = np.ones(PARAMETERS)
        scale[FIELD.start : IRON.stop] = self.part.size
        state = scale * self.fit.parameters[k]
        sigma = scale * np.sqrt(np.diag(self.fit.covariance[k]))
        return AxesHypothesis(self.gyro[k], self.field[k], state, sigma, self.part, self.log)

    def _inclination_misfit(self) -> FloatArray:
        """Return chi-square (k,) of the inclination by each hypothesis."""
        dip, fit = self.inclination, self.fit
        is_known = np.asarray(np.isfinite(fit.covariance).all(axis=(1, 2)))
        if dip.is_unknown:
            return np.zeros(len(is_known))
        up, field = unit(fit.parameters[:, UP]), fit.parameters[:, FIELD]
        size = np.linalg.norm(field, axis=1)
        along = np.sum(up * field, axis=1) / size
        level = np.sqrt(np.maximum(1.0 - along**2, 1e-6))
        slope = (up - (along / size)[:, None] * field) / (size * level)[:, None]
        covariance = np.where(is_known[:, None, None], fit.covariance[:, FIELD, FIELD], 0.0)
        variance = np.einsum("ki,kij,kj->k", slope, covariance, slope)
        # The gyro's drift looks like a small tilt, which does not determine the field.
        variance += (WIDE.field_floor / max(fit.least_tilt, 1e-6)) ** 2
        variance += WIDE.soft_iron**2 + dip.sigma**2
        measured = -np.arcsin(np.clip(along, -1.0, 1.0))
        return np.where(is_known, (measured - dip.value) ** 2 / variance, 0.0)

    @property
    def turned(self) -> FloatArray:
        """The angle turned about the accelerometer's up by each hypothesis, radians, (k,)."""
        up, state = unit(self.part.up[:-1]), self.fit.parameters
        angle = np.einsum("ni,kij,nj->k", self.part.turn, self.gyro, up)
        turned = (1.0 + state[:, SCALE]) * angle - state[:, BIAS] @ (self.part.seconds @ up)
        return np.asarray(turned)


def _are_right(axes: FloatArray) -> BoolArray:
    """Return which axes (k, 3, 3) are the body's."""
    return np.asarray((axes == np.eye(3)).all(axis=(1, 2)))


def compare_axes(
    log: SensorLog, inclination: Belief, bias: FloatArray = NO_BIAS
) -> AxesHypotheses | None:
    """Compare all hypotheses on the axes; None if the robot turns too little.

    `bias` (3,) is the gyro's bias from a rest, rad/s. It is subtracted first: otherwise a resting
    robot may seem to turn most.
    """
    unbiased = replace(log, rate=log.rate - bias)
    part, lag = segment_of_log(unbiased), 0.0
    if part is None:
        return None
    # About the angle between the most distant attitudes.
    turned = np.ptp(np.cumsum(part.turn + part.coning, axis=0), axis=0)
    if turned.max() < AXES.least_turn:
        return None
    senses = _fit_to_the_field(part)
    for _ in range(AXES.rounds):
        more = float(senses.parameters[senses.best, LAG])
        nearer = segment_of_log(unbiased, lag + more) if abs(more) > AXES.settled else None
        if nearer is None:
            break
        part, lag = nearer, lag + more
        senses = _fit_to_the_field(part)
    gyro, field, base = _hypotheses_to_fit(part, senses)
    found = align(part, field, gyro)
    # The opposite of each field fits equally well.
    twice = np.tile(np.arange(len(field)), 2)
    parameters = found.parameters[twice]
    parameters[:, LAG] += lag
    parameters[len(field) :, FIELD.start : IRON.stop] *= -1.0
    parameters[:, BIAS] += (1.0 + parameters[:, SCALE, None]) * (bias @ gyro[twice])
    part = replace(part, turn=part.turn + part.seconds[:, None] * bias, rate=part.rate + bias)
    rms, covariance = found.rms[twice], found.covariance[twice]
    fit = replace(found, rms=rms, parameters=parameters, covariance=covariance)
    axes = gyro[twice], np.concatenate([field, -field])
    return AxesHypotheses(*axes, base[twice] - base.min(), fit, part, log, inclination)


def _fit_to_the_field(segment: Segment) -> Alignment:
    """Fit the field to the gyro alone, in both senses and 24 orientations each."""
    proper = signed_permutations()[:24]
    senses = np.repeat(np.array([np.eye(3), -np.eye(3)]), len(proper), axis=0)
    return align(segment, np.concatenate([proper, proper]), senses, with_up=False)


def _hypotheses_to_fit(
    segment: Segment, senses: Alignment
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return axes (m, 3, 3) and chi-square (m,) of the hypotheses to fit, with all axes right."""
    every = signed_permutations()
    proper = every[:24]
    # A vehicle's accelerations tilt gravity for a long time: only changes are compared.
    misfit, rms = gravity_misfit(segment, every)
    gravity = _limited(misfit, rms, senses.least_tilt > 0.0)
    is_good = bool(senses.rms[senses.best] < AXES.good_fit)
    lifted = senses.tilt > AXES.lift and senses.least_tilt > 0.0 and is_good
    against_field = _limited(senses.misfit, senses.rms, lifted).reshape(2, -1)
    sense = np.rint(np.linalg.det(every))
    cost = (against_field[(sense < 0.0).astype(int)] + gravity[:, None]).ravel()
    field = np.einsum("kij,gjl->gkil", proper, sense[:, None, None] * every).reshape(-1, 3, 3)
    order = np.argsort(cost, kind="stable")
    gyro = order // len(proper)
    # A level turn leaves most axes of a gyro open: the axes as given are always included.
    likely = (np.arange(len(order)) < AXES.most) | (gyro == 0)
    right = (gyro == 0) & _are_right(field[order])
    kept = (likely & (cost[order] - cost.min() < 4.0 * AXES.remains)) | right
    return every[gyro[kept]], field[order[kept]], cost[order[kept]]


def _limited(misfit: FloatArray, rms: FloatArray, lifted: bool) -> FloatArray:
    """Return misfits (k,), limited if soft iron or linear acceleration may explain them."""
    # In a turn about one axis, unusually strong soft iron looks like other axes. Linear
    # acceleration does, too, if gravity does not show a lift that the gyro measures. Then only
    # clearly worse fits are excluded.
    plainly = rms > AXES.times * rms[np.argmin(misfit)]
    capped = np.minimum(misfit, AXES.doubtful)
    return np.asarray(np.where(plainly | lifted, misfit, capped))


def gravity_misfit(segment: Segment, axes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compare axes of the gyro by how well they explain the changes of gravity's direction.

    Return chi-square (k,) minus the best, and the typical residual, radians (k,).

    A rotation by a small angle d changes up by -d x up. At a lever arm r, it adds an acceleration
    that follows from r and the gyro. Other accelerations change the size of specific force, which
    no rotation does, and its direction by as much.
    Rows of each of the `axes` (k, 3, 3) are the gyro's axes in the accelerometer's.
    """
    seconds = accumulated(segment.seconds)
    first, last, turn = turns_in(segment, AXES.span)
    if len(first) < 4:
        return np.zeros(len(axes)), np.zeros(len(axes))
    size = np.linalg.norm(segment.up, axis=1, keepdims=True)
    uneven = float(np.median(np.abs(size[last] - size[first]))) / 0.6745
    up = segment.up / np.maximum(size, 1e-9)
    middle = skews(0.5 * (up[last] + up[first]))
    measured = up[last] - up[first]
    turned = turn @ axes
    # seen = middle x (turned (1 + scale) - bias seconds) + swung r
    count, n = len(axes), len(first)
    moved = np.einsum("nij,knj->kni", middle, turned)
    drift = -middle * (seconds[last] - seconds[first])[:, None, None]
    swung = per_metre(segment.rate @ axes, seconds) / STANDARD_GRAVITY
    swung = -middle @ middle @ (swung[:, last] - swung[:, first])
    drifted = np.broadcast_to(drift, (count, n, 3, 3))
    design = np.concatenate([drifted, moved[..., None], swung], axis=3)
    target = measured - moved
    sizes = np.array([WIDE.bias] * 3 + [WIDE.scale] + [AXES.lever] * 3)
    prior = np.diag(sizes**-2.0)
    repeated = max(float(np.mean(last - first)), 1.0)
    sigma, left = math.radians(5.0), np.zeros((count, n))
    for _ in range(AXES.rounds):
        weight = 7.0 / (4.0 + left / sigma**2) / sigma**2 / repeated
        rows = design * weight[..., None, None]
        normal = np.einsum("knia,knib->kab", rows, design) + prior
        found = np.linalg.solve(normal, np.einsum("knia,kni->ka", rows, target)[..., None])[..., 0]
        left = np.sum((target - np.einsum("knia,ka->kni", design, found)) ** 2, axis=2)
        typical = np.sqrt(np.median(left, axis=1) / 2.37)
        cost = 7.0 * np.log1p(left / 4.0 / sigma**2).sum(axis=1) / repeated
        sigma = max(float(typical[np.argmin(cost)]), uneven, WIDE.field_floor)
    cost = 7.0 * np.log1p(left / 4.0 / sigma**2).sum(axis=1) / repeated
    cost = cost + np.einsum("ka,ab,kb->k", found, prior, found)
    return np.asarray(cost - cost.min()), np.asarray(np.maximum(typical, WIDE.field_floor))


def per_metre(rate: FloatArray, time: FloatArray) -> FloatArray:
    """Return the accelerations (…, n, 3, 3) at a lever arm of one metre along each axis, m/s²."""
    turns = skews(rate)
    return np.asarray(skews(np.gradient(rate, time, axis=-2)) + turns @ turns)


def turns_in(segment: Segment, span: float) -> tuple[IntArray, IntArray, FloatArray]:
    """Return first and last row of each span of `span` seconds, and the gyro's turn (n, 3)."""
    seconds, angle = accumulated(segment.seconds), accumulated(segment.turn)
    last = np.searchsorted(seconds, seconds + span)
    first = np.flatnonzero(last < len(seconds))
    return first, last[first], angle[last[first]] - angle[first]


UNIT_ERRORS = {
    math.radians(1.0): "degrees/s published as rad/s",
    math.degrees(1.0): "rad/s converted from degrees twice",
    math.radians(1.0) / STANDARD_GRAVITY: "rates converted to degrees and multiplied by gravity",
    1.0 / STANDARD_GRAVITY: "rates multiplied by gravity, as accelerations are",
}
"""Factors to rad/s for known errors of the unit, and their causes."""


def likely_rate_factor(segment: Segment) -> float:
    """Return the factor that probably converts rates to rad/s: one, or that of a known error.

    In a short time, the field vector moves by its size times the angle. The size is that of the
    field's changing part, which is right within a factor of two from a quarter turn on.
    """
    first, last, turn = turns_in(segment, AXES.span)
    change = np.linalg.norm(segment.field[last] - segment.field[first], axis=1)
    turned = np.linalg.norm(turn, axis=1)
    if not turned.any():
        return 1.0
    ratio = math.log(max(float(change @ turned / (turned @ turned)), 1e-12))
    return min((1.0, *UNIT_ERRORS), key=lambda factor: abs(math.log(factor) - ratio))
