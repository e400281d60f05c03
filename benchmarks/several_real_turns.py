"""Several turns of sensors with errors of their own: `python benchmarks/several_real_turns.py`.

Sensors and robot are those of `cases/realistic_robots.py`; what belongs to the robot is the same in
all turns, what belongs to a moment is drawn for each. Each turn begins and ends at rest. Heading on
the level: RMS error, sigma and NEES, absolute (the yaw of the installation is part of it) and with
one offset taken off. `--place` adds a field in world axes (µT per axis) that differs from turn to
turn, `--iron` the same in body axes. `--no-gyro` takes the gyro away.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shared_cases  # noqa: F401
from realistic_robots import (
    FULL_TURN,
    SAMPLES,
    SECONDS,
    Scene,
    Spoil,
    axes,
    biased,
    collected,
    crossed,
    drifting,
    driven,
    evenly,
    heading_errors,
    lasting,
    late,
    lever_arm,
    off,
    scattered,
    switching,
    together,
    with_field,
)
from several_turns import SETS, TILT
from simulated.turns import measure, slope_rpy, smooth_wobble

from magcal_ros.core.calibrate import calibrate_turns
from magcal_ros.core.calibration.heading_sigma import heading_jacobian
from magcal_ros.core.geometry.attitude import field_in_enu
from magcal_ros.core.knowledge import Belief, Knowledge, Mounting, ReferenceField
from magcal_ros.core.simulation import DEGREE, Robot

OF_THE_ROBOT: Spoil = together(
    scattered(axes, 0.005),
    scattered(late, 0.008),
    scattered(lever_arm, 0.08),
    scattered(off, 0.05),
    scattered(crossed, 0.008),
)
OF_A_TURN: Spoil = together(
    scattered(drifting, 0.2e-6),
    scattered(switching, 0.1e-6),
    scattered(lasting, 0.15e-6),
    scattered(biased, 0.2),
)
"""Together what `SENSORS["typical"]` of `cases/realistic_robots.py` is."""


@dataclass(frozen=True)
class Run:
    """Mean squares over headings: of the error and of the sigma, absolute and relative; seconds."""

    absolute: float
    relative: float
    sigma: float
    sigma_relative: float
    seconds: float


def drawn(
    slopes: Sequence[float | None], options: argparse.Namespace, seed: int
) -> tuple[list[Scene], Knowledge]:
    """Draw a robot, its turns, and what is known of the field."""
    rng = np.random.default_rng([7, seed])
    robot = Robot(
        inclination=rng.uniform(50.0, 70.0) * DEGREE,
        roll=rng.normal(0.0, 3.0) * DEGREE,
        pitch=rng.normal(0.0, 3.0) * DEGREE,
        yaw=rng.normal(0.0, Mounting.yaw_sigma),
        hard_iron=rng.normal(0.0, 20e-6, 3),
        noise_field=0.3e-6,
        noise_force=0.05,
        noise_rate=2e-3,
    )
    strength = Belief(robot.strength + rng.normal(0.0, 1.5e-6), 1.5e-6)
    dip = Belief(robot.inclination + rng.normal(0.0, 1.0) * DEGREE, 1.0 * DEGREE)
    first, scenes = rng.uniform(0.0, math.tau), []
    for number, slope in enumerate(slopes):
        tilt = abs(rng.normal(0.0, 1.0)) * DEGREE if slope is None else TILT
        rises = rng.uniform(0.0, math.tau) if slope is None else first + slope
        start = slope_rpy(tilt, rises, rng.uniform(0.0, math.tau))
        sway = smooth_wobble(rng, SAMPLES, SECONDS, 1.0 * DEGREE, (0.2, 2.0))
        arc = rng.choice([-1.0, 1.0]) * rng.uniform(*FULL_TURN) * math.tau
        motion = driven(evenly, arc, start, sway)
        there = options.iron * 1e-6 * rng.standard_normal(3)
        here = replace(robot, hard_iron=robot.hard_iron + there)
        scene = Scene(here, motion, measure(here, motion, rng, gyro=True))
        scene = OF_THE_ROBOT(np.random.default_rng([8, seed]), scene)
        scene = OF_A_TURN(np.random.default_rng([9, seed, number]), scene)
        bent = motion.attitude @ (options.place * 1e-6 * rng.standard_normal(3))
        scenes.append(replace(with_field(scene, bent @ robot.distortion.T), robot=robot))
    return scenes, Knowledge(ReferenceField(strength, dip))


def run(slopes: Sequence[float | None], options: argparse.Namespace, seed: int) -> Run | None:
    """Draw, join and compare; None where not all turns were joined."""
    scenes, knowledge = drawn(slopes, options, seed)
    windows = [collected(scene.window) for scene in scenes]
    if options.no_gyro:
        windows = [replace(window, angular_rate=None) for window in windows]
    began = time.process_time()
    outcome = calibrate_turns(windows, knowledge)
    seconds = time.process_time() - began
    found, multi_turn = outcome.estimate, outcome.multi_turn
    if found is None or multi_turn is None or len(multi_turn.joined) < len(slopes):
        return None
    errors = heading_errors(scenes[0], found.correction)
    field = field_in_enu(found.strength, found.inclination)
    jacobian = heading_jacobian(found.correction, field, 0.0)
    yaw = 0.0 if len(slopes) > 1 else knowledge.mounting.yaw_sigma**2
    each = [jacobian, jacobian - jacobian.mean(axis=0)]
    sigma, relative = (np.einsum("ij,jk,ik->i", j, found.covariance, j).mean() for j in each)
    squares = float(np.mean(errors**2)), float(np.var(errors))
    return Run(*squares, float(sigma) + yaw, float(relative), seconds)


def row(name: str, runs: Sequence[Run | None]) -> str:
    """Return a line of the table."""
    reported = [each for each in runs if each is not None]

    def rms(figure: str) -> float:
        return math.degrees(math.sqrt(np.mean([getattr(each, figure) for each in reported])))

    absolute = np.mean([each.absolute / each.sigma for each in reported])
    relative = np.mean([each.relative / each.sigma_relative for each in reported])
    return (
        f"| {name:14} | {rms('absolute'):.2f}, {rms('sigma'):.2f}, {absolute:.2f} "
        f"| {rms('relative'):.2f}, {rms('sigma_relative'):.2f}, {relative:.2f} "
        f"| {len(runs) - len(reported)} | {np.median([each.seconds for each in reported]):.1f} |"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--place", type=float, default=0.0)
    parser.add_argument("--iron", type=float, default=0.0)
    parser.add_argument("--no-gyro", action="store_true")
    parser.add_argument("--only", help="turns whose name contains this")
    options = parser.parse_args()
    print(
        "| turns | absolute: RMS°, sigma°, NEES | one offset taken off: the same "
        "| not joined | CPU s |\n|---|---|---|---|---|"
    )
    for name, slopes in SETS:
        if options.only is None or options.only in name:
            seeds = range(options.first, options.first + options.runs)
            print(row(name, [run(slopes, options, seed) for seed in seeds]), flush=True)


if __name__ == "__main__":
    main()
