"""Prior of the Earth's field: a mixture of Gaussians of its level and downward components."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.knowledge import ReferenceField
from magcal_ros.core.smoother.unknowns import FIELDS_ON_EARTH, MICROTESLA

LEVEL_SIGMA = 2.0  # µT, sigma of the level field measured at the start


class GaussianEarthPrior(NamedTuple):
    """A Gaussian prior of level and downward field, µT."""

    mean: FloatArray  # shape (2,)
    information: FloatArray  # shape (2, 2)

    def cost(self, earth: FloatArray) -> float:
        """Return minus twice the log density at a field, up to a constant."""
        off = earth - self.mean
        determinant = np.linalg.slogdet(self.information)[1]
        return float(off @ self.information @ off) - float(determinant)


@dataclass(frozen=True, eq=False)
class EarthFieldPrior:
    """Prior of the Earth's field at the robot: one Gaussian if it is known, else a mixture."""

    shares: FloatArray  # weights of the components. Shape (k,).
    means: FloatArray  # µT. Shape (k, 2).
    covariances: FloatArray  # µT². Shape (k, 2, 2).

    @classmethod
    def of(cls, reference: ReferenceField) -> EarthFieldPrior:
        """Return the prior, given what is known of strength and inclination."""
        strength, dip = reference.strength, reference.inclination
        if reference.is_complete:
            size, angle = strength.value * MICROTESLA, dip.value
            turn = np.array(
                [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
            )
            sigma = max(strength.sigma * MICROTESLA, 1e-3), size * max(dip.sigma, 1e-5)
            spread = turn @ np.diag(np.square(sigma)) @ turn.T
            return cls(np.ones(1), size * turn[None, :, 0], spread[None])
        table = np.array(FIELDS_ON_EARTH)
        fields = cls(table[:, 0], table[:, 1:3], np.square(table[:, 3:, None]) * np.eye(2))
        if not strength.is_unknown:
            along = fields.means / np.linalg.norm(fields.means, axis=1, keepdims=True)
            return fields._measured(along, strength.value * MICROTESLA, strength.sigma * MICROTESLA)
        if not dip.is_unknown:
            across = np.array([-math.sin(dip.value), math.cos(dip.value)])
            sizes = np.linalg.norm(fields.means, axis=1)
            return fields._measured(np.tile(across, (len(table), 1)), 0.0, sizes * dip.sigma)
        return fields

    @property
    def is_known(self) -> bool:
        """Whether strength and inclination are given."""
        return len(self.shares) == 1

    @property
    def gaussian(self) -> GaussianEarthPrior:
        """The Gaussian of the same mean and covariance."""
        mean, covariance, _ = self._given(np.zeros((2, 2)), np.zeros(2))
        return GaussianEarthPrior(mean, np.asarray(np.linalg.inv(covariance)))

    def about(self, earth: FloatArray) -> GaussianEarthPrior:
        """Return the initial Gaussian, about the field of the start if the field is not known."""
        prior = self.gaussian
        return prior if self.is_known else prior._replace(mean=self.at_level(earth[0]))

    def at_level(self, level: float) -> FloatArray:
        """Return the expected level and downward field, given a measured level field, µT."""
        information = np.array([LEVEL_SIGMA**-2.0, 0.0])
        return self._given(np.diag(information), information * level)[0]

    def updated(
        self, prior: GaussianEarthPrior, mean: FloatArray, covariance: FloatArray
    ) -> tuple[FloatArray, FloatArray, float]:
        """Return the shift of the posterior mean, its covariance, and the gain in log evidence.

        `mean` and `covariance` are the posterior under `prior`. This prior is removed from them,
        and the likelihood is combined with the mixture. If it lies between two components, the
        new covariance is larger than that of the likelihood alone.
        """
        by_posterior = np.linalg.inv(covariance)
        values, vectors = np.linalg.eigh(by_posterior - prior.information)
        by_samples = (vectors * np.maximum(values, 0.0)) @ vectors.T
        # The mean is the origin: the samples may be far more precise than the prior.
        drawn = prior.information @ (mean - prior.mean)
        spread = np.asarray(np.linalg.inv(prior.information))
        before = EarthFieldPrior(np.ones(1), (prior.mean - mean)[None], spread[None])
        fields = EarthFieldPrior(self.shares, self.means - mean, self.covariances)
        shift, spread, likely = fields._given(by_samples, drawn)
        return shift, spread, likely - before._given(by_samples, drawn)[2]

    def _given(
        self, information: FloatArray, drawn: FloatArray
    ) -> tuple[FloatArray, FloatArray, float]:
        """Return mean and covariance of the posterior, and the log evidence.

        The likelihood is exp(-x' A x / 2 + b' x), with `information` A and `drawn` b.
        """
        own = np.linalg.inv(self.covariances)
        posterior = np.linalg.inv(own + information)
        by_prior = np.einsum("kij,kj->ki", own, self.means)
        right = by_prior + drawn
        means = np.einsum("kij,kj->ki", posterior, right)
        log = np.sum(right * means, axis=1) - np.sum(by_prior * self.means, axis=1)
        log += np.linalg.slogdet(posterior)[1] - np.linalg.slogdet(self.covariances)[1]
        log = np.log(self.shares) + 0.5 * log
        odds = np.exp(log - log.max())
        likely = float(log.max() + np.log(odds.sum()))
        odds /= odds.sum()
        mean = odds @ means
        off = means - mean
        covariance = np.einsum("k,kij->ij", odds, posterior + off[:, :, None] * off[:, None])
        return mean, covariance, likely

    def _measured(
        self, along: FloatArray, value: float, sigma: FloatArray | float
    ) -> EarthFieldPrior:
        """Return the mixture, given measured components along unit vectors (k, 2), µT."""
        variance = np.maximum(np.square(sigma), 1e-6) * np.ones(len(self.shares))
        gain = np.einsum("kij,kj->ki", self.covariances, along)
        total = np.sum(gain * along, axis=1) + variance
        off = value - np.sum(self.means * along, axis=1)
        log = np.log(self.shares) - 0.5 * (off**2 / total + np.log(total))
        shares = np.exp(log - log.max())
        gain_over = gain / total[:, None]
        return EarthFieldPrior(
            shares / shares.sum(),
            self.means + gain_over * off[:, None],
            self.covariances - gain_over[:, :, None] * gain[:, None],
        )
