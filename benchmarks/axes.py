"""Whether the axes are found: `python benchmarks/axes.py [--runs N] [--good N] [--seed S]`.

Each run puts a magnetometer with one of the 48 signed permutations of its axes on a robot, up to 8°
off. Hard iron is up to the field's strength; noise and gyro bias are those of a cheap sensor. The
robot turns on the level, wobbles while it turns, or turns and lifts its nose by 20°. Then good
sensors are tested: none of their turns may be called wrong.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np
import shared_cases  # noqa: F401
from axes_cases import MOTIONS, good_case, wrong_case

from magcal_ros.core.doctor.sensor_report import examine_window, wrong_axes
from magcal_ros.core.geometry.rotations import signed_permutations


@dataclass
class Row:
    """The count of one movement."""

    runs: int = 0
    among: int = 0
    alone: int = 0
    meant: int = 0
    named: int = 0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=192, help="of each movement")
    parser.add_argument("--good", type=int, default=2000, help="turns of good sensors")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    every = signed_permutations()
    print(f"{'movement':<12}{'runs':>6}{'named %':>9}{'alone %':>9}{'meant %':>9}{'named':>7}")
    for motion in MOTIONS:
        row = Row()
        for number in range(arguments.runs):
            axes = every[number % len(every)]
            count(row, axes, np.random.default_rng([arguments.seed, number]), motion)
        share = 100.0 / row.runs
        print(
            f"{motion:<12}{row.runs:>6}{share * row.among:>9.1f}{share * row.alone:>9.1f}"
            f"{share * row.meant:>9.1f}{row.named / row.runs:>7.1f}"
        )
    wrong = 0
    for number in range(arguments.good):
        window, knowledge = good_case(np.random.default_rng([arguments.seed, 7, number]))
        found = wrong_axes(window, knowledge)
        if found is not None:
            wrong += 1
            print(f"case {number}: {found}")
    print(f"good turns called wrong: {wrong} of {arguments.good}")


def count(row: Row, axes: np.ndarray, rng: np.random.Generator, motion: str) -> None:
    window, knowledge = wrong_case(axes, rng, motion)
    found = examine_window(window, knowledge).axes
    row.runs += 1
    if found is None:
        return
    named = [np.array_equal(axes, each) for each in found.candidates]
    row.among += any(named)
    row.alone += any(named) and len(named) == 1
    row.meant += found.likeliest is not None and bool(np.array_equal(axes, found.likeliest))
    row.named += len(named)


if __name__ == "__main__":
    main()
