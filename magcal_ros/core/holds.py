"""Whether a calibration still holds: the corrected field of a fresh turn, looked at from all sides.

A field that is corrected well has the same strength, the same dip and the same level part at
every heading, and its yaw turns as the gyro does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from magcal_ros.core.arrays import FloatArray, IntArray
from magcal_ros.core.attitude import unit, wrap_angle, yaw_from_up_and_field
from magcal_ros.core.calibration import Calibration
from magcal_ros.core.correction import Correction
from magcal_ros.core.coverage import LARGEST_GYRO_BIAS, Coverage
from magcal_ros.core.up import carried_up
from magcal_ros.core.window import Window

BINS = 36
LARGEST_GAP = 0.5
"""Seconds between two samples over which the gyro is not carried."""

LONGEST_PIECE = 60.0
"""Seconds over which the gyro's drift is taken as steady."""

STEEPEST_NOSE = 0.75
"""Squared share of up along body x (60°) beyond which yaw is not compared."""


class State(str, Enum):
    """From best to worst."""

    HOLDS = "holds"
    DOUBTFUL = "doubtful"
    STALE = "stale"

    @property
    def rank(self) -> int:
        """Zero for the best."""
        return list(State).index(self)


@dataclass(frozen=True)
class Bound:
    """How large a figure may be.

    Parameters
    ----------
    figure : str
        Name.
    holds, doubtful : float
        Largest values of these states in the unit people see; beyond, it is stale.
    unit : str
        "°" or "%".
    words : str
        What the figure is.
    remedy : str
        What a larger one means.
    """

    figure: str
    holds: float
    doubtful: float
    unit: str
    words: str
    remedy: str

    def find(self, before: float, after: float) -> Finding:
        """Grade a figure, given in SI units for the raw and the corrected field."""
        scale = 180.0 / math.pi if self.unit == "°" else 100.0
        value = after * scale
        state = State.HOLDS if value <= self.holds else State.DOUBTFUL
        if not value <= self.doubtful:
            state = State.STALE
        words = f"{self.words} {value:.3g}{self.unit}"
        if state is not State.HOLDS:
            words += f" (want {self.holds:g}{self.unit} or less): {self.remedy}"
        return Finding(self.figure, state, before * scale, value, self.unit, self.words, words)


@dataclass(frozen=True)
class Finding:
    """One figure, before and after the correction, graded and put into words."""

    figure: str
    state: State
    before: float
    after: float
    unit: str
    name: str
    words: str


@dataclass(frozen=True)
class Check:
    """Whether a calibration holds.

    Parameters
    ----------
    findings : tuple of Finding
        Everything that was looked at.
    not_shown : tuple of str
        What this recording could not show.
    """

    findings: tuple[Finding, ...]
    not_shown: tuple[str, ...]

    @property
    def state(self) -> State:
        """The worst state among the findings."""
        return max((f.state for f in self.findings), key=lambda state: state.rank)

    @property
    def summary(self) -> str:
        """One sentence."""
        causes = "; ".join(f.words for f in self.findings if f.state is self.state)
        if self.state is State.HOLDS:
            return f"The calibration holds: {causes}."
        if self.state is State.DOUBTFUL:
            return f"The calibration is doubtful: {causes}."
        return f"The calibration is stale, calibrate again: {causes}."


MOVED = "the hard iron has changed, or the field is distorted here"

BOUNDS: tuple[Bound, ...] = (
    Bound("heading_swing", 4.0, 7.0, "°", "heading swing that the level field betrays", MOVED),
    Bound(
        "gyro_compass_rms",
        4.0,
        7.0,
        "°",
        "gyro against compass",
        "the compass does not turn as the robot does",
    ),
    Bound("strength_spread", 3.0, 6.0, "%", "field strength varies with heading by", MOVED),
    Bound("dip_spread", 2.0, 4.0, "°", "angle between field and up varies with heading by", MOVED),
    Bound(
        "strength_offset",
        5.0,
        15.0,
        "%",
        "field strength is off the calibrated one by",
        "another place, or the hard iron along the turn's axis has changed",
    ),
    Bound(
        "dip_offset",
        3.0,
        8.0,
        "°",
        "inclination is off the calibrated one by",
        "another place, or the hard iron along the turn's axis has changed",
    ),
)
"""The one table of bounds."""

NO_GYRO = "whether the compass turns as the robot does: there is no gyro"
NO_YAW = "an error of the yaw that is the same at every heading"


def check(window: Window, calibration: Calibration) -> Check:
    """Look at a fresh turn through a calibration.

    Parameters
    ----------
    window : Window
        Samples of at least a good part of a turn.
    calibration : Calibration
        What is to be tried.

    Returns
    -------
    Check
    """
    up = up_of(window)
    heading = yaw_from_up_and_field(up, calibration.correction.apply(window.field))
    before, after = (
        figures(window, up, heading, correction, calibration)
        for correction in (Correction.identity(), calibration.correction)
    )
    findings = tuple(b.find(before[b.figure], after[b.figure]) for b in BOUNDS if b.figure in after)
    return Check(findings, (NO_YAW,) if "gyro_compass_rms" in after else (NO_YAW, NO_GYRO))


def figures(
    window: Window,
    up: FloatArray,
    heading: FloatArray,
    correction: Correction,
    calibration: Calibration,
) -> dict[str, float]:
    """Measure the field of a window after a correction.

    Parameters
    ----------
    window : Window
        The samples.
    up : ndarray, shape (n, 3)
        Unit, body axes.
    heading : ndarray, shape (n,)
        Where the robot looked as far as is known, radians.
    correction : Correction
        What is tried.
    calibration : Calibration
        Tells strength and inclination.

    Returns
    -------
    dict of str to float
        As in `BOUNDS`; radians and ratios.
    """
    field = correction.apply(window.field)
    size = np.linalg.norm(field, axis=1)
    rise = np.sum(field * up, axis=1)
    level = np.sqrt(np.maximum(size**2 - rise**2, 0.0))
    dip = np.arctan2(-rise, level)
    around = (np.mod(heading, math.tau) * (BINS / math.tau)).astype(np.int64) % BINS
    found = {
        "heading_swing": _spread(level, around) / max(float(level.mean()), 1e-12),
        "strength_spread": _spread(size, around) / calibration.strength,
        "dip_spread": _spread(dip, around),
        "strength_offset": abs(float(size.mean()) / calibration.strength - 1.0),
        "dip_offset": abs(float(dip.mean()) - calibration.inclination),
    }
    pieces = _pieces(window, up)
    if window.angular_rate is not None and pieces:
        yaw = yaw_from_up_and_field(up, field)
        found["gyro_compass_rms"] = _gyro_compass_rms(window, up, yaw, heading, pieces)
    return found


def up_of(window: Window) -> FloatArray:
    """Return up at each sample, carried by the gyro where samples follow each other closely."""
    if window.angular_rate is None:
        return unit(window.specific_force)
    gaps = np.flatnonzero(np.diff(window.time) > LARGEST_GAP)
    pieces = np.split(np.arange(len(window)), gaps + 1)
    return np.concatenate([carried_up(window.take(rows)) for rows in pieces])


def _spread(values: FloatArray, around: IntArray) -> float:
    """Return how the values' mean varies with the heading, root mean square.

    The mean over each heading takes the noise out of it, which the spread is not about.
    """
    counts = np.bincount(around, minlength=BINS)
    filled = counts >= min(3, int(counts.max()))
    means = np.bincount(around, values, BINS)[filled] / counts[filled]
    return float(means.std())


def _gyro_compass_rms(
    window: Window, up: FloatArray, yaw: FloatArray, heading: FloatArray, pieces: list[IntArray]
) -> float:
    """Return the rms of compass less gyro."""
    assert window.angular_rate is not None
    across = np.maximum(1.0 - up[:, 0] ** 2, 1.0 - STEEPEST_NOSE)
    rate = np.sum(window.angular_rate[:, 1:] * up[:, 1:], axis=1) / across
    steps = 0.5 * np.diff(window.time) * (rate[1:] + rate[:-1])
    turned = np.concatenate([[0.0], np.cumsum(steps)])
    error = compass_less_gyro(window.time, yaw, turned, heading, pieces)
    return math.sqrt(float(np.mean(error**2)))


def compass_less_gyro(
    time: FloatArray,
    yaw: FloatArray,
    turned: FloatArray,
    heading: FloatArray,
    pieces: list[IntArray],
) -> FloatArray:
    """Return compass less gyro, one offset a piece and one steady bias removed.

    Over a single turn an error that comes and goes with the heading looks like a bias in part:
    the bias is found beside two harmonics of the heading, and only the bias is removed. Less
    than a turn cannot tell them apart.

    Parameters
    ----------
    time, yaw, turned, heading : ndarray, shape (n,)
        Seconds; radians by the compass, by the gyro, and where the robot looked as far as known.
    pieces : list of ndarray of int
        Rows over which the gyro was carried.

    Returns
    -------
    ndarray
        Radians in (-pi, pi], the pieces one after another.
    """
    orders = (1, 2) if Coverage.of(heading).is_complete else ()
    waves = [wave(k * heading) for k in orders for wave in (np.cos, np.sin)]
    basis = np.column_stack([time, *waves])
    design, residuals = [], []
    for rows in pieces:
        residual = np.unwrap(yaw[rows] - turned[rows])
        residuals.append(residual - residual.mean())
        design.append(basis[rows] - basis[rows].mean(axis=0))
    a, b = np.concatenate(design), np.concatenate(residuals)
    bias = float(np.linalg.lstsq(a, b, rcond=None)[0][0])
    bias = min(max(bias, -LARGEST_GYRO_BIAS), LARGEST_GYRO_BIAS)
    return wrap_angle(b - bias * a[:, 0])


def _pieces(window: Window, up: FloatArray) -> list[IntArray]:
    """Return the stretches of rows over which gyro and compass are compared."""
    good = up[:, 0] ** 2 < STEEPEST_NOSE
    spell = np.floor((window.time - window.time[0]) / LONGEST_PIECE)
    parted = (np.diff(window.time) > LARGEST_GAP) | (np.diff(spell) > 0) | ~good[1:] | ~good[:-1]
    pieces = np.split(np.arange(len(window)), np.flatnonzero(parted) + 1)
    return [rows for rows in pieces if len(rows) > 2]
