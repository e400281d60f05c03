"""Faults of the sensors: of each stream by itself, and of each sensor against the others."""

from magcal_ros.core.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    """
    axes_diagnosis: mount_of parameter_line
    axes_hypotheses: compare_axes gravity_misfit
    guide: Guide GuideStep
    health: alive_finding field_findings gravity_size_finding noise_findings repeats_finding
        stamps_finding stuck_axes
    prepared: prepare segment_of_log
    quirks: AK09916_IN_ICM20948 AK8963_IN_MPU9250 FIELD_POINTS_UP QUIRKS WRAP
    sensor_report: SensorReport examine examine_window refusal_by_sensors with_explanation
        wrong_axes
    turn_fit: fit_turn force_latency
    """,
)
