"""A turn from its start to its window."""

from magcal_ros.core.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(
    __name__,
    """
    at_known_heading: add_standing
    external_heading: GyroTurn HeadingAgainstGyro
    recorded: Gathering LITTLE_DATA fit_gathered without_motors
    rotation: Fault Phase RotationPlan RotationProof Seen fit_circle_by_angle objection_to_gyro
        planned_duration
    self_turn: Around SelfTurn
    session: Brief Limits Progress Session Stage
    turn_machine: Conclusion FitTurn MoveBase Preview PutInForce TurnMachine TurnState
    """,
)
