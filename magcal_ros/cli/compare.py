"""Every method on one recording, side by side."""

from __future__ import annotations

import math

from magcal_ros.core.calibrate import METHODS, Outcome, calibrate_by
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import common_figures
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.window import Window

HEADER = (
    f"{'method':20s}{'verdict':>10s}{'hard iron x, y, z (µT)':>28s}{'heading ±':>11s}"
    f"{'residual':>10s}"
)


def compare_methods(window: Window | None, knowledge: Knowledge) -> str:
    """Return a table of what each method makes of a window, and why some make nothing."""
    if window is None:
        return "no method has anything to work on: the recording holds no usable turn"
    outcomes = {method: calibrate_by(window, knowledge, method) for method in METHODS}
    rows = [HEADER, *(_row(method, outcome) for method, outcome in outcomes.items()), ""]
    rows += [f"{method}: {outcome.verdict.summary}" for method, outcome in outcomes.items()]
    return "\n".join(rows)


def _row(method: str, outcome: Outcome) -> str:
    accepted = "accepted" if outcome.verdict.accepted else "refused"
    estimate = outcome.estimate
    if estimate is None:
        return f"{method:20s}{accepted:>10s}{'-':>28s}{'-':>11s}{'-':>10s}"
    iron = ", ".join(f"{value * 1e6:.2f}" for value in estimate.correction.hard_iron)
    figures = common_figures(estimate) | dict(estimate.figures)
    sigma = f"{math.degrees(figures[Figure.HEADING_SIGMA]):.2f}°"
    residual = f"{100.0 * figures[Figure.RESIDUAL_RATIO]:.1f}%"
    return f"{method:20s}{accepted:>10s}{iron:>28s}{sigma:>11s}{residual:>10s}"
