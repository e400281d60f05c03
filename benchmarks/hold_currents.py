"""Turns of robots that report their current: `python benchmarks/hold_currents.py [--runs N]`.

The motors add a field of so many microtesla at their largest current while the robot turns, in one
of these shapes. "hold" follows the current, also that by which the robot holds itself while it
stands (0 to 3 A, another one at each stand). "turn rate" follows the current of a robot that draws
none for its motors while it stands. "step, hold" is present while the robot moves, whatever its
current. "none" is no field. The current comes at 8 Hz (`--gap`), a tenth of a second late, as that
of a moment or as the mean since the message before (`--means`). The robot turns evenly ("even"),
stands on the way for 1.7 s each time ("stops") or for 3 s ("rests").

Each turn is calibrated without its battery ("no battery") and with it. The heading is that of the
robot with its motors off. "turn" takes the calibration as it is; "turn and node" subtracts the
field of the current beyond that of the calibration, as the node does. A row shows the RMS of the
heading error (degrees), the median of the predicted sigma, NEES, the largest error in sigmas and
the CPU time of a turn. The seeds are `--first` and those after it.
"""

from __future__ import annotations

import argparse
import math
import time

import numpy as np
import shared_cases  # noqa: F401
from currents import COURSES, ELECTRONICS, SHAPES, turn_with_current
from realistic_robots import Scene, collected, heading_error

from magcal_ros.core.calibrate import calibrate
from magcal_ros.core.calibration.calibration import Estimate
from magcal_ros.core.calibration.correction import Correction, MotorInput
from magcal_ros.core.calibration.heading_sigma import heading_jacobian, rms_sigma
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import field_in_enu

WAYS = "no battery", "turn", "turn and node"


def with_motors_off(estimate: Estimate) -> tuple[Correction, FloatArray]:
    """Return the calibration of the robot with its motors off, and its covariance."""
    motors = estimate.motors
    if motors is None or MotorInput.CURRENT not in motors.inputs:
        return estimate.correction, estimate.covariance
    at = motors.inputs.index(MotorInput.CURRENT)
    beyond = -ELECTRONICS - motors.reference
    turn = np.eye(12, 12 + motors.gain.size)
    turn[9:, 12 + 3 * at : 15 + 3 * at] = beyond * np.eye(3)
    numbers = estimate.correction.parameters + np.append(np.zeros(9), beyond * motors.gain[at])
    return Correction.from_parameters(numbers), turn @ motors.joint(estimate.covariance) @ turn.T


def judged(scene: Scene, estimate: Estimate, way: str) -> tuple[float, float]:
    """Return the error of the heading and its predicted sigma, radians."""
    correction, covariance = estimate.correction, estimate.covariance
    if way == WAYS[-1]:
        correction, covariance = with_motors_off(estimate)
    field = field_in_enu(estimate.strength, estimate.inclination)
    sigma = rms_sigma(heading_jacobian(correction, field, 0.0), covariance)
    return heading_error(scene, correction), sigma


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=24, help="robots a row")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--shape", choices=SHAPES, action="append", help="only these shapes")
    parser.add_argument("--size", type=float, action="append", help="only these sizes, µT")
    parser.add_argument("--course", choices=tuple(COURSES), action="append")
    parser.add_argument("--gap", type=float, default=0.125, help="seconds between messages")
    parser.add_argument("--means", action="store_true", help="messages that are means")
    parser.add_argument("--battery", action="store_true", help="only turns with their battery")
    options = parser.parse_args()
    print(f"{'':46}RMS° sigma°  NEES worst    s")
    for shape in options.shape or SHAPES:
        for course in options.course or ("even", "stops"):
            for size in [0.0] if shape == "none" else options.size or (7.0, 20.0):
                row(options, shape, course, size)


def row(options: argparse.Namespace, shape: str, course: str, size: float) -> None:
    """Print the rows of one shape."""
    cases = WAYS[:1], WAYS[1:]
    ways = cases[1] if options.battery else WAYS
    found: dict[str, list[tuple[float, float]]] = {way: [] for way in ways}
    spent = dict.fromkeys(ways, 0.0)
    for seed in range(options.first, options.first + options.runs):
        scene, known, battery = turn_with_current(
            shape, size * 1e-6, seed, course, options.gap, are_means=options.means
        )
        for case in cases[options.battery :]:
            messages = battery if case is cases[1] else ()
            window, started = collected(scene.window, messages), time.process_time()
            estimate = calibrate(window, known).estimate
            for way in case:
                spent[way] += time.process_time() - started
                if estimate is not None:
                    found[way].append(judged(scene, estimate, way))
    for way, values in found.items():
        error, sigma = np.array(values).T
        rms = math.degrees(math.sqrt(float(np.mean(error**2))))
        print(
            f"{f'{shape}, {size:g} µT, {course}':26}{way:15}{len(values):3}{rms:6.2f}"
            f"{math.degrees(float(np.median(sigma))):7.2f}{np.mean((error / sigma) ** 2):6.2f}"
            f"{(error / sigma).max():6.1f}{spent[way] / options.runs:5.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
