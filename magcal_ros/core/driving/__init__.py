"""What a drive shows: the vehicle's acceleration, its front, and the compass against course."""

from magcal_ros.core.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    """
    chords: Chord CourseOffset fit_course_offset
    driving_tuning: COURSE SPEED SpeedSource
    mounting_yaw: MountingYaw SpeedFault fault_words
    speed: SpeedTrack Speedometer
    travel_estimator: TravelEstimator
    """,
)
