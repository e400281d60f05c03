"""Self-calibration while driving: candidates, their probation, the return to an old calibration."""

from magcal_ros.core.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    """
    drive_replay: DrivePath DriveReplay path_along replay_drive
    jobs: CalibrationStep CandidateKind Decision DecisionKind DriveCandidate DriveJob DriveResult
        HeldOutComparison Mode SELF_CALIBRATION difference
    motor_learning: MotorLearning
    self_calibration: SelfCalibration TRIAL
    worker: compare_held_out examine_drive
    """,
)
