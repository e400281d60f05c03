"""A turn from its start to its window."""

from magcal_ros.core.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    """
    at_known_heading: add_known_heading
    external_heading: GyroTurn HeadingAgainstGyro
    recorded: LITTLE_DATA SampleCollector fit_collected without_motors
    rotation: Fault MeasuredTurn Phase RotationPlan TurnMonitor fit_circle_by_angle
        objection_to_gyro planned_duration
    self_turn: SelfTurn TurnConditions
    session: Limits Progress Session Stage TurnRequest
    turn_machine: Conclusion FitTurn MoveBase Preview PutInForce TurnMachine TurnState
    """,
)
