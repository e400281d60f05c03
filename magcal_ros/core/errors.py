"""The package's exceptions; their texts say what happened, and what to do next."""

from __future__ import annotations

from enum import Enum


class MagcalError(Exception):
    """Base class of the exceptions of this package; its text is meant for the user."""


class UsageError(MagcalError):
    """A request is impossible or unclear; the text lists what can be requested."""


class Reason(str, Enum):
    """Why a window of samples cannot be turned into a calibration."""

    TOO_FEW_SAMPLES = "too_few_samples"
    NOT_FINITE = "not_finite"
    TOO_SLOW = "too_slow"
    NO_MOTION = "no_motion"
    ARC_TOO_SHORT = "arc_too_short"
    FIELD_NOT_ON_A_PLANE = "field_not_on_a_plane"
    FIELD_ON_A_LINE = "field_on_a_line"
    FIELD_ABSENT = "field_absent"
    GRAVITY_ABSENT = "gravity_absent"
    CIRCLE_TOO_SMALL = "circle_too_small"
    FIELD_TOO_STEEP = "field_too_steep"
    AXIS_HORIZONTAL = "axis_horizontal"
    AXIS_ALONG_FIELD = "axis_along_field"
    AXES_DISAGREE = "axes_disagree"
    NO_SOLUTION = "no_solution"
    AMBIGUOUS = "ambiguous"
    PLANAR = "planar"
    TURNS_DISAGREE = "turns_disagree"
    HEADING_CONTRADICTED = "heading_contradicted"


class Refusal(MagcalError):
    """The samples do not determine a calibration; the reason is for programs."""

    def __init__(self, reason: Reason, message: str) -> None:
        super().__init__(message)
        self.reason = reason

    def __reduce__(self) -> tuple[type[Refusal], tuple[Reason, str]]:
        """Return the parts that pickle needs."""
        return type(self), (self.reason, str(self))


def in_words(error: Exception) -> str:
    """Return the text of an error of this package; of another error also its type."""
    return str(error) if isinstance(error, MagcalError) else repr(error)
