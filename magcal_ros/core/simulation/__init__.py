"""Simulated robots, for the demo, the rehearsal, tests and benchmarks."""

from magcal_ros.core.simulation.simulator import (
    DEGREE,
    LEVEL_TILT,
    UP_ENU,
    Ride,
    Robot,
    heading_errors,
    trial_attitudes,
)

__all__ = [
    "DEGREE", "LEVEL_TILT", "UP_ENU", "Ride", "Robot", "heading_errors", "trial_attitudes",
]  # fmt: skip
