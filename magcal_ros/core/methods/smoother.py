"""A calibration from a drive without a turn: the smoother (doc/smoother.md, "Long drives")."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from magcal_ros.core.calibration.calibration import Estimate, Installation
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.methods.checks import refuse_empty
from magcal_ros.core.samples.rest import bias_at_rest
from magcal_ros.core.samples.window import Window
from magcal_ros.core.smoothing.drive_model import PITCH, ROLL
from magcal_ros.core.smoothing.fit import DriveFit, fit_nodes
from magcal_ros.core.smoothing.log import DriveLog, log_of
from magcal_ros.core.smoothing.nodes import MICROTESLA
from magcal_ros.core.smoothing.tuning import TUNING

METHOD = "smoother"


@dataclass(frozen=True)
class DriveScreening:
    """Bounds beyond which a drive is refused."""

    fewest_samples: int = 20
    fewest_sectors: int = 4
    """Of twelve of heading."""
    largest_street: float = 2.5
    largest_noise: float = 2.5
    """Over the usual: beyond them the field does not follow gyro and gravity."""


SCREENING = DriveScreening()


def fit(window: Window, knowledge: Knowledge = Knowledge()) -> Estimate:
    """Find all twelve numbers from the samples of a drive.

    Parameters
    ----------
    window : Window
        Paired samples of a drive, with a gyro.
    knowledge : Knowledge

    Returns
    -------
    Estimate

    Raises
    ------
    Refusal
        If the drive cannot carry a calibration; the message says what to do next.
    """
    refuse_empty(window, SCREENING.fewest_samples)
    if window.angular_rate is None:
        raise Refusal(
            Reason.NO_SOLUTION,
            "a drive without a turn needs a gyro; turn the robot once instead, or connect one",
        )
    return fit_log(log_of(window), knowledge, window)


def fit_log(log: DriveLog, knowledge: Knowledge, window: Window | None = None) -> Estimate:
    """Find all twelve numbers from the log of a drive.

    Parameters
    ----------
    log : DriveLog
    knowledge : Knowledge
    window : Window, optional
        The samples that residuals are told of; by default the rows of the log.

    Raises
    ------
    Refusal
        As `fit`.
    """
    bias = bias_at_rest(log.time, log.field, log.rate)
    if bias is not None:
        log = replace(log, rate=log.rate - bias)
    found = fit_nodes(log.nodes(knowledge.mounting.to_body), knowledge)
    _check(found)
    return _estimate(found, log, knowledge, log.window if window is None else window)


def _check(found: DriveFit) -> None:
    problem, sizes = found.smoothed.problem, found.smoothed.problem.sizes
    worst = max(sizes.street / SCREENING.largest_street, sizes.noise / SCREENING.largest_noise)
    if worst > 1.0:
        field = max(problem.street, problem.noise)
        raise Refusal(
            Reason.AXES_DISAGREE,
            f"along the drive the field deviates by {field:.0f} µT from where gyro and gravity turn"
            " it; check that the axes of both sensors belong together, and drive away from iron",
        )
    if found.sectors < SCREENING.fewest_sectors:
        raise Refusal(
            Reason.ARC_TOO_SHORT,
            f"the drive went to {found.sectors} of 12 headings only; drive on, round a block",
        )


def _estimate(found: DriveFit, log: DriveLog, knowledge: Knowledge, window: Window) -> Estimate:
    shared, twelve = found.smoothed.unknowns.shared, found.twelve
    belongs = np.searchsorted(found.nodes.time, window.time).clip(0, len(found.nodes) - 1)
    residual = found.smoothed.here.field @ knowledge.mounting.matrix.T / MICROTESLA
    weight = found.smoothed.here.weights[0]
    strength = float(np.linalg.norm(twelve.field))
    steps = np.diff(window.field, axis=0)
    noise = float(np.median(np.abs(steps))) / 0.954 if len(steps) else 0.0
    usual = float(np.median(np.linalg.norm(log.force, axis=1)))
    return Estimate(
        method=METHOD,
        correction=twelve.correction,
        covariance=twelve.covariance,
        installation=Installation(float(shared[ROLL]), float(shared[PITCH])),
        axis=unit(np.median(log.force, axis=0)),
        arc=math.tau * found.sectors / 12.0,
        strength=strength,
        inclination=math.asin(-float(twelve.field[2]) / strength),
        noise_field=max(noise, 1e-9),
        noise_up=float(np.median(np.abs(np.diff(log.force, axis=0)))) / 0.954 / usual,
        inliers=weight[belongs] > TUNING.believed,
        residual=residual[belongs],
        figures=_figures(found, knowledge, log),
        message="converged" if found.smoothed.converged else "out of rounds",
    )


def _figures(found: DriveFit, knowledge: Knowledge, log: DriveLog) -> dict[Figure, float]:
    street = found.smoothed.problem.street / MICROTESLA
    figures = {
        Figure.HEADINGS_DRIVEN: float(found.sectors),
        Figure.DRIVING_TIME: found.seconds,
        Figure.STREET: street,
        Figure.LOCAL_FIELD: street,
        Figure.NOT_CONVERGED: float(not found.smoothed.converged),
        Figure.ITERATIONS: float(found.smoothed.rounds),
        Figure.SOFT_IRON: 1.0,
    }
    if np.isfinite(log.speed).mean() > 0.5:
        figures[Figure.METRES] = found.metres
    strength = knowledge.reference.strength
    if not (strength.is_unknown or strength.is_exact):
        figures[Figure.LEVEL_DEVIATION] = found.level_pull
    return figures
