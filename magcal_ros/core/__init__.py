"""Calibration and heading without ROS: pure numpy, and what a user of the package imports.

Names are loaded when they are asked for, so that a node starts without a method's libraries.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from magcal_ros.core.assessment.grading import Grade
    from magcal_ros.core.assessment.verdict import Verdict
    from magcal_ros.core.calibrate import METHODS, Outcome, calibrate, calibrate_turns
    from magcal_ros.core.calibration.calibration import Calibration, Estimate, Installation
    from magcal_ros.core.calibration.correction import Correction
    from magcal_ros.core.calibration.figure import Figure
    from magcal_ros.core.errors import MagcalError, Reason, Refusal
    from magcal_ros.core.heading.compass import Compass
    from magcal_ros.core.knowledge import Belief, Knowledge, Mounting, ReferenceField, SoftIron
    from magcal_ros.core.monitoring.recheck import Recheck, check
    from magcal_ros.core.samples.window import Window

__all__ = [
    "METHODS",
    "Belief",
    "Calibration",
    "Compass",
    "Correction",
    "Estimate",
    "Figure",
    "Grade",
    "Installation",
    "Knowledge",
    "MagcalError",
    "Mounting",
    "Outcome",
    "Reason",
    "Recheck",
    "ReferenceField",
    "Refusal",
    "SoftIron",
    "Verdict",
    "Window",
    "calibrate",
    "calibrate_turns",
    "check",
]

_ROOMS = {
    "assessment.grading": ("Grade",),
    "assessment.verdict": ("Verdict",),
    "calibrate": ("METHODS", "Outcome", "calibrate", "calibrate_turns"),
    "calibration.calibration": ("Calibration", "Estimate", "Installation"),
    "calibration.correction": ("Correction",),
    "calibration.figure": ("Figure",),
    "errors": ("MagcalError", "Reason", "Refusal"),
    "heading.compass": ("Compass",),
    "knowledge": ("Belief", "Knowledge", "Mounting", "ReferenceField", "SoftIron"),
    "monitoring.recheck": ("Recheck", "check"),
    "samples.window": ("Window",),
}
_HOMES = {name: room for room, names in _ROOMS.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _Face(ModuleType):
    """Keeps the function `calibrate`, which the import of the module of that name would replace."""

    @property
    def calibrate(self) -> Any:
        return __getattr__("calibrate")

    @calibrate.setter
    def calibrate(self, module: ModuleType) -> None:
        """Ignore the import system's binding; the module stays in `sys.modules`."""


sys.modules[__name__].__class__ = _Face
