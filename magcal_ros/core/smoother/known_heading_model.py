"""Measurements at known headings, as nodes of the smoother.

Each measurement is a node. It has no link to the one before, or only the gyro's
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

from magcal_ros.core.geometry.arrays import FloatArray, IntArray, freeze
from magcal_ros.core.geometry.attitude import level_part, unit
from magcal_ros.core.heading.heading_tuning import FUSION
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.smoother import factors
from magcal_ros.core.smoother.fit import Tolerances
from magcal_ros.core.smoother.model import GAUSSIAN, LEAST_VARIANCE
from magcal_ros.core.smoother.nodes import Nodes, at_rest
from magcal_ros.core.smoother.places import Places
from magcal_ros.core.smoother.priors import Priors, priors_of
from magcal_ros.core.smoother.solver import Prior, WeightedResiduals, solve
from magcal_ros.core.smoother.state import Course, State
from magcal_ros.core.smoother.unknowns import (
    AT,
    ATTITUDE,
    BIAS_UP,
    BODY_FIELD,
    EARTH,
    HEADING_DRIFT,
    HEADING_RATE,
    LOCAL,
    MICROTESLA,
    SHARED,
    SIZES,
    STREET,
    YAW,
)

TOLERANCES = Tolerances(rounds=30, step=0.01)
BY_MOTION = (
    *("gyro_bias", "bias_walk", "gyro_matrix", "lever_arm", "latency"),
    *("motors_moving", "motors_rate", "drift", "force_moving", "gradient"),
)
"""Unknowns of motion, which stay zero."""


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
    cost: float
    """Minus twice the logarithm of the evidence, up to a constant of the measurements."""
    misfit: float  # sum of squared normalised residuals


@dataclass(frozen=True, eq=False)
class KnownHeadingModel:
    """All measurements as nodes, with their priors."""

    course: Course
    columns: Mapping[str, FloatArray]  # the values of the measurements, by field. Shapes (n, ...).
    correlation: FloatArray
    """Correlation of the local disturbance with the previous measurement. Shape (n - 1,)."""
    common: FloatArray  # sigma of the error common to all headings, radians. Shape (n,).
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
        priors = _priors(knowledge, bool(columns["seconds"][1:].any()))
        state = _start(nodes, columns, priors)
        mean = priors.mean.copy()
        mean[AT["iron"]] = state.shared[AT["iron"]]
        by_declination = columns["by_declination"] * knowledge.reference.declination_sigma
        return cls(
            Course(nodes, np.eye(3), nodes.quiet),
            columns,
            np.exp(-columns["distance"][1:] / priors.lengths.street),
            np.hypot(by_declination, columns["common_sigma"]),
            replace(priors, mean=mean),
            state,
        )

    def field_of(self, state: State) -> factors.Residuals:
        """Return the residuals of the field at a state."""
        return factors.magnetic(self.course, state, Places.none(len(self.common), 1.0))

    def residuals(self, state: State, size: float, drift: Drift) -> dict[str, WeightedResiduals]:
        """Return all residuals with their variances.

        `size` is the size of the local disturbance, `drift` the drift of the headings.
        """
        of, ones = self.columns, np.ones(len(self.common))
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
            found |= {
                "turn": (factors.known_turn(turned, seconds, of["forward"], state), sigma**2),
                "drift": (
                    factors.heading_drift(state, kept, seconds),
                    drift.sigma**2 * (1.0 - kept**2) + LEAST_VARIANCE,
                ),
                "drift rate": (
                    factors.process(state, HEADING_RATE, ones[1:]),
                    LEAST_VARIANCE * ones[1:],
                ),
                "street": (
                    factors.process(state, STREET, self.correlation),
                    size**2 * (1.0 - self.correlation**2) + LEAST_VARIANCE,
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
        free = self.free
        information = np.zeros((SHARED, SHARED))
        information[free, free] = self.priors.scale[free] ** -2.0
        information[EARTH, EARTH] = self.priors.fields.gaussian.information
        offset = self.priors.mean - state.shared
        return Prior(local, -state.local, information[np.ix_(free, free)], offset[free])

    @property
    def free(self) -> IntArray:
        """The indices of the estimated shared unknowns."""
        return np.flatnonzero(self.priors.scale > 0.0)

    def optimum(
        self,
        size: float,
        start: State | None = None,
        drift: Drift = NO_DRIFT,
        rounds: int = TOLERANCES.rounds,
    ) -> KnownHeadingOptimum:
        """Return the optimum after some steps at most; parameters as for `residuals`."""
        state, free = start or self.start, self.free
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
        linear = replace(heading, residual=heading.residual + self.common[:, None])
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


def _priors(knowledge: Knowledge, by_gyro: bool) -> Priors:
    """Return the priors of measurements; uncertain sigmas are replaced by their RMS."""
    priors = priors_of(knowledge)
    scale = priors.scale.copy()
    for name, at in AT.items():
        scale[at] *= 0.0 if name in BY_MOTION else _mean_factor(name, priors)
    # Only known headings show the yaw of the magnetometer.
    scale[YAW] = math.hypot(scale[YAW], knowledge.mounting.yaw_sigma)
    if by_gyro:
        scale[BIAS_UP] = FUSION.bias_sigma
    return replace(priors, scale=scale)


def _mean_factor(name: str, priors: Priors) -> float:
    """Return the root mean square of the factor of a group's sigmas (`Unknown`)."""
    spread = priors.spread[name]
    if spread == 0.0:
        return 1.0
    x = np.linspace(-6.0 * spread, math.log(priors.most[name]), 400)
    odds = np.exp(priors.log_density(name, x, {}))
    return math.sqrt(float(np.sum(odds * np.exp(2.0 * x)) / np.sum(odds)))


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
