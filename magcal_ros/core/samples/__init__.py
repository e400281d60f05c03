"""Samples of the sensors: streams, paired windows, and their faults."""

from magcal_ros.core.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    """
    battery: battery_of with_one_reference
    bursts: bursts_in_words spread_bursts spread_each
    coverage: BINS Coverage thin_to_equal_angles yaw_progress
    drive_log: DriveRecorder log_of
    rest: COLUMNS GyroAtRest rests_around
    spikes: spikes_replaced
    samples_tuning: STREAMS
    streams: DropReason FieldSample ImuSample Pair Pairer PositionSample SpeedSample StampGuard
        Streams VelocitySample
    units: InputCounts complaints gravity_in_body gravity_size likely_acceleration_unit
        likely_field_unit unit_by_strength was_turned_over
    window: SensorLog Steps working_axes
    """,
)
