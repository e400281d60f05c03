"""The priors of a robot's unknowns."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray, IntArray
from magcal_ros.core.heading.heading_tuning import FUSION
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.smoother.earth import EarthFieldPrior
from magcal_ros.core.smoother.unknowns import (
    ALIKE,
    AT,
    BIAS_UP,
    CURRENT_LATE,
    EARTH,
    EXACT_IRON,
    FREEDOM_IF_PASSED,
    IRON_OVER_AXES,
    LASTING,
    LEAN,
    MODULE,
    NOTHING,
    SHARED,
    SIZES,
    SWAY,
    UNKNOWNS,
    USUALLY_LATE,
    YAW,
    Lengths,
    Size,
)

MOUNTED = 0.1  # sigma of a robot's up off the z axis of its IMU, radians: most are mounted level
CIRCLE = 0.6  # sigma of the accelerometer's distance from the centre of a small circle, metres
GRID = 60  # number of factors of an effect's sigma that are tried
RATIOS = np.linspace(-8.0, 8.0, 81)
"""Tried logarithms of the ratio of distortions by soft iron and by non-orthogonal axes."""


FREE_IF_SEEN = (
    *("sway_arm", "axis", "upright", "turned", "place", "added", "entered", "came"),
    *("motors_current", "current_late"),
)
"""Groups that with a gyro are not needed, or are observable only in several turns, with a change,
or with a battery."""
OF_INEXACT_SENSORS = (
    *("bias_walk", "gyro_matrix", "lever_arm", "latency", "motors_moving", "motors_rate", "drift"),
    *("force_moving", "force_offset", "axes", "shielding", "gradient"),
)
"""Groups that are zero with exact sensors."""

BY_MOTION = (
    *("gyro_bias", "bias_walk", "gyro_matrix", "lever_arm", "latency"),
    *("motors_moving", "motors_rate", "drift", "force_moving", "gradient"),
)
"""Unknowns of motion, which are zero at known headings."""


@dataclass(frozen=True, eq=False)
class Priors:
    """Means and sigmas of the unknowns' priors."""

    mean: FloatArray  # Shape (SHARED,)
    scale: FloatArray  # sigma of each unknown; zero if it is held fixed. Shape (SHARED,).
    fields: EarthFieldPrior  # of the Earth, in place of mean and scale
    forward: FloatArray  # front of the vehicle in body axes. Shape (3,).
    spread: Mapping[str, float] = field(
        default_factory=lambda: {name: each.spread for name, each in UNKNOWNS.items()}
    )
    """Spreads of the groups' factors (`Unknown`)."""
    most: Mapping[str, float] = field(
        default_factory=lambda: {name: each.most for name, each in UNKNOWNS.items()}
    )
    """Largest factors."""
    sizes: Mapping[str, Size] = field(default_factory=lambda: dict(SIZES))
    lengths: Lengths = field(default_factory=Lengths)
    iron_over_axes: float = IRON_OVER_AXES
    """Median distortion by soft iron over that by non-orthogonal axes."""

    def about(self, iron: FloatArray, axes: FloatArray) -> Priors:
        """Return the priors about a start with this hard iron and these level axes."""
        mean = self.mean.copy()
        mean[AT["iron"]] = iron
        ahead, left, _ = self.forward @ axes
        mean[AT["mounting_yaw"]] = math.atan2(left, ahead)
        return replace(self, mean=mean)

    @property
    def with_parts_moved(self) -> Priors:
        """The priors of a robot on which a part is moved during the window."""
        return replace(self, lengths=replace(self.lengths, body_field=LASTING))

    @property
    def with_something_passing(self) -> Priors:
        """The priors of a turn past which something magnetic moves: wrong samples of the field."""
        field = self.sizes["field"]._replace(freedom=FREEDOM_IF_PASSED)
        return replace(self, sizes={**self.sizes, "field": field})

    def with_scales(
        self,
        scales: Mapping[str, FloatArray | Sequence[float] | float],
        fixed: Sequence[str] = (),
    ) -> Priors:
        """Return the priors with other sigmas of some groups; `fixed` are certain sigmas."""
        scale = self.scale.copy()
        for name, sigma in scales.items():
            scale[AT[name]] = sigma
        return replace(self, scale=scale, spread={**self.spread, **dict.fromkeys(fixed, 0.0)})

    @property
    def in_a_gradient(self) -> Priors:
        """The priors of a magnetometer that moves through a field gradient."""
        return self.with_scales({"gradient": UNKNOWNS["gradient"].sigma})

    @property
    def in_a_circle(self) -> Priors:
        """The priors of a robot that may drive a small circle, with a distant pivot."""
        along, across, up = self.scale[AT["lever_arm"]]
        more = CIRCLE / UNKNOWNS["lever_arm"].sigma[0]
        return self.with_scales(
            {"lever_arm": [more * along, more * across, up]}, fixed=["lever_arm"]
        )

    def with_dead_axes(self, living: tuple[bool, bool, bool]) -> Priors:
        """Return the priors of a window in which axes of the gyro are dead.

        The robot turns about an axis that is fixed in the body, and tilts off it. Without a limit
        of the tilt, the centripetal acceleration of a circle would count as tilt.
        """
        if all(living):
            return self
        living_of = np.array(living, dtype=float)
        scales = {
            "gyro_bias": living_of * self.scale[AT["gyro_bias"]],
            "gyro_matrix": np.repeat(living_of, 3) * self.scale[AT["gyro_matrix"]],
            "bias_walk": living_of[2] * self.scale[AT["bias_walk"]],
            "axis": MOUNTED,
            "upright": UNKNOWNS["upright"].sigma,
        }
        return replace(self.with_scales(scales), sizes={**self.sizes, "lean": LEAN})

    def without_rates(self, *, rests: bool) -> Priors:
        """Return the priors of a window without a gyro; `rests` is whether it contains a rest."""
        held = ["gyro_bias", "bias_walk", "gyro_matrix", "gradient", "latency"]
        if not self.fields.is_known:
            held.append("shielding")
        free = {name: UNKNOWNS[name].sigma for name in ("axis", "upright", "sway_arm")}
        # Without a rest, the size of the accelerometer's shift in motion is not observable.
        fixed = [] if rests else ["force_moving"]
        found = self.with_scales({**dict.fromkeys(held, 0.0), **free}, fixed)
        return replace(found, sizes={**self.sizes, **SWAY})

    def log_factor(self, name: str, known: Mapping[str, float]) -> tuple[float, float]:
        """Return mean and variance of the log of a group's factor, from the known factors."""
        others = [
            math.log(known[each]) / self.spread[each]
            for each in MODULE
            if name in MODULE and each != name and each in known and self._varies(each)
        ]
        share = ALIKE / (1.0 + (len(others) - 1) * ALIKE)
        left = 1.0 - len(others) * share * ALIKE
        return self.spread[name] * share * sum(others), self.spread[name] ** 2 * left

    def factors_of(self, name: str, known: Mapping[str, float]) -> tuple[FloatArray, FloatArray]:
        """Return possible logarithms of a group's factor, and their log densities.

        Two causes of a distortion, non-orthogonal axes and soft iron, cannot be separated. The
        factor of the axes is at most that of the distortion.
        """
        if name == "axes":
            axes, density = self._by_cause(np.log([known["soft_iron"]]), known)
            return axes[0], density[0]
        x = self._grids[name]
        return x, self.log_density(name, x, known)

    @cached_property
    def _grids(self) -> dict[str, FloatArray]:
        """The tried logarithms of each group's factor."""
        return {
            name: np.linspace(-3.0 * spread, math.log(self.most[name]), GRID)
            for name, spread in self.spread.items()
        }

    def log_density(self, name: str, x: FloatArray, known: Mapping[str, float]) -> FloatArray:
        """Return the log density of the logarithm of a group's factor, up to a constant."""
        if name == "soft_iron" and not self.has_exact_axes:
            density = self._by_cause(x, known)[1]
            peak = density.max(axis=1)
            return np.asarray(peak + np.log(np.sum(np.exp(density - peak[:, None]), axis=1)))
        mean, variance = self.log_factor(name, known)
        return np.asarray(-0.5 * (x - mean) ** 2 / variance)

    def _by_cause(self, x: FloatArray, known: Mapping[str, float]) -> tuple[FloatArray, FloatArray]:
        """Return possible logarithms of the axes' factor in a distortion, and their log density.

        `x` are logarithms of the distortion's factor. Its square is the sum of the squares of both
        causes: at a ratio tan(u) they are cos(u) and sin(u) of the factor. Shapes (x, `RATIOS`).
        """
        mean, variance = self.log_factor("axes", known)
        axes = x[:, None] - 0.5 * np.log1p(np.exp(2.0 * RATIOS))
        iron = axes + RATIOS - math.log(self.iron_over_axes)
        density = -0.5 * ((axes - mean) ** 2 / variance + (iron / self.spread["soft_iron"]) ** 2)
        return axes, np.where(axes < math.log(self.most["axes"]), density, -math.inf)

    @cached_property
    def free(self) -> IntArray:
        """Indices of the free shared unknowns."""
        return np.flatnonzero(self.scale > 0.0)

    @cached_property
    def rows_of_group(self) -> dict[str, IntArray]:
        """Where the unknowns of each group are among all free ones."""
        free = self.free
        return {
            name: np.flatnonzero((free >= at.start) & (free < at.stop)) for name, at in AT.items()
        }

    @property
    def has_exact_axes(self) -> bool:
        """Whether the magnetometer's axes are orthogonal: soft iron alone distorts the field."""
        return not self._varies("axes")

    def _varies(self, name: str) -> bool:
        """Whether a group and the factor of its sigma are estimated."""
        return self.spread[name] > 0.0 and bool(self.scale[AT[name]].any())


def priors_of(knowledge: Knowledge, bias_sigma: float = math.inf) -> Priors:
    """Return the priors from the knowledge of a robot and its place.

    `bias_sigma` is the sigma of the gyro's bias from a rest, rad/s per axis; infinite without one.
    """
    fields = EarthFieldPrior.of(knowledge.reference)
    mean = np.zeros(SHARED)
    mean[EARTH], mean[CURRENT_LATE] = fields.gaussian.mean, USUALLY_LATE
    scale = np.concatenate([each.sigma for each in UNKNOWNS.values()])
    found = Priors(mean, scale, fields, knowledge.mounting.forward)
    held = set(FREE_IF_SEEN)
    if math.isfinite(bias_sigma):
        found = found.with_scales({"gyro_bias": max(bias_sigma, 1e-6)}, fixed=["gyro_bias"])
    if knowledge.exact_sensors:
        sigma, spread, most = EXACT_IRON
        nothing = {
            name: found.sizes[name]._replace(usual=NOTHING, spread=0.1, start=NOTHING)
            for name in ("street", "revisited", "body_field", "motors_noise")
        }
        found = replace(
            found.with_scales({"soft_iron": sigma}),
            spread={**found.spread, "soft_iron": spread},
            most={**found.most, "soft_iron": most},
            sizes={**found.sizes, **nothing},
        )
        held |= set(OF_INEXACT_SENSORS)
    if knowledge.soft_iron.sigma_diagonal == 0.0:
        held |= {"axes", "soft_iron", "shielding"}
    return found.with_scales(dict.fromkeys(held, 0.0))


def priors_at_known_headings(knowledge: Knowledge, by_gyro: bool) -> Priors:
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
