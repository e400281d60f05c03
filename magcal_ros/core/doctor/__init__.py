"""Faults of the sensors: of each stream by itself, and of each sensor against the others."""

from magcal_ros.core.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    """
    blame: mount_of parameter_line
    explanations: explain gravity_misfit
    guide: Guide GuideStep
    health: alive_finding field_findings gravity_size_finding repeats_finding stamps_finding
        stuck_axes
    latency: force_latency
    page: Page blamed_on_sensors examine examine_window wrong_axes
    prepared: prepare
    quirks: AK09916_IN_ICM20948 AK8963_IN_MPU9250 FIELD_POINTS_UP QUIRKS WRAP
    """,
)
