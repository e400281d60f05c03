"""Calibration and heading without ROS, by numpy and scipy alone: what users of Python import.

Names are loaded when they are asked for, so that a node starts without a method's libraries.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

from magcal_ros.core.lazy_names import lazy_names

if TYPE_CHECKING:
    from magcal_ros.core.assessment.grading import Grade as Grade
    from magcal_ros.core.assessment.verdict import Verdict as Verdict
    from magcal_ros.core.calibrate import METHODS as METHODS
    from magcal_ros.core.calibrate import Outcome as Outcome
    from magcal_ros.core.calibrate import calibrate as calibrate
    from magcal_ros.core.calibrate import calibrate_turns as calibrate_turns
    from magcal_ros.core.calibration.calibration import Calibration as Calibration
    from magcal_ros.core.calibration.calibration import Estimate as Estimate
    from magcal_ros.core.calibration.calibration import Installation as Installation
    from magcal_ros.core.calibration.correction import Correction as Correction
    from magcal_ros.core.calibration.figure import Figure as Figure
    from magcal_ros.core.errors import MagcalError as MagcalError
    from magcal_ros.core.errors import Reason as Reason
    from magcal_ros.core.errors import Refusal as Refusal
    from magcal_ros.core.heading.compass import Compass as Compass
    from magcal_ros.core.knowledge import Belief as Belief
    from magcal_ros.core.knowledge import Knowledge as Knowledge
    from magcal_ros.core.knowledge import Mounting as Mounting
    from magcal_ros.core.knowledge import ReferenceField as ReferenceField
    from magcal_ros.core.knowledge import SoftIron as SoftIron
    from magcal_ros.core.monitoring.recheck import Recheck as Recheck
    from magcal_ros.core.monitoring.recheck import check as check
    from magcal_ros.core.samples.window import Window as Window

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    """
    assessment.grading: Grade
    assessment.verdict: Verdict
    calibrate: METHODS Outcome calibrate calibrate_turns
    calibration.calibration: Calibration Estimate Installation
    calibration.correction: Correction
    calibration.figure: Figure
    errors: MagcalError Reason Refusal
    heading.compass: Compass
    knowledge: Belief Knowledge Mounting ReferenceField SoftIron
    monitoring.recheck: Recheck check
    samples.window: Window
    """,
)


class _Face(ModuleType):
    """Keeps the function `calibrate`, which the import of the module of that name would replace."""

    @property
    def calibrate(self) -> Any:
        return __getattr__("calibrate")

    @calibrate.setter
    def calibrate(self, module: ModuleType) -> None:
        """Ignore the import system's binding; the module stays in `sys.modules`."""


sys.modules[__name__].__class__ = _Face
