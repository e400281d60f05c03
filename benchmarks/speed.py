"""Time of a fit: `python benchmarks/speed.py [--repeats N]`.

Milliseconds of processor time for one fit, everything on, and the time relative to 500 samples. Set
OMP_NUM_THREADS=1 to measure one thread.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import shared_cases  # noqa: F401
from simulated.turns import measure, smooth_wobble, turn

from magcal_ros.core.methods.smoother import fit
from magcal_ros.core.samples.window import Window
from magcal_ros.core.simulation import DEGREE, Robot

SIZES = (50, 500, 3000, 20_000, 100_000, 1_000_000)


def draw(samples: int, wobble_deg: float, soft_iron: float, gyro: bool) -> tuple[Robot, Window]:
    """Simulate one full turn."""
    rng = np.random.default_rng(1)
    robot = Robot(soft_iron=soft_iron * np.diag([1.0, -1.0, 0.0]))
    lean = None
    if wobble_deg > 0.0:
        lean = smooth_wobble(rng, samples, 15.0, wobble_deg * DEGREE)
    motion = turn(samples=samples, wobble=lean)
    return robot, measure(robot, motion, rng, gyro=gyro)


def best_time(robot: Robot, window: Window, repeats: int) -> float:
    """Return seconds of the fastest of some fits."""
    times = []
    for _ in range(repeats):
        began = time.process_time()
        fit(window, robot.knowledge())
        times.append(time.process_time() - began)
    return min(times)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    repeats = parser.parse_args().repeats
    kinds = {
        "rigid": (0.0, 0.0, False),
        "wobble 5": (5.0, 0.0, False),
        "soft iron 5%": (0.0, 0.05, False),
        "rigid, gyro": (0.0, 0.0, True),
    }
    print(f"{'':14s}" + "".join(f"{f'N={size}':>16s}" for size in SIZES))
    for name, (wobble, iron, gyro) in kinds.items():
        times = [best_time(*draw(size, wobble, iron, gyro), repeats) for size in SIZES]
        cells = "".join(f"{1e3 * t:8.0f} ms x{t / times[1]:4.1f}" for t in times)
        print(f"{name:14s}" + cells, flush=True)


if __name__ == "__main__":
    main()
