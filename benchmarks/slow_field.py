"""Turns of a shaking robot with a slow field: `python benchmarks/slow_field.py [--seeds N]`.

An IMU of 100 Hz, one turn from rest to rest. The turn rate varies by so many percent (RMS) at 1 to
8 Hz. Each row: answered turns, RMS of the heading on the level in degrees, NEES, largest error in
sigmas, and seconds of processor time for a turn.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import shared_cases  # noqa: F401
from realistic_robots import heading_error
from slow_fields import collected_at, drawn

from magcal_ros.core.calibrate import calibrate
from magcal_ros.core.calibration.heading_sigma import predicted_heading_sigma
from magcal_ros.core.simulation import DEGREE


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=24, help="turns a row")
    parser.add_argument("--first", type=int, default=54000, help="the first seed")
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    print("field    shakes  answered    rms   nees    max      s")
    for field_hz in (100.0, 20.0, 10.0, 5.0, 2.0, 1.0):
        for shake in (0.0, 0.3, 1.0):
            print(f"{field_hz:g} Hz  {shake:4.0%}  {row(field_hz, shake, seeds)}", flush=True)


def row(field_hz: float, shake: float, seeds: range) -> str:
    """Return the figures of one row in words."""
    errors, ratios, spent = [], [], 0.0
    for seed in seeds:
        scene, knowledge = drawn(np.random.default_rng(seed), shake)
        window = collected_at(scene.window, field_hz)
        began = time.process_time()
        outcome = calibrate(window, knowledge)
        spent += time.process_time() - began
        if outcome.estimate is None:
            continue
        errors.append(heading_error(scene, outcome.estimate.correction) / DEGREE)
        ratios.append(errors[-1] * DEGREE / predicted_heading_sigma(outcome.estimate))
    if not errors:
        return f"0 of {len(seeds)}"
    rms, nees = (float(np.sqrt(np.mean(np.square(errors)))), float(np.mean(np.square(ratios))))
    return (
        f"{len(errors)} of {len(seeds)}  {rms:5.2f}  {nees:5.2f}  {max(ratios):5.1f}  "
        f"{spent / len(seeds):5.2f}"
    )


if __name__ == "__main__":
    main()
