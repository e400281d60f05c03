"""Whether the gyro that controls a turn measures it, tested by the field in a quarter turn.

A gyro that hangs or is saturated still gives numbers. The level field of a robot that turned by
an angle goes as far round an unknown circle: the angle of the gyro and the one that was commanded
are both fitted to it, each free by the factor that a slipping wheel or a field bent by iron
explains, and the gyro is rejected if only the other one fits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray


@dataclass(frozen=True)
class ObjectionTuning:
    """When the field contradicts the gyro.

    Attributes
    ----------
    spans : tuple[float, float, float]
        Radians that gyro or commands have turned before a test; larger spans show more.
    disagree : float
        Share of the span by which gyro and commands must differ before the field is tested.
    factors : tuple[float, float, float]
        How far an angle may be off in scale and still be taken for the true one.
    clearly_worse : float
        Times the squared misfit of the other angle, from which an angle is rejected.
    smallest_radius : float
        Tesla. A field on a smaller circle has not turned.
    most_rows : int
        Samples that are looked at, evenly over the span.
    """

    spans: tuple[float, float, float] = (
        math.radians(75.0),
        math.radians(150.0),
        math.radians(300.0),
    )
    disagree: float = 0.38
    factors: tuple[float, float, float] = (0.85, 1.0, 1.2)
    clearly_worse: float = 1.4
    smallest_radius: float = 1.5e-6
    most_rows: int = 200


TUNING = ObjectionTuning()


def objection_to_gyro(turned: FloatArray, commanded: FloatArray, level: FloatArray) -> str:
    """Say how the field contradicts the gyro; empty if it does not, or nothing is known yet.

    Parameters
    ----------
    turned, commanded : ndarray, shape (n,)
        Radians by the gyro, and by the commands, left positive.
    level : ndarray, shape (n, 2)
        The field in two level axes, tesla.
    """
    for span in TUNING.spans:
        rows = _last(span, turned, commanded)
        if len(rows) < 10:
            return ""
        found = _objection(turned[rows], commanded[rows], level[rows], span)
        if found:
            return found
    return ""


def _objection(by_gyro: FloatArray, by_command: FloatArray, level: FloatArray, span: float) -> str:
    gyro_span, told_span = float(np.ptp(by_gyro)), float(np.ptp(by_command))
    shown, told = math.degrees(gyro_span), math.degrees(told_span)
    misfit, radius = _best_fit(by_gyro, level)
    if gyro_span >= span and radius < TUNING.smallest_radius:
        return f"the gyro shows {shown:.0f}° of turn, but the field did not change"
    if np.ptp(by_gyro - by_command) < TUNING.disagree * max(gyro_span, told_span):
        return ""
    other, radius = _best_fit(by_command, level)
    if radius > TUNING.smallest_radius and misfit > TUNING.clearly_worse * other:
        return (
            f"the gyro shows {shown:.0f}°, but the field turned with the {told:.0f}° that were "
            "commanded"
        )
    return ""


def fit_circle_by_angle(turned: FloatArray, level: FloatArray) -> tuple[float, float]:
    """Fit c + R(-turned) v to a level field by least squares, with c and v free.

    Parameters
    ----------
    turned : ndarray, shape (n,)
        Radians to the left.
    level : ndarray, shape (n, 2)
        Tesla.

    Returns
    -------
    float, float
        The sum of squares that is left, T², and the length of v, T.
    """
    cosine, sine = np.cos(turned), np.sin(turned)
    one, none = np.ones_like(turned), np.zeros_like(turned)
    design = np.concatenate(
        [
            np.column_stack([cosine, sine, one, none]),
            np.column_stack([-sine, cosine, none, one]),
        ]
    )
    observed = np.concatenate([level[:, 0], level[:, 1]])
    found = np.linalg.lstsq(design, observed, rcond=None)[0]
    return float(np.sum((observed - design @ found) ** 2)), float(math.hypot(found[0], found[1]))


def _best_fit(turned: FloatArray, level: FloatArray) -> tuple[float, float]:
    """Return mean square misfit (T²) and radius (T) of the best of the allowed scales."""
    total, radius = min(fit_circle_by_angle(factor * turned, level) for factor in TUNING.factors)
    return total / (2.0 * len(turned)), radius


def _last(span: float, turned: FloatArray, commanded: FloatArray) -> FloatArray:
    """Return the newest rows in which either angle spans so much, evenly thinned; else none."""
    backward = slice(None, None, -1)
    spans = [
        np.maximum.accumulate(angle[backward]) - np.minimum.accumulate(angle[backward])
        for angle in (turned, commanded)
    ]
    enough = np.flatnonzero(np.maximum(*spans) >= span)
    if not len(enough):
        return np.empty(0, dtype=int)
    count = int(enough[0]) + 1
    rows = np.linspace(len(turned) - count, len(turned) - 1, min(count, TUNING.most_rows))
    return np.unique(rows.round().astype(int))
