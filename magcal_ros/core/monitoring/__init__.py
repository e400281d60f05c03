"""Whether the calibration in force still holds."""

from magcal_ros.core.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    """
    change: ONCE Record check_beside_chance compass_minus_gyro fit_harmonics harmonics
    monitor: CalibrationMonitor MonitorResult MonitorTuning
    recheck: NO_GYRO ON_A_DRIVE RECHECK_BOUNDS STATES expected_field
    recorded_course: check_by_course course_fault
    """,
)
