"""Calibration from measurements of the field at known headings.

Each measurement is a node of the smoother. It has no link to the one before, or only the gyro's
turn since then. The unknowns and their priors are those of the smoother; unknowns of motion stay
zero.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from dataclasses import field as member
from typing import NamedTuple

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray, freeze
from magcal_ros.core.geometry.attitude import level_part, unit
from magcal_ros.core.heading.heading_tuning import FUSION
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.smoother import factors
from magcal_ros.core.smoother.fit import Tolerances
from magcal_ros.core.smoother.model import GAUSSIAN, LEAST_VARIANCE
from magcal_ros.core.smoother.nodes import Nodes, at_rest
from magcal_ros.core.smoother.places import Places
from magcal_ros.core.smoother.posterior import Posterior, posterior_at
from magcal_ros.core.smoother.priors import Priors, priors_at_known_headings
from magcal_ros.core.smoother.solver import Prior, WeightedResiduals, solve
from magcal_ros.core.smoother.state import Course, State
from magcal_ros.core.smoother.unknowns import (
    AT,
    ATTITUDE,
    BODY_FIELD,
    DISTURBANCE_AT_REST,
    EARTH,
    HEADING_DRIFT,
    HEADING_RATE,
    LOCAL,
    MICROTESLA,
    SHARED,
    SIZES,
    STREET,
    Size,
)

TOLERANCES = Tolerances(rounds=30, step=0.01)


class Drift(NamedTuple):
    """The part of a device's headings that drifts."""

    sigma: float  # degrees
    time: float  # correlation time, seconds
    rate: float = 1e-4  # sigma of a constant drift rate, degrees per second


INTEGRATED = math.degrees(FUSION.integrated_rate)
NO_DRIFT = Drift(1e-3, FUSION.drift_time)
DRIFTS: dict[Drift, float] = {
    Drift(0.7, 0.3 * FUSION.drift_time): 0.3,
    Drift(2.0, FUSION.drift_time): 0.3,
    Drift(6.0, 3.0 * FUSION.drift_time): 0.3,
    Drift(2.0, FUSION.drift_time, INTEGRATED): 0.1,
}
"""Drifts with their prior odds against none. Reflections from walls and trees turn the heading of
antennas a metre apart by some degrees for minutes, on half of all robots; larger errors last
longer. One device in ten integrates a gyro and drifts at a constant rate."""


SPREADS = np.linspace(-2.4, 2.4, 7)
"""Sizes of the local disturbance that are tried, as prior spreads of its logarithm."""
LARGEST_PLAUSIBLE = -2
"""Index of the largest plausible size; headings that misfit even there are contradicted."""


@dataclass(frozen=True, eq=False)
class KnownHeadingMeasurement:
    """The measurements of a robot at rest at a known heading."""

    field: FloatArray  # mean raw field, tesla, in the magnetometer's axes. Shape (3,).
    force: FloatArray  # mean specific force, m/s², body axes. Shape (3,).
    heading: float  # ENU yaw to magnetic north of `forward`, radians
    sigma: float  # standard deviation of the heading, radians
    by_declination: bool = False
    """Whether the heading was given to true north: such headings share the declination's error."""
    forward: FloatArray = member(default_factory=lambda: factors.X)
    """Direction in body axes that `heading` refers to; body x unless given. Shape (3,)."""
    turned: float = 0.0
    turned_sigma: float = math.inf
    """Gyro rotation since the previous measurement, radians to the left, with an infinite sigma if
    there is none."""
    distance: float = math.inf
    """Distance from the previous measurement, metres, for the correlation of the local disturbance;
    infinite for another place."""
    seconds: float = 0.0  # since the previous measurement, for the gyro's bias and a drift
    drifts: bool = False  # whether a device gives the heading, with an error that may drift
    common_sigma: float = 0.0  # of the error common to all headings, radians
    noise_field: float = 0.3e-6
    noise_up: float = 0.003
    """Standard deviations of single samples: tesla per axis, radians of tilt per axis."""
    force_sigma: float = SIZES["force"].usual
    """m/s² per axis of `force`; larger if it is measured in motion."""

    def __post_init__(self) -> None:
        freeze(self, field=(3,), force=(3,), forward=(3,))

    def in_axes(self, rotation: FloatArray) -> KnownHeadingMeasurement:
        """Return the same measurements in rotated body axes."""
        return replace(self, force=rotation @ self.force, forward=rotation @ self.forward)

    @property
    def in_words(self) -> str:
        """The heading in words, degrees."""
        yaw, sigma = math.degrees(self.heading), math.degrees(self.sigma)
        return f"{yaw:.1f}° ±{sigma:.1f}° to magnetic north"


@dataclass(frozen=True, eq=False)
class KnownHeadingOptimum:
    """The optimum at one size of the local disturbance and one drift."""

    state: State
    covariance: FloatArray  # of the shared unknowns. Shape (SHARED, SHARED).
    cost: float  # as that of `HeadingAgreement`
    misfit: float  # sum of squared normalised residuals


@dataclass(frozen=True)
class HeadingAgreement:
    """How well known headings, field and gyro agree."""

    cost: float
    """Minus twice the logarithm of the evidence, up to a constant of the number of measurements."""
    misfit: float
    """Sum of squared normalised residuals at the usual size of the local disturbance."""
    least: float  # the same at the largest plausible size
    freedom: int
    """Degrees of freedom: components of the field, less the hard iron, plus turns by the gyro."""

    @property
    def chance(self) -> float:
        """The probability of a larger misfit by chance (p-value)."""
        from scipy.special import gammaincc

        return float(gammaincc(0.5 * self.freedom, 0.5 * self.least)) if self.freedom else 1.0

    @property
    def times(self) -> float:
        """Root mean square of the normalised residuals."""
        return math.sqrt(self.misfit / self.freedom) if self.freedom else 0.0


@dataclass(frozen=True, eq=False)
class HeadingFit:
    """The fit of measurements at known headings."""

    state: State
    covariance: FloatArray  # of the shared unknowns. Shape (SHARED, SHARED).
    posterior: Posterior
    agreement: HeadingAgreement
    residual: FloatArray
    """Residuals of the field, tesla, sensor axes. Shape (n, 3)."""


@dataclass(frozen=True, eq=False)
class KnownHeadingModel:
    """All measurements as nodes, with their priors."""

    course: Course
    columns: Mapping[str, FloatArray]
    """The values of the measurements, by field; the common sigma is with that of the declination.
    Shapes (n, ...)."""
    priors: Priors
    start: State

    @classmethod
    def of(
        cls, measurements: Sequence[KnownHeadingMeasurement], knowledge: Knowledge
    ) -> KnownHeadingModel:
        """Return measurements as nodes, with the priors from the knowledge."""
        columns = {
            each.name: np.array([getattr(one, each.name) for one in measurements], dtype=float)
            for each in fields(KnownHeadingMeasurement)
        }
        field = columns["field"] @ knowledge.mounting.to_body.T * MICROTESLA
        nodes = at_rest(np.arange(len(field), dtype=float), field, columns["force"])
        priors = priors_at_known_headings(knowledge, bool(columns["seconds"][1:].any()))
        state = _start(nodes, columns, priors)
        mean = priors.mean.copy()
        mean[AT["iron"]] = state.shared[AT["iron"]]
        by_declination = columns["by_declination"] * knowledge.reference.declination_sigma
        columns["common_sigma"] = np.hypot(by_declination, columns["common_sigma"])
        return cls(
            Course(nodes, np.eye(3), nodes.quiet),
            columns,
            replace(priors, mean=mean),
            state,
        )

    def field_of(self, state: State) -> factors.Residuals:
        """Return the residuals of the field at a state."""
        return factors.magnetic(self.course, state, Places.none(len(state.local), 1.0))

    def residuals(self, state: State, size: float, drift: Drift) -> dict[str, WeightedResiduals]:
        """Return all residuals with their variances.

        `size` is the size of the local disturbance, `drift` the drift of the headings.
        """
        of, ones = self.columns, np.ones(len(state.local))
        heading = factors.known_heading(of["heading"], of["forward"], state)
        force = factors.force_at_rest(of["force"], state)
        found = {
            "field": (self.field_of(state), SIZES["field"].rms ** 2 * ones),
            "force": (force, of["force_sigma"] ** 2),
            "heading": (heading, of["sigma"] ** 2),
        }
        if len(ones) > 1:
            turned, seconds, sigma = (of[k][1:] for k in ("turned", "seconds", "turned_sigma"))
            kept = np.exp(-seconds / drift.time)
            correlation = np.exp(-of["distance"][1:] / self.priors.lengths.street)
            drifting = HEADING_DRIFT.start, HEADING_RATE.start
            found |= {
                "turn": (factors.known_turn(turned, seconds, of["forward"], state), sigma**2),
                "drift": (
                    factors.second_order(state, drifting[0], np.stack([kept, seconds]), drifting),
                    drift.sigma**2 * (1.0 - kept**2) + LEAST_VARIANCE,
                ),
                "drift rate": (
                    factors.process(state, HEADING_RATE, ones[1:]),
                    LEAST_VARIANCE * ones[1:],
                ),
                "street": (
                    factors.process(state, STREET, correlation),
                    size**2 * (1.0 - correlation**2) + LEAST_VARIANCE,
                ),
            }
        return {name: WeightedResiduals(*each, GAUSSIAN) for name, each in found.items()}

    def prior(self, state: State, size: float, drift: Drift) -> Prior:
        """Return the priors; parameters as for `residuals`."""
        local = np.full_like(state.local, 1.0)
        local[:, HEADING_DRIFT.start : ATTITUDE.stop] = LEAST_VARIANCE
        local[0, HEADING_DRIFT], local[0, HEADING_RATE] = drift.sigma**-2.0, drift.rate**-2.0
        local[0, STREET] = size**-2.0
        local[1:, STREET] = LEAST_VARIANCE
        local[:, BODY_FIELD] = SIZES["body_field"].rms ** -2.0
        free = self.priors.free
        information = np.zeros((SHARED, SHARED))
        information[free, free] = self.priors.scale[free] ** -2.0
        information[EARTH, EARTH] = self.priors.fields.gaussian.information
        offset = self.priors.mean - state.shared
        return Prior(local, -state.local, information[np.ix_(free, free)], offset[free])

    def optimum(
        self,
        size: float,
        start: State | None = None,
        drift: Drift = NO_DRIFT,
        rounds: int = TOLERANCES.rounds,
    ) -> KnownHeadingOptimum:
        """Return the optimum after some steps at most; parameters as for `residuals`."""
        state, free = start or self.start, self.priors.free
        for left in range(rounds, -1, -1):
            weighted, prior = self.residuals(state, size, drift), self.prior(state, size, drift)
            solution = solve(list(weighted.values()), prior, free)
            sigma = np.sqrt(np.diag(solution.covariance))
            if not left or float(np.max(np.abs(solution.shared) / sigma)) < TOLERANCES.step:
                break
            shared = np.zeros(SHARED)
            shared[free] = solution.shared
            state = state.moved(solution.local, shared)
        # An error common to all headings, of declination or of the antennas' mounting.
        heading = weighted["heading"].linear
        linear = replace(heading, residual=heading.residual + self.columns["common_sigma"][:, None])
        shifted = {**weighted, "heading": replace(weighted["heading"], linear=linear)}
        by_common = solve(list(shifted.values()), prior, free).shared - solution.shared
        whole = np.zeros((SHARED, SHARED))
        whole[np.ix_(free, free)] = solution.covariance + np.outer(by_common, by_common)
        misfit = sum(float(part.chi2.sum()) for part in weighted.values())
        misfit += float(np.sum(prior.local_information * prior.local_offset**2))
        misfit += float(prior.offset @ prior.information @ prior.offset)
        cost = misfit + solution.log_determinant - float(np.log(prior.local_information).sum())
        cost += sum(float(np.sum(part.costs - part.misfits)) for part in weighted.values())
        return KnownHeadingOptimum(state, whole, cost, misfit)


def _start(nodes: Nodes, columns: Mapping[str, FloatArray], priors: Priors) -> State:
    """Return the state that agrees with the headings and the accelerometer."""
    up = unit(columns["force"])
    ahead = unit(level_part(columns["forward"], up))
    left, heading = np.cross(up, ahead), columns["heading"][:, None]
    cosine, sine = np.cos(heading), np.sin(heading)
    east, north = cosine * ahead - sine * left, sine * ahead + cosine * left
    attitude = np.stack([east, north, up], axis=2)
    shared = priors.mean.copy()
    state = State(attitude, np.zeros((len(nodes), LOCAL)), shared)
    shared[AT["iron"]] = np.mean(nodes.field - attitude @ state.earth, axis=0)
    return state


def fit_headings(
    measurements: Sequence[KnownHeadingMeasurement],
    knowledge: Knowledge,
    place: Size = DISTURBANCE_AT_REST,
) -> HeadingFit:
    """Return the fit of the shared unknowns to one or more measurements at known headings.

    `place` is the size of the local disturbance. Raises
    `numpy.linalg.LinAlgError` if a matrix is not positive definite.
    """
    model = KnownHeadingModel.of(measurements, knowledge)
    found, costs, agreement = _optima(model, place)
    weights = np.exp(-0.5 * (costs - costs.min()))
    weights = weights / weights.sum()
    shared = np.einsum("k,ks->s", weights, [each.state.shared for each in found])
    covariance = np.zeros((SHARED, SHARED))
    for weight, each in zip(weights, found, strict=True):
        off = each.state.shared - shared
        covariance += weight * (each.covariance + np.outer(off, off))
    if np.linalg.det(factors.soft_iron(shared)) <= 0.0:
        raise np.linalg.LinAlgError("the soft iron mirrors the axes")
    state = replace(found[int(np.argmax(weights))].state, shared=shared)
    posterior = posterior_at(state, covariance, knowledge.mounting.matrix)
    residual = model.field_of(state).residual @ knowledge.mounting.matrix.T / MICROTESLA
    return HeadingFit(state, covariance, posterior, agreement, residual)


def _optima(
    model: KnownHeadingModel, place: Size
) -> tuple[list[KnownHeadingOptimum], FloatArray, HeadingAgreement]:
    """Return the optima at sizes of the local disturbance and of a drift, costs, and agreement."""
    middle = model.optimum(place.rms)
    sizes = place.usual * np.exp(place.spread * SPREADS)
    found = [model.optimum(float(size), middle.state) for size in sizes]
    costs = np.array([each.cost for each in found]) + SPREADS**2
    usual, large = middle, found[LARGEST_PLAUSIBLE]
    if model.columns["drifts"].any():
        best = int(np.argmin(costs))
        size, start = float(sizes[best]), found[best].state
        drifting = [model.optimum(size, start, drift) for drift in DRIFTS]
        # The sizes of the disturbance are assumed to be as likely with a drift as without one.
        others = 2.0 * math.log(np.exp(-0.5 * (costs - costs[best])).sum()) - SPREADS[best] ** 2
        odds = 2.0 * np.log(list(DRIFTS.values()))
        costs = np.append(costs, [each.cost for each in drifting] - odds - others)
        found += drifting
        k = int(np.argmin(costs)) - len(SPREADS)
        if k >= 0:
            drift, start = list(DRIFTS)[k], drifting[k].state
            usual = model.optimum(place.rms, start, drift)
            large = model.optimum(float(sizes[LARGEST_PLAUSIBLE]), start, drift)
    return found, costs, _agreement(model, usual, large)


def agreement_of(
    measurements: Sequence[KnownHeadingMeasurement],
    knowledge: Knowledge,
    place: Size = DISTURBANCE_AT_REST,
) -> HeadingAgreement:
    """Return the agreement of measurements; parameters and errors as for `fit_headings`."""
    model = KnownHeadingModel.of(measurements, knowledge)
    middle = model.optimum(place.rms)
    size = place.usual * math.exp(place.spread * SPREADS[LARGEST_PLAUSIBLE])
    return _agreement(model, middle, model.optimum(size, middle.state))


def _agreement(
    model: KnownHeadingModel, usual: KnownHeadingOptimum, large: KnownHeadingOptimum
) -> HeadingAgreement:
    turns = np.isfinite(model.columns["turned_sigma"][1:])
    freedom = 3 * len(model.start.local) - 3 + int(turns.sum())
    return HeadingAgreement(usual.cost, usual.misfit, large.misfit, freedom)
