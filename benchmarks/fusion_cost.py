"""What up and fused yaw cost per message, in microseconds: `python benchmarks/fusion_cost.py`."""

from __future__ import annotations

import math
import time

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration, Evidence
from magcal_ros.core.heading.compass import Compass, CompassReader
from magcal_ros.core.heading.disturbance import PATIENCE
from magcal_ros.core.heading.fused_yaw import FusedYaw
from magcal_ros.core.samples.streams import FieldSample, ImuSample
from magcal_ros.core.simulation import Ride, Robot
from magcal_ros.core.up.follower import UpFollower

REPEATS = 5


def main() -> None:
    """Drive a minute at 100 Hz, half of it at rest, and print the fastest of some runs."""
    robot = Robot()
    ride = Ride(robot, np.random.default_rng(1), start=10.0)
    samples = [s for k in range(6000) for s in ride.step(0.4 if k % 2000 > 1000 else 0.0)]
    evidence = Evidence("truth", "", "", "")
    calibration = Calibration(
        robot.true_correction, np.zeros((12, 12)), 1e-6, 0.01, robot.strength, 1.1, evidence
    )
    best = [math.inf, math.inf, math.inf]
    for _ in range(REPEATS):
        best = [min(pair) for pair in zip(best, run(samples, calibration), strict=True)]
    names = ("up, per IMU message", "fused yaw, per IMU message", "fused yaw, per field message")
    for name, seconds in zip(names, best, strict=True):
        print(f"{name:30s} {1e6 * seconds:6.1f} µs")


def run(samples: list[ImuSample | FieldSample], calibration: Calibration) -> list[float]:
    """Return seconds per message of each part."""
    follower, fused, compass = UpFollower(), FusedYaw(calibration, PATIENCE), Compass(calibration)
    reader = CompassReader(follower)
    spent, counts = [0.0, 0.0, 0.0], [0, 0]
    clock = time.perf_counter
    for sample in samples:
        started = clock()
        if isinstance(sample, ImuSample):
            counts[0] += 1
            follower.add(sample)
            spent[0] += clock() - started
            started = clock()
            fused.propagate_by(sample.stamp, follower)
            fused.heading()
            spent[1] += clock() - started
            continue
        counts[1] += 1
        follower.add_field(sample.stamp, sample.field)
        spent[0] += clock() - started
        reading = reader.read(compass, sample)
        started = clock()
        fused.correct(reading)
        spent[2] += clock() - started
    return [spent[0] / counts[0], spent[1] / counts[0], spent[2] / counts[1]]


if __name__ == "__main__":
    main()
