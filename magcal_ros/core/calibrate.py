"""From a window to a judged calibration: the one way that node and command line both go."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import numpy as np

from magcal_ros.core.calibration import Calibration
from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.estimate import Estimate
from magcal_ros.core.figures import predicted_heading_sigma
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.several.result import Several
from magcal_ros.core.units import likely_field_unit
from magcal_ros.core.verdict import Verdict, judge, refuse
from magcal_ros.core.window import Window

Fit = Callable[[Window, Knowledge], Estimate]

METHODS = ("maximum_likelihood", "design_tip", "ellipsoid", "min_max")
"""Names that `find_method` knows, the recommended one first."""

JOINS = METHODS[0]
"""The method that joins turns."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came of a window.

    Parameters
    ----------
    verdict : Verdict
        How it is judged.
    calibration : Calibration or None
        What was found, whatever the verdict; None if nothing could be found.
    estimate : Estimate or None
        The method's own result.
    reason : Reason or None
        Why nothing could be found.
    several : Several or None
        Where turns were put together: what became of each, what is shown, and what comes next.
    """

    verdict: Verdict
    calibration: Calibration | None = None
    estimate: Estimate | None = None
    reason: Reason | None = None
    several: Several | None = None

    @classmethod
    def refused(cls, refusal: Refusal) -> Outcome:
        """Return what comes of samples that cannot carry a calibration."""
        return cls(refuse(refusal), reason=refusal.reason)


def find_method(name: str) -> Fit:
    """Return the method of a name, imported when it is asked for.

    Raises
    ------
    ValueError
        If there is none of that name.
    """
    if name not in METHODS:
        raise ValueError(f"there is no method {name!r}; choose one of {', '.join(METHODS)}")
    module = importlib.import_module(f"magcal_ros.core.methods.{name}")
    return cast("Fit", module.fit)


def calibrate(window: Window, knowledge: Knowledge, method: str = METHODS[0]) -> Outcome:
    """Fit a window and judge the result.

    Parameters
    ----------
    window : Window
        The samples of one turn.
    knowledge : Knowledge
        What is known beforehand.
    method : str
        One of `METHODS`.

    Returns
    -------
    Outcome
        Never raises for bad data: a refusal is a verdict.
    """
    try:
        estimate = find_method(method)(window, knowledge)
    except Refusal as refusal:
        return Outcome.refused(explained(refusal, window))
    return judged(estimate, knowledge, window)


def judged(estimate: Estimate, knowledge: Knowledge, window: Window) -> Outcome:
    """Judge an estimate; `window` holds the samples that its residuals are of."""
    verdict = judge(estimate, knowledge, window)
    return Outcome(verdict, Calibration.from_estimate(estimate, verdict), estimate)


def explained(refusal: Refusal, window: Window) -> Refusal:
    """Add the field's likely unit to a refusal: a wrong one upsets every check before it shows."""
    if len(window) == 0:
        return refusal
    hint = likely_field_unit(float(np.median(np.linalg.norm(window.field, axis=1))))
    return Refusal(refusal.reason, f"{str(refusal).rstrip('.')}; {hint}") if hint else refusal


def predicted_sigma(window: Window, knowledge: Knowledge, method: str = METHODS[0]) -> float:
    """Return the heading sigma on the level that a fit of this window would have, radians.

    Infinite where there is no fit.
    """
    outcome = calibrate(window, knowledge, method)
    if outcome.estimate is None:
        return math.inf
    return predicted_heading_sigma(outcome.estimate, 0.0)
