"""Self-calibration while driving: candidates, their probation, the return to an old calibration."""

from magcal_ros.core.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    """
    drive_replay: DrivePath DriveReplay examine_drive path_along ratio_on replay_drive
    jobs: CandidateKind Decision DecisionKind DriveCandidate DriveJob DriveResult Mode
        Watch difference reason_to_accept
    motor_learning: MotorLearning
    self_calibration: SelfCalibration
    self_calibration_tuning: SELF_CALIBRATION
    """,
)
