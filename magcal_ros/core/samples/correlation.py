"""The inefficiency factor: how many samples make one independent sample.

(Sokal, "Monte Carlo methods in statistical mechanics", 1997; doc/estimator.md, section 6.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray


@dataclass(frozen=True)
class CorrelationTuning:
    """How far correlation is looked for.

    Parameters
    ----------
    longest_lag : int
        Lags up to this fraction of the samples are looked at.
    least_power : float
        Mean square of a whitened residual vector below which the noise is taken as white.
    """

    longest_lag: int = 8
    least_power: float = 1.0


CORRELATION = CorrelationTuning()


def inefficiency_factor(residual: FloatArray, weight: FloatArray) -> float:
    """Return kappa = 1 + 2 sum of autocorrelations of whitened residuals.

    Real residuals are correlated in time; taken as independent, their number overrules every
    prior. The sum runs over the first lags whose correlation stands out of chance.

    Parameters
    ----------
    residual : ndarray, shape (n, k)
        Whitened residuals in the order of time.
    weight : ndarray, shape (n,)
        Samples with little weight are left out.

    Returns
    -------
    float
        One or more.
    """
    n = len(residual)
    size = 1 << (2 * n - 1).bit_length()
    lags = max(2, n // CORRELATION.longest_lag)
    spectrum = np.abs(np.fft.rfft(residual * weight[:, None], size, axis=0)) ** 2
    products = np.fft.irfft(spectrum.sum(axis=1), size)[:lags]
    pairs = np.fft.irfft(np.abs(np.fft.rfft(weight, size)) ** 2, size)[:lags]
    if products[0] <= 0.0:
        return 1.0
    mean_products = products / np.maximum(pairs, 1.0)
    # Residuals far below the noise that is assumed say nothing of its correlation.
    rho = (mean_products / max(float(mean_products[0]), CORRELATION.least_power))[1:]
    chance = 2.0 / np.sqrt(3.0 * max(float(weight.sum()), 1.0))
    below = np.flatnonzero(rho < chance)
    first_quiet = int(below[0]) if len(below) else len(rho)
    return float(max(1.0, 1.0 + 2.0 * rho[:first_quiet].sum()))
