"""Robots whose motors add a field: `python benchmarks/motors.py [--runs N] [--first K]`.

Each robot calibrates with one turn, in which it stops three times on the way (`--turn even`: only
before and after it). Then it drives for five minutes: it stands, drives, bends and turns on the
spot. Its motors add a field of so many microtesla at their largest. Its shape is a step with
motion, in proportion to speed, to turn rate, or to a current with a ripple of a fifth, or a step
whose sign changes with the direction of turn. "current, holds" is the current of a robot that also
holds itself by its motors while it stands, by 0 to 3 A. The current comes at 8 Hz, a tenth of a
second late.
"turn" subtracts the field that the turn has shown, "drive" also what is learnt while driving, and
"none" nothing.

For rest and motion each row shows the RMS of the heading error (degrees), and NEES (its square over
the published variance, capped at a hundred). It also shows the share of messages with a silent
error: more than five degrees, and more than three published sigmas. The first minute of a drive is
evaluated by itself. The seeds are `--first` and those after it.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import shared_cases  # noqa: F401
from realistic_robots import collected, direction
from simulated.drive import Drive, Streets, Vehicle, simulated_drive
from simulated.legs import Leg, seconds_of
from simulated.travel import Travel, exponential_noise, travel

from magcal_ros.core.calibrate import calibrate
from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import wrapped
from magcal_ros.core.heading.compass import Compass, CompassReader
from magcal_ros.core.heading.disturbance import FieldDeviation
from magcal_ros.core.knowledge import Belief, Knowledge, ReferenceField
from magcal_ros.core.samples.battery import Messages
from magcal_ros.core.samples.streams import FieldSample, ImuSample, SpeedSample
from magcal_ros.core.samples.window import Window
from magcal_ros.core.self_calibration.motor_learning import MotorLearning
from magcal_ros.core.simulation import Robot
from magcal_ros.core.up.follower import UpFollower

SHAPES = ("step", "speed", "turn rate", "current", "current, no battery", "current, holds", "side")
SIZES = (0.0, 2.0, 7.0, 20.0)
WAYS = ("none", "turn", "drive")
FASTEST, QUICKEST = 1.0, 0.8
"""m/s and rad/s."""
TURNS = {
    "even": [Leg(6.0), Leg(math.tau * 1.1 / 0.4, turn_rate=0.4), Leg(6.0)],
    "stops": [Leg(3.0), *[Leg(math.tau * 1.1 / 1.6, turn_rate=0.4), Leg(3.0)] * 4],
}


def legs(rng: np.random.Generator, seconds: float) -> list[Leg]:
    """Return the motion of a robot in a hall."""
    found: list[Leg] = []
    while seconds_of(found) < seconds:
        speed = rng.uniform(0.3, FASTEST)
        angle, rate = rng.uniform(0.5, 2.5), rng.choice([-1.0, 1.0]) * rng.uniform(0.2, QUICKEST)
        found += [
            Leg(0.8, speed),
            Leg(rng.uniform(3.0, 8.0), speed),
            Leg(rng.uniform(1.0, 3.0), speed, rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.6)),
            Leg(0.8),
            Leg(float(rng.choice([1.0, 5.0]))),
            Leg(angle / abs(rate), turn_rate=rate),
            Leg(rng.uniform(2.0, 6.0)),
        ]
    return found


def motors_of(shape: str, truth: Travel, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return the shape over time, one at its largest, and the current, A."""
    level = np.gradient(truth.yaw, truth.period)
    moves = (np.abs(truth.speed) > 0.01) | (np.abs(level) > 0.02)
    ripple = exponential_noise(rng, len(level), truth.period, 0.5)[:, 0]
    load = np.abs(truth.speed) / FASTEST + np.abs(level) / QUICKEST
    current = 4.0 * load * (1.0 + 0.2 * ripple) + 0.3 * moves
    if shape.endswith("holds"):
        stand = np.cumsum(np.abs(np.diff(moves.astype(int), prepend=int(moves[0]))))
        current += rng.uniform(0.0, 3.0, stand.max() + 1)[stand] * ~moves
    shapes = {
        "step": moves.astype(float),
        "speed": truth.speed / FASTEST,
        "turn rate": level / QUICKEST,
        "current": current / 4.0,
        "side": np.clip(level / 0.03, -1.0, 1.0),
    }
    return shapes[shape.split(",")[0]], current + 0.5


@dataclass(frozen=True, eq=False)
class Robotic:
    """A robot's turn and drive, its motors on, and its battery's stamps and currents."""

    drive: Drive
    turn_until: float
    battery: Messages
    knowledge: Knowledge


def robot_of(shape: str, size: float, seed: int, seconds: float, turn: list[Leg]) -> Robotic:
    """Return a fresh robot."""
    rng = np.random.default_rng([11, seed])
    robot = Robot(
        inclination=math.radians(rng.uniform(50.0, 70.0)),
        roll=math.radians(rng.normal(0.0, 3.0)),
        pitch=math.radians(rng.normal(0.0, 3.0)),
        hard_iron=rng.normal(0.0, 20e-6, 3),
        noise_field=0.3e-6,
        noise_force=0.05,
        noise_rate=2e-3,
        gyro_bias=rng.normal(0.0, 0.002, 3),
    )
    truth = travel(turn + legs(rng, seconds), rng, rate=25.0, heading=rng.uniform(-3.0, 3.0))
    vehicle = Vehicle(robot, shaking=0.1)
    drive = simulated_drive(truth, rng, vehicle, streets=Streets(size=0.3e-6), receiver=None)
    load, current = motors_of(shape, truth, rng)
    added = size * 1e-6 * np.outer(load, direction(rng)) @ robot.distortion.T
    stamps = truth.time[::3]
    reported = -np.interp(stamps - 0.1, truth.time, current)
    battery = () if shape.endswith("no battery") else tuple(zip(stamps, reported, strict=True))
    strength = Belief(robot.strength + rng.normal(0.0, 1.5e-6), 1.5e-6)
    dip = Belief(robot.inclination + math.radians(rng.normal(0.0, 1.0)), math.radians(1.0))
    return Robotic(
        replace(drive, field=drive.field + added),
        float(truth.time[0]) + seconds_of(turn),
        battery,
        Knowledge(ReferenceField(strength, dip)),
    )


def calibrated(robotic: Robotic) -> Calibration | None:
    """Return the calibration of the turn; None if it was refused."""
    drive = robotic.drive
    rows = drive.time <= robotic.turn_until
    window = Window(drive.time[rows], drive.field[rows], drive.force[rows], drive.rate[rows])
    outcome = calibrate(collected(window, robotic.battery), robotic.knowledge)
    return outcome.calibration if outcome.verdict.accepted else None


def headings(
    robotic: Robotic, calibration: Calibration, way: str
) -> Iterator[tuple[float, bool, float, float]]:
    """Yield stamp, whether it moves, error (radians) and variance, as in the node."""
    drive = robotic.drive
    calibration = calibration if way != "none" else replace(calibration, motors=None)
    up, compass = UpFollower(), Compass(calibration)
    reader = CompassReader(up, lambda _: (speed, current))
    learning = MotorLearning(calibration) if way == "drive" else None
    doubt = FieldDeviation(calibration)
    yaws = dict(zip(drive.time.tolist(), drive.imu_yaw.tolist(), strict=True))
    moves = dict(zip(drive.time.tolist(), _moves(drive.truth).tolist(), strict=True))
    speed = current = math.nan
    battery, learnt = iter(robotic.battery), -math.inf
    waiting = next(battery, None)
    for sample in drive.samples():
        if isinstance(sample, ImuSample):
            up.add(sample)
        elif isinstance(sample, SpeedSample):
            speed = sample.speed
        elif isinstance(sample, FieldSample):
            while waiting is not None and waiting[0] <= sample.stamp:
                current, waiting = float(waiting[1]), next(battery, None)
            up.add_field(sample.stamp, sample.field)
            if learning is not None and up.rate is not None:
                now = reader.motor_state(sample.stamp, compass)
                learning.add(sample.stamp, sample.field, up.rate, now)
                if sample.stamp - learnt > 1.0:
                    learnt = sample.stamp
                    compass.use_motors(learning.motors)
            seen = reader.read(compass, sample)
            if sample.stamp > robotic.turn_until and seen.heading is not None:
                error = wrapped(seen.heading.yaw - yaws[sample.stamp])
                assert seen.up is not None
                variance = seen.heading.yaw_variance
                variance += doubt.add(sample.stamp, seen.field, seen.up.direction, seen.up.variance)
                yield sample.stamp, moves[sample.stamp], error, variance


def _moves(truth: Travel) -> FloatArray:
    turns = np.abs(np.gradient(truth.yaw, truth.period)) > 0.01
    return np.asarray(turns | (np.abs(truth.speed) > 0.01))


@dataclass
class Tally:
    """Errors and variances at rest, in motion, and in motion in the first minute."""

    rows: dict[str, list[tuple[float, float]]] = field(
        default_factory=lambda: {"rest": [], "moving": [], "first minute": []}
    )

    def take(self, robotic: Robotic, calibration: Calibration, way: str) -> None:
        """Take a drive."""
        for stamp, moves, error, variance in headings(robotic, calibration, way):
            early = stamp - robotic.turn_until < 60.0
            name = "rest" if not moves else "first minute" if early else "moving"
            self.rows[name].append((error, variance))

    def words(self) -> str:
        """Return the figures of a row."""
        cells = []
        for found in self.rows.values():
            error, variance = np.array(found).reshape(-1, 2).T
            sigmas = error**2 / variance
            rms = math.degrees(math.sqrt(float(np.mean(error**2))))
            silent = np.mean((np.abs(error) > math.radians(5.0)) & (sigmas > 9.0))
            cells.append(
                f"{rms:6.2f} {np.mean(np.minimum(sigmas, 100.0)):5.2f} {100.0 * silent:5.2f}"
            )
        return "  ".join(cells)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=6, help="robots a row")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--shape", choices=SHAPES, action="append", help="only these shapes")
    parser.add_argument("--size", type=float, action="append", help="only these sizes, µT")
    parser.add_argument("--way", choices=WAYS, action="append", help="only these ways")
    parser.add_argument("--seconds", type=float, default=300.0, help="of each drive")
    parser.add_argument("--turn", choices=TURNS, default="stops", help="how it calibrates")
    options = parser.parse_args()
    print(f"{'':32}{'at rest':>19}{'moving':>20}{'moving, minute 1':>20}")
    print(f"{'':32}" + "   RMS°  NEES silent%" * 3)
    for shape in options.shape or SHAPES:
        for size in options.size or SIZES:
            tallies, refused = {way: Tally() for way in options.way or WAYS}, 0
            for seed in range(options.first, options.first + options.runs):
                robotic = robot_of(shape, size, seed, options.seconds, TURNS[options.turn])
                calibration = calibrated(robotic)
                refused += calibration is None
                if calibration is not None:
                    for way, tally in tallies.items():
                        tally.take(robotic, calibration, way)
            for way, tally in tallies.items():
                reported = f"{shape}, {size:g} µT"
                print(f"{reported:25}{way:7}{tally.words()}", flush=True)
            if refused:
                print(f"   {refused} turns refused")


if __name__ == "__main__":
    main()
