"""Self-calibration while driving: candidates, their probation, the return to an old calibration."""

from magcal_ros.core.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    """
    drive_replay: DrivePath DriveReplay path_along replay_drive
    jobs: CandidateKind Decision DecisionKind DriveCandidate DriveJob DriveResult Mode
        SELF_CALIBRATION difference reason_to_accept
    motor_learning: MotorLearning
    self_calibration: SelfCalibration
    watch: Watch
    worker: examine_drive ratio_on_later_data
    """,
)
