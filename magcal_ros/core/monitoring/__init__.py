"""Whether the calibration in force still holds."""

from magcal_ros.core.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    """
    change: check_beside_chance
    recheck: NO_GYRO ON_A_DRIVE RECHECK_BOUNDS STATES expected_field
    """,
)
