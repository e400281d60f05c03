"""Two methods on the same turns: `python benchmarks/side_by_side.py [--runs N] [--first K]`.

Each row is a kind of turn, for the default (the smoother) and for the design tip of ST. It shows
the RMS of the heading error on the level (degrees), the median of the predicted sigma, and NEES
(the mean squared error over the predicted variance, which should be one). Then come the share of
answers within one and two sigmas, the largest error in sigmas, how many turns were refused, and the
CPU time of a turn. The seeds are `--first` and those after it.
Seeds from 1000 on were used while the smoother was tuned; 0 to 11 were looked at once meanwhile.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import dataclass, field, replace

import numpy as np
import shared_cases  # noqa: F401
from realistic_robots import (
    FULL_TURN,
    SAMPLES,
    SECONDS,
    SENSORS,
    Course,
    Scene,
    Scenes,
    by_effect,
    by_rested_turn,
    by_turn,
    collected,
    direction,
    drawn,
    evenly,
    heading_error,
    rate_of,
    with_field,
    with_force,
    with_motors,
)
from simulated.drive import random_vehicle, simulated_drive
from simulated.legs import circles
from simulated.travel import travel
from simulated.turns import Motion, measure, slope_rpy, smooth_wobble, turn

from magcal_ros.core.calibrate import calibrate
from magcal_ros.core.calibration.heading_sigma import calibration_sigma
from magcal_ros.core.knowledge import Knowledge, knowledge_of
from magcal_ros.core.samples.window import Window
from magcal_ros.core.simulation import DEGREE, LEVEL_TILT, heading_errors

TILTED = "no gyro, no reference, swaying: at 10°, "
"""How rows are called whose heading is judged on slopes of 10°."""
METHODS = ("maximum_likelihood", "design_tip")


def small_circle(radius: float, course: Course | None = None) -> Scenes:
    """Return circles that are driven smoothly; without a course they begin and end in motion."""

    def case(number: int) -> tuple[Scene, Knowledge]:
        rng = np.random.default_rng([6, number])
        scene, known = drawn(rng, course)
        scene = SENSORS["typical"](rng, scene)
        rate = scene.motion.angular_rate[:, 2]
        across, up = np.array([-direction(rng)[1], 1.0, 0.0]), scene.motion.attitude[:, :, 2]
        # The acceleration stays level while the body sways.
        level = across - (up @ across)[:, None] * up
        acceleration = (radius * rate**2)[:, None] * level / np.linalg.norm(across)
        return replace(with_force(scene, acceleration), has_course=course is not None), known

    return case


def street_circle(radius: float, speed: float) -> Scenes:
    """Return a minute of steady circles (m, m/s) in a street, which begins and ends in motion."""

    def case(number: int) -> tuple[Scene, Knowledge]:
        rng = np.random.default_rng([10, number])
        vehicle = random_vehicle(rng)
        truth = travel(circles(80.0, speed=speed, radius=radius), rng)
        drive = simulated_drive(truth, rng, vehicle, wheels=None, receiver=None)
        columns = drive.time, drive.field, drive.force, drive.rate, truth.attitude
        time, samples, force, rate, attitude = (each[1000::2] for each in columns)
        scene = Scene(vehicle.robot, Motion(time, attitude), Window(time, samples, force, rate))
        return scene, knowledge_of(51.3, inclination_deg=66.3)

    return case


def drifting(size: float) -> Scenes:
    """Return turns from rest to rest during which the hard iron drifts by so many tesla."""

    def case(number: int) -> tuple[Scene, Knowledge]:
        rng = np.random.default_rng([7, number])
        scene, known = drawn(rng, evenly)
        scene = SENSORS["typical"](rng, scene)
        share = scene.window.time / np.ptp(scene.window.time)
        added = size * np.outer(share - share.mean(), direction(rng))
        return replace(with_field(scene, added), has_course=True), known

    return case


def shifting(size: float) -> Scenes:
    """Return turns whose accelerometer shifts by so many m/s² while the robot turns."""

    def case(number: int) -> tuple[Scene, Knowledge]:
        rng = np.random.default_rng([8, number])
        scene, known = drawn(rng, evenly)
        scene = SENSORS["typical"](rng, scene)
        moves = np.abs(rate_of(scene)[:, 2]) > 0.05
        return replace(
            with_force(scene, size * np.outer(moves, direction(rng))), has_course=True
        ), known

    return case


def swaying(height: float) -> Scenes:
    """Return turns of a robot in an unknown field, with its IMU so many metres up (no gyro).

    Its sway shakes the accelerometer in proportion to the lean.
    """

    def case(number: int) -> tuple[Scene, Knowledge]:
        rng = np.random.default_rng([9, number])
        scene, _ = drawn(rng)
        sway = smooth_wobble(rng, SAMPLES, SECONDS, rng.uniform(1.0, 3.0) * DEGREE, (0.2, 1.0))
        arc = rng.choice([-1.0, 1.0]) * rng.uniform(*FULL_TURN) * math.tau
        slope = slope_rpy(abs(rng.normal(0.0, 2.0)) * DEGREE, *rng.uniform(0.0, math.tau, 2))
        motion = turn(arc=arc, samples=SAMPLES, duration=SECONDS, start_rpy=slope, wobble=sway)
        moved = np.gradient(height * motion.attitude[:, 2], motion.time, axis=0)
        shaken = np.gradient(moved, motion.time, axis=0)
        shaken[:3], shaken[-3:] = shaken[3], shaken[-4]
        window = measure(scene.robot, motion, rng)
        acceleration = np.einsum("nij,nj->ni", motion.attitude, shaken)
        return with_force(Scene(scene.robot, motion, window), acceleration), Knowledge()

    return case


def without_gyro(case: Scenes) -> Scenes:
    """Return the same turns without their gyro."""

    def deaf(number: int) -> tuple[Scene, Knowledge]:
        scene, knowledge = case(number)
        return replace(scene, window=replace(scene.window, angular_rate=None)), knowledge

    return deaf


def rows_without_gyro() -> dict[str, Scenes]:
    """Return the rows of turns without a gyro."""
    found = {
        f"rest, turn, rest: {sensors}, {course}": by_rested_turn(course, sensors, "open")
        for sensors in ("perfect", "typical", "cheap")
        for course in ("even", "uneven", "there and back", "stops")
    }
    found |= {
        f"{sensors}, {kind}": by_turn(kind, sensors, "open")
        for sensors in ("perfect", "good", "typical", "cheap")
        for kind in ("even", "uneven", "stops", "fast", "slope", "bent ground", "steep field")
    }
    found |= {
        f"{sensors}, {place}": by_turn("even", sensors, place)
        for sensors in ("good", "typical")
        for place in ("near iron", "indoors")
    }
    found["circle of 0.5 m"] = small_circle(0.5)
    blind = {f"no gyro: {name}": without_gyro(case) for name, case in found.items()}
    return blind | {f"{TILTED}{height} m up": swaying(height) for height in (0.1, 0.3, 0.6)}


def rows() -> dict[str, Scenes]:
    """Return the rows by name."""
    found = {
        f"rest, turn, rest: {sensors}, {course}": by_rested_turn(course, sensors, "open")
        for sensors in ("perfect", "good", "typical", "cheap")
        for course in ("even", "uneven", "there and back", "stops")
    }
    found |= {
        f"rest, turn, rest: {sensors}, {place}": by_rested_turn("even", sensors, place)
        for sensors in ("typical", "cheap")
        for place in ("near iron", "indoors")
    }
    found |= {
        f"motors {kind} {size} µT": with_motors(kind, size * 1e-6)
        for size in (1, 3, 7, 10, 20)
        for kind in ("in step", "by rate", "switching")
    }
    found |= {f"circle of {radius} m, no rest": small_circle(radius) for radius in (0.5, 1.0, 4.0)}
    found |= {
        f"circle of {radius} m at {speed} m/s in a street": street_circle(radius, speed)
        for radius, speed in ((2, 1), (4, 2), (8, 3))
    }
    found |= {
        f"no rest: {sensors}, {kind}": by_turn(kind, sensors, "open")
        for sensors in ("perfect", "typical", "cheap")
        for kind in ("even", "there and back", "slope")
    }
    found |= {
        f"no rest: {name}": by_effect(name)
        for name in ("none", "gyro bias 2 °/s", "soft iron 10 %", "axes 3 %", "latency 50 ms")
    }
    found |= {f"hard iron drifts by {size} µT": drifting(size * 1e-6) for size in (0.4, 1.0)}
    found["accelerometer shifts by .12 m/s²"] = shifting(0.12)
    return found | rows_without_gyro()


@dataclass
class Tally:
    """The results of one method for a row; with a tilt (radians), on slopes to all sides."""

    tilt: float = 0.0
    errors: list[float] = field(default_factory=list)
    sigmas: list[float] = field(default_factory=list)
    refused: int = 0
    seconds: float = 0.0

    def take(self, scene: Scene, knowledge: Knowledge, method: str) -> None:
        """Fit one turn."""
        window = collected(scene.window) if scene.has_course else scene.window
        began = time.process_time()
        outcome = calibrate(window, knowledge, method)
        self.seconds += time.process_time() - began
        if outcome.estimate is None or (method == METHODS[0] and not outcome.verdict.accepted):
            self.refused += 1
            return
        error = heading_error(scene, outcome.estimate.correction)
        if self.tilt > 0.0:
            errors = heading_errors(outcome.estimate.correction, scene.robot)
            error = math.sqrt(float(np.mean(np.delete(errors, LEVEL_TILT, axis=1) ** 2)))
        self.errors.append(math.degrees(error))
        self.sigmas.append(math.degrees(calibration_sigma(outcome.estimate, self.tilt)))

    def text(self) -> str:
        count = len(self.errors) + self.refused
        if not self.errors:
            return f"{'refused':>6s} {self.refused}"
        errors, sigmas = np.array(self.errors), np.array(self.sigmas)
        ratio = errors / sigmas
        rms = math.sqrt(float(np.mean(errors**2)))
        return (
            f"{rms:6.2f}{np.median(sigmas):6.2f}{np.mean(ratio**2):6.2f}{np.mean(ratio < 1):6.0%}"
            f"{np.mean(ratio < 2):6.0%}{ratio.max():6.1f}{self.refused:5d}"
            f"{self.seconds / count:7.2f}"
        )


COLUMNS = ("rms", "sigma", "NEES", "<1s", "<2s", "worst")
HEADER = "".join(f"{name:>6s}" for name in COLUMNS) + f"{'ref.':>5s}{'CPU':>7s}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=24)
    parser.add_argument("--first", type=int, default=0, help="seed of the first turn")
    parser.add_argument("--only", default="", help="rows whose name holds this")
    parser.add_argument("--method", choices=METHODS, help="one method alone")
    arguments = parser.parse_args()
    methods = METHODS if arguments.method is None else (arguments.method,)
    print(f"{'':42s}" + "   ".join(f"{name:>48s}" for name in methods))
    print(f"{'':42s}" + "   ".join(HEADER for _ in methods))
    for name, case in rows().items():
        if arguments.only not in name:
            continue
        tilt = 10.0 * DEGREE if name.startswith(TILTED) else 0.0
        tallies = {method: Tally(tilt) for method in methods}
        for number in range(arguments.first, arguments.first + arguments.runs):
            scene, knowledge = case(number)
            for method, tally in tallies.items():
                tally.take(scene, knowledge, method)
        print(f"{name:42s}" + "   ".join(tally.text() for tally in tallies.values()), flush=True)


if __name__ == "__main__":
    main()
