"""Several turns joined: heading error against the Cramér-Rao limit, and what is predicted.

Absolute: the yaw of the installation is part of the error. `python benchmarks/several_turns.py`
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shared_cases  # noqa: F401
from limit import Scene, covariance_limit, heading_rms
from simulated.turns import measure, slope_rpy, turn

from magcal_ros.core.calibrate import calibrate_turns
from magcal_ros.core.knowledge import Mounting
from magcal_ros.core.simulation import LEVEL_TILT, UP_ENU, Robot, heading_errors

TILT = math.radians(10.0)
EAST, NORTH, WEST, SOUTH = (k * math.pi / 2 for k in range(4))
SETS: tuple[tuple[str, tuple[float | None, ...]], ...] = (
    ("level", (None,)),
    ("level, 1 ramp", (None, EAST)),
    ("level, 2 ramps", (None, EAST, NORTH)),
    ("level, 3 ramps", (None, EAST, NORTH, WEST)),
    ("4 ramps", (EAST, NORTH, WEST, SOUTH)),
)
"""Where the slopes rise to, from a random first direction; None is the level."""


@dataclass(frozen=True)
class Run:
    """Mean squares over the poses, rad²; the yaw's error in its own sigmas; seconds."""

    level: float
    tilted: float
    relative: float
    predicted: float
    limit: float
    limit_tilted: float
    yaw_sigmas: float
    seconds: float


def draw(slopes: Sequence[float | None], soft_iron: float, rng: np.random.Generator) -> list[Scene]:
    """Draw a robot and its turns: yaw of the installation, soft iron, first headings, and where
    the first slope rises to are random."""
    upper = np.triu(soft_iron * rng.standard_normal((3, 3)))
    robot = replace(
        Robot(),
        hard_iron=Robot().strength * np.array([0.6, -0.4, 0.5]),
        yaw=float(Mounting.yaw_sigma * rng.standard_normal()),
        soft_iron=upper + np.triu(upper, 1).T,
    )
    first, made = rng.uniform(0.0, math.tau), []
    for slope in slopes:
        heading = rng.uniform(0.0, math.tau)
        tilt, azimuth = (0.0, 0.0) if slope is None else (TILT, first + slope)
        rpy = slope_rpy(tilt, azimuth, heading)
        made.append(Scene(robot, turn(start_rpy=rpy), UP_ENU, rpy, 0.0))
    return made


def run(slopes: Sequence[float | None], options: argparse.Namespace, seed: int) -> Run:
    """Draw, join and compare."""
    rng = np.random.default_rng(seed)
    made = draw(slopes, options.soft_iron, rng)
    robot = made[0].robot
    knowledge = robot.knowledge(0.03 * robot.strength, math.radians(1.0))
    windows = [measure(robot, scene.motion, rng, gyro=options.gyro) for scene in made]
    began = time.process_time()
    outcome = calibrate_turns(windows, knowledge)
    seconds = time.process_time() - began
    estimate, multi_turn = outcome.estimate, outcome.multi_turn
    assert estimate is not None
    assert estimate.installation is not None
    assert multi_turn is not None
    errors = heading_errors(estimate.correction, robot)
    level = errors[:, LEVEL_TILT]
    covariance = covariance_limit(made, knowledge, soft_iron=True, yaw=True)
    least, least_tilted = heading_rms(covariance, robot)
    shown = multi_turn.shown.installation_yaw
    return Run(
        level=float(np.mean(level**2)),
        tilted=float(np.mean(errors**2)),
        relative=float(np.var(level)),
        predicted=multi_turn.shown.absolute_level**2,
        limit=math.radians(least) ** 2,
        limit_tilted=math.radians(least_tilted) ** 2,
        yaw_sigmas=(estimate.installation.yaw - robot.yaw) / shown,
        seconds=seconds,
    )


def row(name: str, runs: Sequence[Run]) -> str:
    """Return a line of the table."""

    def rms(figure: str) -> float:
        return math.degrees(math.sqrt(np.mean([getattr(each, figure) for each in runs])))

    nees = float(np.mean([each.yaw_sigmas**2 for each in runs]))
    worst = math.degrees(math.sqrt(max(each.tilted for each in runs)))
    seconds = float(np.median([each.seconds for each in runs]))
    return (
        f"| {name:14} | {rms('level'):.2f}/{rms('tilted'):.2f} "
        f"| {rms('limit'):.2f}/{rms('limit_tilted'):.2f} | {rms('predicted'):.2f} "
        f"| {rms('relative'):.3f} | {worst:.2f} | {nees:.2f} | {seconds:.2f} |"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--only", help="turns whose name contains this")
    parser.add_argument("--soft-iron", type=float, default=0.0, help="sigma of its elements")
    parser.add_argument("--gyro", action="store_true")
    options = parser.parse_args()
    print(
        "| turns | absolute, level/all tilts ° | limit ° | predicted ° | relative, level ° "
        "| worst run ° | NEES of the yaw | CPU s |\n|---|---|---|---|---|---|---|---|"
    )
    for name, slopes in SETS:
        if options.only is None or options.only in name:
            seeds = range(options.first, options.first + options.runs)
            print(row(name, [run(slopes, options, seed) for seed in seeds]), flush=True)


if __name__ == "__main__":
    main()
