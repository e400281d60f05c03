"""The priors of a robot's unknowns."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.smoother.unknowns import (
    ALIKE,
    AT,
    EARTH,
    EXACT_IRON,
    IRON_OVER_AXES,
    LASTING,
    MICROTESLA,
    MODULE,
    NOTHING,
    SHARED,
    SIZES,
    STRONGEST,
    UNKNOWNS,
    Lengths,
    Size,
)

GRID = 60  # factors of an effect's sigma that are tried
RATIOS = np.linspace(-8.0, 8.0, 81)
"""Logarithms of the ratios that are tried of a distortion by soft iron to that by crooked axes."""


@dataclass(frozen=True, eq=False)
class Priors:
    """Means and sigmas of the unknowns' priors."""

    mean: FloatArray  # Shape (SHARED,)
    scale: FloatArray  # sigma of each number; zero for one that is known. Shape (SHARED,).
    earth: FloatArray  # covariance of level and downward field, µT². Shape (2, 2).
    strength: tuple[float, float] | None = None
    """Strength of the Earth's field and its sigma, µT, without a reference."""
    spread: Mapping[str, float] = field(
        default_factory=lambda: {name: each.spread for name, each in UNKNOWNS.items()}
    )
    """Of the groups' factors (`Unknown`)."""
    most: Mapping[str, float] = field(
        default_factory=lambda: {name: each.most for name, each in UNKNOWNS.items()}
    )
    """Largest factors."""
    sizes: Mapping[str, Size] = field(default_factory=lambda: dict(SIZES))
    lengths: Lengths = field(default_factory=Lengths)
    iron_over_axes: float = IRON_OVER_AXES
    """Median distortion by soft iron over that by crooked axes."""

    def about(self, iron: FloatArray, level: float) -> Priors:
        """Return the priors about a start: hard iron, and the level field where it is unknown."""
        mean = self.mean.copy()
        mean[AT["iron"]] = iron
        if self.earth[0, 0] >= UNKNOWNS["earth"].sigma[0] ** 2:
            mean[EARTH.start] = level
        return replace(self, mean=mean)

    @property
    def with_parts_moved(self) -> Priors:
        """The priors of a robot on which something is moved meanwhile, and stays there."""
        return replace(self, lengths=replace(self.lengths, body_field=LASTING))

    def of_earth(self, earth: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the information on level and downward field, and their expectation minus `earth`.

        The strength is not linear in them: its limit counts as at that value.
        """
        information = np.linalg.inv(self.earth)
        drawn = information @ (self.mean[EARTH] - earth)
        excess, sigma, along = self.beyond_strongest(earth)
        if excess > 0.0:
            information = information + np.outer(along, along) / sigma**2
            drawn = drawn - along * excess / sigma**2
        return np.asarray(information), np.asarray(np.linalg.solve(information, drawn))

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

        No sample separates the two causes of a distortion, crooked axes and soft iron: the factor
        of the axes is at most that of the distortion.
        """
        if name == "axes":
            axes, density = self._by_cause(np.log([known["soft_iron"]]), known)
            return axes[0], density[0]
        x = np.linspace(-3.0 * self.spread[name], math.log(self.most[name]), GRID)
        return x, self.log_density(name, x, known)

    def log_density(self, name: str, x: FloatArray, known: Mapping[str, float]) -> FloatArray:
        """Return the log density of the logarithm of a group's factor, but for a constant."""
        if name == "soft_iron" and not self.has_exact_axes:
            density = self._by_cause(x, known)[1]
            peak = density.max(axis=1)
            return np.asarray(peak + np.log(np.sum(np.exp(density - peak[:, None]), axis=1)))
        mean, variance = self.log_factor(name, known)
        return np.asarray(-0.5 * (x - mean) ** 2 / variance)

    def _by_cause(self, x: FloatArray, known: Mapping[str, float]) -> tuple[FloatArray, FloatArray]:
        """Return the logarithms of what crooked axes may be of a distortion, and their log density.

        `x` are logarithms of the distortion's factor. The squares of both causes add up to its
        square: at a ratio tan(u) they are its shares cos(u) and sin(u). Shapes (x, `RATIOS`).
        """
        mean, variance = self.log_factor("axes", known)
        axes = x[:, None] - 0.5 * np.log1p(np.exp(2.0 * RATIOS))
        iron = axes + RATIOS - math.log(self.iron_over_axes)
        density = -0.5 * ((axes - mean) ** 2 / variance + (iron / self.spread["soft_iron"]) ** 2)
        return axes, np.where(axes < math.log(self.most["axes"]), density, -math.inf)

    @property
    def has_exact_axes(self) -> bool:
        """Whether the magnetometer's axes are square: soft iron alone distorts the field."""
        return not self._varies("axes")

    def _varies(self, name: str) -> bool:
        """Whether a group and the factor of its sigma are estimated."""
        return self.spread[name] > 0.0 and bool(self.scale[AT[name]].any())

    def beyond_strongest(self, earth: FloatArray) -> tuple[float, float, FloatArray]:
        """Return by how much a field exceeds its limit, the sigma of that, and its direction."""
        most, sigma = self.strength or (math.inf, 1.0)
        size = float(np.linalg.norm(earth))
        return max(0.0, size - most), sigma, earth / max(size, 1e-9)


def priors_of(knowledge: Knowledge, bias_sigma: float = math.inf) -> Priors:
    """Return the priors from the knowledge of a robot and its place.

    `bias_sigma` is that of the gyro's bias by a rest, rad/s per axis, else infinite.
    """
    mean = np.zeros(SHARED)
    scale = np.concatenate([np.array(each.sigma) for each in UNKNOWNS.values()])
    spread = {name: each.spread for name, each in UNKNOWNS.items()}
    if math.isfinite(bias_sigma):
        scale[AT["gyro_bias"]] = max(bias_sigma, 1e-6)
        spread["gyro_bias"] = 0.0
    # With a gyro these are not needed, or only several turns separate them.
    for name in (
        "sway_arm",
        "axis",
        "upright",
        "turned",
        "place",
        "added",
        "entered",
        "came",
    ):
        scale[AT[name]] = 0.0
    mean[EARTH], earth = _earth(knowledge)
    most = {name: each.most for name, each in UNKNOWNS.items()}
    sizes = dict(SIZES)
    if knowledge.exact_sensors:
        for name in (
            "bias_walk",
            "gyro_matrix",
            "lever_arm",
            "latency",
            "motors_moving",
            "motors_rate",
            "drift",
            "force_moving",
            "force_offset",
            "axes",
            "shielding",
            "gradient",
        ):
            scale[AT[name]] = 0.0
        scale[AT["soft_iron"]], spread["soft_iron"], most["soft_iron"] = EXACT_IRON
        for name in ("street", "body_field", "motors_noise"):
            sizes[name] = sizes[name]._replace(usual=NOTHING, spread=0.1, start=NOTHING)
    if knowledge.soft_iron.sigma_diagonal == 0.0:
        for name in ("axes", "soft_iron", "shielding"):
            scale[AT[name]] = 0.0
    strength = STRONGEST if knowledge.reference.strength.is_unknown else None
    return Priors(mean, scale, earth, strength, spread, most, sizes)


def _earth(knowledge: Knowledge) -> tuple[FloatArray, FloatArray]:
    """Return the expected level and downward field, µT, and their covariance."""
    wide = np.square(UNKNOWNS["earth"].sigma)
    strength, dip = knowledge.reference.strength, knowledge.reference.inclination
    if strength.is_unknown and dip.is_unknown:
        return np.array([25.0, 20.0]), np.diag(wide)
    size = 45.0 if strength.is_unknown else strength.value * MICROTESLA
    angle = math.radians(55.0) if dip.is_unknown else dip.value
    size_sigma = 20.0 if strength.is_unknown else max(strength.sigma * MICROTESLA, 1e-3)
    angle_sigma = 0.7 if dip.is_unknown else max(dip.sigma, 1e-5)
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    spread = np.diag([size_sigma**2, (size * angle_sigma) ** 2])
    return size * turn[:, 0], turn @ spread @ turn.T
