"""Checks of a calibration by a new turn: `python benchmarks/checks.py [--robots N] [--first N]`.

The calibration is the right one of a simulated robot with typical or cheap sensors, and iron is
added to the robot. A row counts how many of the checks say that the calibration holds, is doubtful,
or is stale, for each size of the iron. 2, 3, 5 and 8 µT turn the heading by 3.6, 5.3, 8.8 and 14°
RMS. A check should say doubtful beyond 4°, stale beyond 7°. The last column is the swing of the
heading without iron, RMS in degrees: the error of the new fit, and of the axes of the sensor, which
the calibration does not correct.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace

import numpy as np
import shared_cases  # noqa: F401
from realistic_robots import Scene, collected
from side_by_side import rows

from magcal_ros.core.calibrate import calibrate
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.errors import Refusal
from magcal_ros.core.monitoring.recheck import Recheck, check
from magcal_ros.core.samples.window import Window

CASES = (
    "rest, turn, rest: typical, even",
    "rest, turn, rest: cheap, even",
    "rest, turn, rest: typical, near iron",
    "rest, turn, rest: typical, indoors",
    "motors by rate 7 µT",
    "hard iron drifts by 1.0 µT",
    "circle of 1.0 m, no rest",
    "no rest: cheap, even",
    "no gyro: rest, turn, rest: typical, even",
    "no gyro: cheap, even",
)
SIZES = (0.0, 2.0, 3.0, 5.0, 8.0)
"""Iron that is added across body z, µT."""
STATES = ("holds", "doubtful", "stale", "nothing shown")


def window_of(scene: Scene, added: float, number: int) -> Window:
    """Return the samples of a turn with iron (tesla) that is added in a random level direction."""
    angle = np.random.default_rng(number).uniform(0.0, math.tau)
    iron = added * np.array([math.cos(angle), math.sin(angle), 0.0])
    window = replace(scene.window, field=scene.window.field + iron)
    return collected(window) if scene.has_course else window


def swing_of(result: Recheck) -> float:
    """Return the swing of the heading by the calibration, degrees; NaN if it was not measured."""
    found = [each.value for each in result.findings if each.figure is Figure.HEADING_SWING]
    return found[0] if found and found[0] is not None else math.nan


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=int, default=12)
    parser.add_argument("--first", type=int, default=304000, help="seed of the first robot")
    arguments = parser.parse_args()
    print(f"{'':42s}" + "".join(f"{size:>11.0f} µT" for size in SIZES) + f"{'swing':>8s}")
    print(f"{'holds/doubtful/stale/nothing shown':42s}")
    cases = rows()
    for name in CASES:
        counts = {size: dict.fromkeys(STATES, 0) for size in SIZES}
        swings: list[float] = []
        for number in range(arguments.first, arguments.first + arguments.robots):
            scene, knowledge = cases[name](number)
            made = calibrate(window_of(scene, 0.0, number), knowledge).calibration
            if made is None:
                continue
            robot = scene.robot
            right = replace(
                made,
                correction=robot.true_correction,
                strength=robot.strength,
                inclination=robot.inclination,
                motors=None,
            )
            for size in SIZES:
                try:
                    result = check(window_of(scene, 1e-6 * size, number), right)
                except Refusal:
                    counts[size]["nothing shown"] += 1
                    continue
                counts[size][result.state] += 1
                swings += [swing_of(result)] if size == 0.0 else []
        texts = ("/".join(str(n) for n in counts[size].values()) for size in SIZES)
        rms = math.sqrt(float(np.nanmean(np.square(swings))))
        print(f"{name:42s}" + "".join(f"{text:>14s}" for text in texts) + f"{rms:8.2f}", flush=True)


if __name__ == "__main__":
    main()
