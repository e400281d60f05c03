"""Self-calibration while driving: candidates, their probation, the return to an old calibration."""

from magcal_ros.core.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    """
    jobs: Decision DriveCandidate DriveJob Findings KEEPING Kind Mode Proof Step Verb difference
    motor_learning: MotorLearning
    self_calibration: SelfCalibration TRIAL
    story: DrivePath DriveStory path_along replayed
    worker: answer prove
    """,
)
