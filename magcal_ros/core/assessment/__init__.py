"""Grades of figures, bounds and verdicts."""

from magcal_ros.core.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    """
    bounds: DRIVE_BOUNDS HEADING_BOUNDS TURN_BOUNDS
    grading: Aspect Bound Check shown
    verdict: GYRO_UNUSED LEVEL_ONLY NO_GYRO NO_REFERENCE NO_YAW WHICH_WAY_UP judge refuse
    """,
)
