"""A calibration from a drive as it is remembered, by the smoother (doc/smoother.md, "Drives")."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magcal_ros.core.calibration.calibration import Estimate
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.methods.checks import refuse_empty
from magcal_ros.core.methods.maximum_likelihood import check, estimate_of
from magcal_ros.core.samples.drive_log import DriveLog, log_of
from magcal_ros.core.samples.window import Window
from magcal_ros.core.smoother.drives import MIRRORED, check_length, drive_nodes
from magcal_ros.core.smoother.kinds_of_motion import smooth

METHOD = "smoother"
FEWEST_SAMPLES = 20


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
    refuse_empty(window, FEWEST_SAMPLES)
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
    check_length(drive_nodes(log, knowledge.mounting.to_body))
    window = log.window if window is None else window
    try:
        found = smooth(log, knowledge)
    except Refusal as refusal:
        raise Refusal(Reason.AXES_DISAGREE, MIRRORED) from refusal
    estimate = estimate_of(found, window, knowledge)
    check(found, estimate, window, knowledge)
    figures = dict(estimate.figures)
    speed = found.nodes.speed
    if speed is not None:
        figures[Figure.METRES] = float(np.nansum(np.abs(speed[:-1]) * found.nodes.seconds))
    return replace(estimate, method=METHOD, figures=figures)
