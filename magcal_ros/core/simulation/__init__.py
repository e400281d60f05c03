"""Simulated robots that turn, for the demo, tests and benchmarks."""

from magcal_ros.core.simulation.ride import Ride
from magcal_ros.core.simulation.simulator import (
    DEGREE,
    LEVEL_TILT,
    UP_ENU,
    Motion,
    Robot,
    Trouble,
    heading_errors,
    measure,
    slope_rpy,
    smooth_wobble,
    trial_attitudes,
    turn,
)

__all__ = [
    "DEGREE",
    "LEVEL_TILT",
    "UP_ENU",
    "Motion",
    "Ride",
    "Robot",
    "Trouble",
    "heading_errors",
    "measure",
    "slope_rpy",
    "smooth_wobble",
    "trial_attitudes",
    "turn",
]  # fmt: skip
