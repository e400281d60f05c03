"""Compare all possible axes of gyro and magnetometer by how well they fit the samples.

The accelerometer's axes are taken for the body's; where it errs itself, gyro and magnetometer
differ from it alike. Rows of a candidate's two matrices are the sensor's axes in the body's.
Turning the gyro's axes by G is, for the field, the same as turning the magnetometer's back; a
mirrored gyro turns against the field. So gyro against field is weighed once for 24 ways and two
senses, gyro against gravity once for 48, and together only what both leave.

The unit of the gyro's rates is compared with the turning of the field.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from magcal_ros.core.geometry.arrays import BoolArray, FloatArray, IntArray, accumulated
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, unit
from magcal_ros.core.geometry.rotations import signed_permutations, skews
from magcal_ros.core.knowledge import Belief
from magcal_ros.core.samples.alignment import (
    BIAS,
    FIELD,
    IRON,
    LAG,
    NO_BIAS,
    SCALE,
    UP,
    WIDE,
    Alignment,
    align,
)
from magcal_ros.core.samples.window import SensorLog, Stretch, stretch_of_log


@dataclass(frozen=True)
class ExplanationTuning:
    """What is believed of sensors that may be faulty, and when an explanation is dropped."""

    remains: float = 20.0
    """Chi-square, in independent samples, up to which an explanation remains. From twice as much
    the axes as given are called wrong, and beyond four times a way is not fitted."""
    likely: float = 9.0  # chi-square up to which candidates are ordered by what people do
    times: float = 2.0  # times the best's residual from which another fits plainly worse
    lift: float = math.radians(3.0)
    """Radians RMS of movement beside the turn from which less than that suffices."""
    worst_fit: float = 0.3
    """Residual over the changing field beyond which even the best explains nothing."""
    dip_sigma: float = math.radians(3.0)
    """Radians that a reference inclination is trusted to at best."""
    attitude_error: float = math.radians(0.5)  # radians that propagated attitudes are off at best
    most_named: int = 3  # explanations that are written out for one sensor
    most: int = 32  # ways that are fitted
    doubtful: float = 12.0
    """Largest chi-square of field or gravity where soft iron or acceleration may explain it."""
    good_fit: float = 0.06
    """Residual over the changing field up to which small differences of the fit are believed."""
    settled: float = 0.02  # seconds of latency that need no further look
    looks: int = 4  # at the latency
    least_turn: float = math.radians(40.0)  # radians between the first and some later attitude
    span: float = 0.6
    """Seconds over which turns are compared: shorter ones drown in noise, longer ones in bias."""
    lever: float = 1.0
    """Metres, standard deviation of how far the sensor is from the point about which it turns: a
    hand swings it around an elbow, a vehicle turns about its rear axle."""
    rounds: int = 3  # of robust weights
    plain: float = 5.0  # times too large or too small from which no scale error can be meant
    # Seconds over which field and gyro are compared: the shortest in which the field moves.
    spans: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0)
    moved: float = 0.15  # share of its size by which the field must move in that time to take part
    below: float = 8.0
    above: float = 2.2
    """Times a known factor may be below and above the rough one, which noise makes too large."""


WEIGHED = ExplanationTuning()


class Way(NamedTuple):
    """One way in which axes may lie, as in `Explanations`."""

    gyro: FloatArray
    field: FloatArray  # axes of both sensors in the accelerometer's, shape (3, 3)
    state: FloatArray
    sigma: FloatArray  # what was fitted, and its standard deviations, shape (23,)
    part: Stretch  # what was fitted

    @property
    def is_plain(self) -> bool:
        """Whether all axes are right."""
        return bool((self.gyro == np.eye(3)).all() and (self.field == np.eye(3)).all())


@dataclass(frozen=True, eq=False)
class Explanations:
    """The result for every way that was compared."""

    gyro: FloatArray
    field: FloatArray
    """Axes of the two sensors in the accelerometer's. Shape (k, 3, 3)."""
    base: FloatArray
    """Chi-square in independent samples, above the best's, without the inclination. Shape (k,)."""
    rms: FloatArray  # typical residual of the field over the size of its changing part. Shape (k,).
    parameters: FloatArray
    sigma: FloatArray
    """What was fitted, as in `AlignmentFit`, with the whole latency, and its sigmas, (k, 23)."""
    part: Stretch  # what was fitted
    found: Alignment  # the fit, which does not separate the field from its opposite
    inclination: Belief  # which alone does

    @cached_property
    def cost(self) -> FloatArray:
        """Chi-square with the inclination, shape (k,)."""
        return np.asarray(self.base + _inclination_misfit(self.found, self.inclination))

    @property
    def misfit(self) -> FloatArray:
        """Chi-square above the best's, shape (k,)."""
        return np.asarray(self.cost - self.cost.min())

    @property
    def field_right(self) -> float:
        """The least cost with which the magnetometer's axes are right."""
        return float(self.cost[_are_right(self.field)].min())

    @property
    def plain(self) -> int:
        """The way in which all axes are right."""
        return int(np.argmax(_are_right(self.gyro) & _are_right(self.field)))

    @property
    def best(self) -> int:
        """Which way fits best."""
        return int(np.argmin(self.cost))

    @property
    def fits_well(self) -> bool:
        """Whether the best way leaves so little that small differences of the fit are believed."""
        return bool(self.rms[self.best] < WEIGHED.good_fit)

    @property
    def shows_the_unit(self) -> bool:
        """Whether the gyro's unit is right: the best way fits well, and not by chance.

        In less than a quarter turn some axes of both sensors fit a field that changes from place to
        place, whatever the gyro's unit.
        """
        axes_fit = bool(self.rms[self.plain] < WEIGHED.good_fit)
        return self.fits_well and (axes_fit or abs(self.turned(self.best)) > 0.5 * math.pi)

    def is_better(self, other: Explanations) -> bool:
        """Whether axes as they are given explain the movement better than any do in the other."""
        own = self.rms[self.plain]
        return bool(own < min(WEIGHED.worst_fit, float(other.rms.min())))

    def way(self, k: int) -> Way:
        """Return one way."""
        values = self.gyro[k], self.field[k], self.parameters[k], self.sigma[k]
        return Way(*values, self.part)

    def turned(self, k: int) -> float:
        """Return the angle turned about the accelerometer's up, by one way, radians."""
        stretch = self.part
        up = unit(stretch.up[:-1])
        rate = (1.0 + self.parameters[k, SCALE]) * stretch.turn @ self.gyro[k]
        rate = rate - self.parameters[k, BIAS] * stretch.seconds[:, None]
        return float(np.sum(rate * up))


def _are_right(axes: FloatArray) -> BoolArray:
    """Return which axes (k, 3, 3) are those of the body."""
    return np.asarray((axes == np.eye(3)).all(axis=(1, 2)))


def explain(log: SensorLog, inclination: Belief, bias: FloatArray = NO_BIAS) -> Explanations | None:
    """Weigh the ways in which axes may lie; None where too little moves.

    `bias` (3,) is that of the gyro's rates by a rest, rad/s: each fit begins with it.
    """
    every = signed_permutations()
    proper = every[:24]
    part, lag = stretch_of_log(log), 0.0
    if part is None or most_turned(part) < WEIGHED.least_turn:
        return None
    senses = _against_the_field(part, proper, bias)
    for _ in range(WEIGHED.looks):
        more = float(senses.parameters[senses.best, LAG])
        nearer = stretch_of_log(log, lag + more) if abs(more) > WEIGHED.settled else None
        if nearer is None:
            break
        part, lag = nearer, lag + more
        senses = _against_the_field(part, proper, bias)
    gyro, field, base = _remaining(part, senses, every, proper)
    found = align(part, field, gyro, bias=bias)
    # Each field against its opposite, which turns alike.
    twice = np.tile(np.arange(len(field)), 2)
    parameters = found.parameters[twice]
    parameters[:, LAG] += lag
    parameters[len(field) :, FIELD.start : IRON.stop] *= -1.0
    return Explanations(
        gyro[twice],
        np.concatenate([field, -field]),
        base[twice] - base.min(),
        found.rms[twice],
        parameters,
        np.sqrt(np.einsum("kii->ki", found.covariance[twice])),
        part,
        found,
        inclination,
    )


def most_turned(stretch: Stretch) -> float:
    """Return how far apart the most distant attitudes are, roughly, radians."""
    return float(np.ptp(np.cumsum(stretch.turn + stretch.coning, axis=0), axis=0).max())


def _against_the_field(stretch: Stretch, proper: FloatArray, bias: FloatArray) -> Alignment:
    """Fit the field to the gyro alone, as it turns and the other way round, 24 ways each."""
    senses = np.repeat(np.array([np.eye(3), -np.eye(3)]), len(proper), axis=0)
    return align(stretch, np.concatenate([proper, proper]), senses, with_up=False, bias=bias)


def _remaining(
    stretch: Stretch, senses: Alignment, every: FloatArray, proper: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the ways worth a fit, and the plain one: axes (m, 3, 3) each, and chi-square (m,)."""
    # A vehicle's accelerations lean gravity for long: only its changes are compared.
    misfit, rms = gravity_misfit(stretch, every)
    gravity = _decisive(misfit, rms, senses.least_tilt > 0.0)
    is_good = bool(senses.rms[senses.best] < WEIGHED.good_fit)
    lifted = senses.tilt > WEIGHED.lift and senses.least_tilt > 0.0 and is_good
    against_field = _decisive(senses.misfit, senses.rms, lifted).reshape(2, -1)
    sense = np.rint(np.linalg.det(every))
    cost = (against_field[(sense < 0.0).astype(int)] + gravity[:, None]).ravel()
    field = np.einsum("kij,gjl->gkil", proper, sense[:, None, None] * every).reshape(-1, 3, 3)
    order = np.argsort(cost, kind="stable")
    gyro = order // len(proper)
    # A turn on the level leaves most axes of a gyro open: those as given are always among them.
    likely = (np.arange(len(order)) < WEIGHED.most) | (gyro == 0)
    right = (gyro == 0) & _are_right(field[order])
    kept = (likely & (cost[order] - cost.min() < 4.0 * WEIGHED.remains)) | right
    return every[gyro[kept]], field[order[kept]], cost[order[kept]]


def _decisive(misfit: FloatArray, rms: FloatArray, lifted: bool) -> FloatArray:
    """Return misfits (k,) against field or gravity as far as they can decide."""
    # In one turn about one axis a soft iron that is stronger than believed looks like other axes,
    # and so does linear acceleration where gravity does not show the lift that the gyro reads: then
    # only those are excluded that fit plainly worse.
    plainly = rms > WEIGHED.times * rms[np.argmin(misfit)]
    capped = np.minimum(misfit, WEIGHED.doubtful)
    return np.asarray(np.where(plainly | lifted, misfit, capped))


def _inclination_misfit(found: Alignment, dip: Belief) -> FloatArray:
    """Return chi-square (2 k,) of the inclination by each candidate, then by their opposites."""
    is_known = np.asarray(np.isfinite(found.covariance).all(axis=(1, 2)))
    if dip.is_unknown:
        return np.zeros(2 * len(is_known))
    up, field = unit(found.parameters[:, UP]), found.parameters[:, FIELD]
    size = np.linalg.norm(field, axis=1)
    along = np.sum(up * field, axis=1) / size
    level = np.sqrt(np.maximum(1.0 - along**2, 1e-6))
    slope = (up - (along / size)[:, None] * field) / (size * level)[:, None]
    covariance = np.where(is_known[:, None, None], found.covariance[:, FIELD, FIELD], 0.0)
    variance = np.einsum("ki,kij,kj->k", slope, covariance, slope)
    # Drift of the gyro looks like a small tilt, which shows nothing of the field.
    variance += (WEIGHED.attitude_error / max(found.least_tilt, 1e-6)) ** 2
    variance += WEIGHED.dip_sigma**2 + dip.sigma**2
    seen = -np.arcsin(np.clip(along, -1.0, 1.0))
    misfits = [
        np.where(is_known, (sign * seen - dip.value) ** 2 / variance, 0.0) for sign in (1, -1)
    ]
    return np.concatenate(misfits)


def gravity_misfit(stretch: Stretch, ways: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Weigh how each way explains gravity's changes.

    Return chi-square (k,) above the best's, and the typical residual, radians (k,).

    A body that turns by a small angle d sees up change by -d x up, and at a distance r from the
    point about which it turns it is accelerated by what r and the gyro tell. Other accelerations
    change the size of what is felt, which no turn does, and lean it as much.

    Rows of each of the `ways` (k, 3, 3) are the gyro's axes in the accelerometer's.
    """
    seconds = accumulated(stretch.seconds)
    first, last, turn = _turns_in(stretch, WEIGHED.span)
    if len(first) < 4:
        return np.zeros(len(ways)), np.zeros(len(ways))
    size = np.linalg.norm(stretch.up, axis=1, keepdims=True)
    uneven = float(np.median(np.abs(size[last] - size[first]))) / 0.6745
    up = stretch.up / np.maximum(size, 1e-9)
    middle = skews(0.5 * (up[last] + up[first]))
    seen = up[last] - up[first]
    turned = turn @ ways
    # seen = middle x (turned (1 + scale) - bias seconds) + swung r
    count, n = len(ways), len(first)
    moved = np.einsum("nij,knj->kni", middle, turned)
    drift = -middle * (seconds[last] - seconds[first])[:, None, None]
    rate = stretch.rate @ ways
    turns = skews(rate)
    # A metre of lever arm is accelerated by so many g.
    swung = (skews(np.gradient(rate, seconds, axis=1)) + turns @ turns) / STANDARD_GRAVITY
    swung = -middle @ middle @ (swung[:, last] - swung[:, first])
    drifted = np.broadcast_to(drift, (count, n, 3, 3))
    design = np.concatenate([drifted, moved[..., None], swung], axis=3)
    target = seen - moved
    sizes = np.array([WIDE.bias] * 3 + [WIDE.scale] + [WEIGHED.lever] * 3)
    prior = np.diag(sizes**-2.0)
    repeated = max(float(np.mean(last - first)), 1.0)
    sigma, left = math.radians(5.0), np.zeros((count, n))
    for _ in range(WEIGHED.rounds):
        weight = 7.0 / (4.0 + left / sigma**2) / sigma**2 / repeated
        rows = design * weight[..., None, None]
        normal = np.einsum("knia,knib->kab", rows, design) + prior
        found = np.linalg.solve(normal, np.einsum("knia,kni->ka", rows, target)[..., None])[..., 0]
        left = np.sum((target - np.einsum("knia,ka->kni", design, found)) ** 2, axis=2)
        typical = np.sqrt(np.median(left, axis=1) / 2.37)
        cost = 7.0 * np.log1p(left / 4.0 / sigma**2).sum(axis=1) / repeated
        sigma = max(float(typical[np.argmin(cost)]), uneven, WEIGHED.attitude_error)
    cost = 7.0 * np.log1p(left / 4.0 / sigma**2).sum(axis=1) / repeated
    cost = cost + np.einsum("ka,ab,kb->k", found, prior, found)
    return np.asarray(cost - cost.min()), np.asarray(np.maximum(typical, WEIGHED.attitude_error))


def _turns_in(stretch: Stretch, span: float) -> tuple[IntArray, IntArray, FloatArray]:
    """Return first and last row of each span of so many seconds, and the gyro's turn (n, 3)."""
    seconds, angle = accumulated(stretch.seconds), accumulated(stretch.turn)
    last = np.searchsorted(seconds, seconds + span)
    first = np.flatnonzero(last < len(seconds))
    return first, last[first], angle[last[first]] - angle[first]


KNOWN: tuple[tuple[float, str], ...] = (
    (math.radians(1.0), "degrees/s published as rad/s"),
    (math.degrees(1.0), "rad/s converted from degrees twice"),
    (math.radians(1.0) / STANDARD_GRAVITY, "rates converted to degrees and multiplied by gravity"),
    (1.0 / STANDARD_GRAVITY, "rates multiplied by gravity, as accelerations are"),
)
"""What makes rad/s of rates that people have published, and how it comes to be."""
FEWEST_SPANS = 3  # that show the unit


def rate_factors(stretch: Stretch) -> tuple[float, ...] | None:
    """Return what may make rad/s of the gyro's rates, 1 or a known slip; None if they are rad/s.

    The way that the field goes in a short time is its size times the angle; the size is that of the
    field's changing part, which is right within a factor two for a quarter turn or more. Where
    neither gyro nor field shows the unit, it is 1.
    """
    for rough in (_by_the_gyro(stretch), _by_the_field(stretch)):
        if rough is None:
            continue
        if 1.0 / WEIGHED.plain < rough < WEIGHED.plain:
            return None
        known = (1.0, *(factor for factor, _ in KNOWN))
        near = tuple(f for f in known if rough / WEIGHED.below < f < rough * WEIGHED.above)
        if near:
            return near
    return (1.0,)


def _by_the_gyro(stretch: Stretch) -> float | None:
    """Return the way of the field over the gyro's angle, in the spans with the largest angles.

    What a street adds to it is seen where the gyro does not turn.
    """
    first, last, turn = _turns_in(stretch, WEIGHED.spans[0])
    way = np.linalg.norm(stretch.field[last] - stretch.field[first], axis=1)
    turned = np.linalg.norm(turn, axis=1)
    most = float(np.max(turned, initial=0.0))
    quick, slow = turned > 0.5 * most, turned < 0.1 * most
    if quick.sum() < FEWEST_SPANS:
        return None
    street = float(np.median(way[slow])) if slow.sum() >= FEWEST_SPANS else 0.0
    by_turning = float(np.median(way[quick])) ** 2 - street**2
    return math.sqrt(by_turning) / float(np.median(turned[quick])) if by_turning > 0.0 else None


def _by_the_field(stretch: Stretch) -> float | None:
    """Return the same in the spans with the largest ways of the field; None if it does not move.

    A field that changes from place to place goes farther than the gyro turns, and is no slip.
    """
    for span in WEIGHED.spans:
        first, last, turn = _turns_in(stretch, span)
        way = np.linalg.norm(stretch.field[last] - stretch.field[first], axis=1)
        moved = way > max(WEIGHED.moved, 0.5 * float(np.max(way, initial=0.0)))
        if moved.sum() >= FEWEST_SPANS:
            turned = np.linalg.norm(turn[moved], axis=1)
            return float(np.median(way[moved])) / max(float(np.median(turned)), 1e-12)
    return None
