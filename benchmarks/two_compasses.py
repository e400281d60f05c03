"""One heading from two magnetometers while one of them fails: `python benchmarks/two_compasses.py`.

A number as argument is how many drives each row is over (10 unless given), a second one the first
seed. A robot drives through streets at walking pace with two magnetometers. Each has a calibration
of its own that is wrong by as much as its covariance says. After a minute something happens to the
first, the better one. Failover is the time until the failed one is left out, or (dead) until
headings come again. The step is the change of the published heading beyond the robot's own turning
in the two seconds after it, in sigmas. "Better alone" is the fused yaw of whichever magnetometer
does better alone. NEES is the squared error over the variance.

By chance the ratio of ten drives is .7 to 1.2 where the first one is dead: of 24 drives after the
fault it is .84.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
import shared_cases  # noqa: F401
from simulated.drive import (
    Drive,
    Iron,
    StreetField,
    Streets,
    Vehicle,
    simulated_drive,
)
from simulated.legs import city
from simulated.travel import travel

from magcal_ros.core.calibration.calibration import Calibration, Evidence
from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.geometry.arrays import BoolArray, FloatArray
from magcal_ros.core.geometry.attitude import wrap_angle
from magcal_ros.core.heading.compass import Compass, CompassReader
from magcal_ros.core.heading.disturbance import PATIENCE, FieldDeviation
from magcal_ros.core.heading.fused_yaw import FusedYaw
from magcal_ros.core.heading.several_compasses import SeveralCompasses
from magcal_ros.core.samples.streams import FieldSample, ImuSample
from magcal_ros.core.simulation import Robot
from magcal_ros.core.up.follower import UpFollower

FAILS_AT, SECONDS = 60.0, 150.0
SETTLED = 5.0
"""Seconds from the start that do not count."""

NO_PART = 0.1
"""Weight below which a magnetometer no longer takes part."""

HARD_IRON_SIGMAS = (0.4e-6, 0.6e-6)
"""Tesla per axis by which the two calibrations are wrong."""

ROBOTS = (
    Robot(noise_force=0.05, noise_rate=2e-3, noise_field=0.3e-6),
    Robot(
        roll=math.radians(-2.0),
        pitch=math.radians(5.0),
        hard_iron=np.array([-10e-6, 35e-6, 5e-6]),
        noise_field=0.6e-6,
    ),
)

Fields = tuple[FloatArray, FloatArray]
"""Raw fields of both magnetometers at the moments of a drive, tesla; NaN where nothing comes."""

Fault = Callable[[Fields, "World"], Fields]


@dataclass(frozen=True, eq=False)
class World:
    """A drive, and the changes of its magnetometers' fields."""

    drive: Drive
    streets: StreetField
    seed: int

    @property
    def failed(self) -> BoolArray:
        """Which stamps are after the fault."""
        return np.asarray(self.drive.time - self.drive.time[0] >= FAILS_AT)

    def reading(self, number: int, robot: Robot, irons: tuple[Iron, ...] = ()) -> FloatArray:
        """Return the raw field of one magnetometer on this drive."""
        rng = np.random.default_rng((self.seed, number))
        truth, vehicle = self.drive.truth, Vehicle(robot)
        return simulated_drive(
            truth, rng, vehicle, streets=self.streets, wheels=None, receiver=None, irons=irons
        ).field


def nothing(fields: Fields, _: World) -> Fields:
    return fields


def dead(fields: Fields, world: World) -> Fields:
    return np.where(world.failed[:, None], math.nan, fields[0]), fields[1]


def frozen(fields: Fields, world: World) -> Fields:
    last = fields[0][~world.failed][-1]
    return np.where(world.failed[:, None], last, fields[0]), fields[1]


def disturbed(fields: Fields, world: World) -> Fields:
    iron = Iron((3e-6, 9e-6, 0.0), FAILS_AT, FAILS_AT + 40.0)
    return world.reading(0, ROBOTS[0], (iron,)), fields[1]


def disturbed_for_good(fields: Fields, world: World) -> Fields:
    iron = Iron((0.0, 0.0, 15e-6), FAILS_AT)
    return world.reading(0, ROBOTS[0], (iron,)), fields[1]


def mounted_anew(fields: Fields, world: World) -> Fields:
    turned = dataclasses.replace(ROBOTS[0], yaw=math.radians(20.0))
    return np.where(world.failed[:, None], world.reading(0, turned), fields[0]), fields[1]


def swapped(fields: Fields, world: World) -> Fields:
    first, second = fields
    is_swapped = world.failed[:, None]
    return np.where(is_swapped, second, first), np.where(is_swapped, first, second)


CASES: tuple[tuple[str, Fault], ...] = (
    ("nothing happens", nothing),
    ("dead", dead),
    ("frozen", frozen),
    ("disturbed for 40 s", disturbed),
    ("disturbed for good", disturbed_for_good),
    ("re-mounted by 20°", mounted_anew),
    ("swapped", swapped),
)


def calibrations(rng: np.random.Generator) -> list[Calibration]:
    """Return a calibration of each with an error of its sigma."""
    found = []
    for robot, sigma in zip(ROBOTS, HARD_IRON_SIGMAS, strict=True):
        truth = robot.true_correction
        covariance = np.zeros((12, 12))
        covariance[9:, 9:] = sigma**2 * np.eye(3)
        # Of the size of one sigma: few drives must not hang on the luck of a draw.
        angle = rng.uniform(0.0, math.tau)
        off = sigma * np.array(
            [math.sqrt(2.0) * math.cos(angle), math.sqrt(2.0) * math.sin(angle), 1.0]
        )
        wrong = Correction(truth.matrix, truth.hard_iron + off)
        of_field = (robot.noise_field, 0.005, robot.strength, robot.inclination)
        found.append(Calibration(wrong, covariance, *of_field, Evidence("drawn", "", "", "")))
    return found


def world_of(seed: int) -> World:
    """Return a fresh drive."""
    rng = np.random.default_rng(seed)
    streets = StreetField(Streets(0.5e-6), rng)
    truth = travel(city(rng, SECONDS, fastest=1.2), rng, heading=float(rng.uniform(-3.0, 3.0)))
    return World(simulated_drive(truth, rng, Vehicle(ROBOTS[0]), streets=streets), streets, seed)


@dataclass
class Listener:
    """The processing of messages as in the node with some magnetometers."""

    calibrations: dict[int, Calibration]
    fused_rows: list[tuple[float, float, float]] = field(default_factory=list)
    rows: list[tuple[float, float, float]] = field(default_factory=list)
    weights: list[tuple[float, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.compasses = {k: Compass(each) for k, each in self.calibrations.items()}
        self.follower, self.several = UpFollower(), SeveralCompasses()
        self.reader = CompassReader(self.follower)
        for number, calibration in self.calibrations.items():
            self.several.put_in_force(number, calibration)
        lead = next(iter(self.calibrations.values()))
        self.fused, self.doubt = FusedYaw(lead, PATIENCE), FieldDeviation(lead)

    def hear(self, drive: Drive, fields: Fields) -> None:
        """Take a whole drive; the second magnetometer is half as fast."""
        columns = (drive.time, drive.force, drive.rate, *fields)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        for k, (stamp, force, rate, *raws) in enumerate(rows):
            self._on_imu(ImuSample(stamp, tuple(force), tuple(rate)))
            for number, raw in enumerate(raws):
                is_due = number == 0 or k % 2 == 0
                if is_due and number in self.compasses and math.isfinite(raw[0]):
                    self._on_field(number, FieldSample(stamp, tuple(raw)), stamp)

    def _on_imu(self, sample: ImuSample) -> None:
        self.follower.add(sample)
        self.fused.propagate_by(sample.stamp, self.follower)
        heading = self.fused.heading()
        if heading is not None:
            self.fused_rows.append((sample.stamp, heading.yaw, heading.yaw_variance))

    def _on_field(self, number: int, sample: FieldSample, now: float) -> None:
        if number == 0 or len(self.compasses) == 1:
            self.follower.add_field(sample.stamp, sample.field)
        moment = self.reader.read(self.compasses[number], sample)
        if len(self.compasses) > 1:
            joined = self.several.add(number, moment, now, self.fused)
            if joined is None:
                return
            moment = joined
            self.weights.append((sample.stamp, self.several.weights[0].weight))
        if moment.up is not None and moment.heading is not None:
            self.fused.correct(moment)
            heading, up = moment.heading, moment.up
            more = self.doubt.add(moment.stamp, moment.field, up.direction, up.variance)
            self.rows.append((moment.stamp, heading.yaw, heading.yaw_variance + more))


@dataclass(frozen=True)
class Score:
    """Mean squared errors (rad²) after the start, their shares of the variance, and the failover.

    `square` and `nees` are of the fused yaw, `published_nees` of the heading of each message.
    """

    square: float
    nees: float
    published_nees: float
    failover: float = math.nan
    step: float = math.nan


def errors(drive: Drive, rows: list[tuple[float, float, float]]) -> tuple[FloatArray, ...]:
    """Return stamps, errors and variances of the rows that count."""
    stamps, yaws, variances = np.array(rows).T
    truth = drive.imu_yaw[np.searchsorted(drive.time, stamps)]
    counts = stamps - drive.time[0] > SETTLED
    return tuple(v[counts] for v in (stamps, wrap_angle(yaws - truth), variances))


def score(drive: Drive, listener: Listener) -> Score:
    """Compare the published headings with the truth."""
    _, off, variance = errors(drive, listener.fused_rows)
    stamps, published, its_variance = errors(drive, listener.rows)
    failover = step = math.nan
    if listener.weights:
        begins = drive.time[0] + FAILS_AT
        near = (stamps >= begins - 0.1) & (stamps < begins + 2.0)
        steps = np.abs(wrap_angle(np.diff(published[near])))
        step = float(np.max(steps / np.sqrt(its_variance[near][1:])))
        failover = max(_still_heard(listener, begins), float(np.max(np.diff(stamps[near]))))
    nees = float(np.mean(off**2 / variance))
    published_nees = float(np.mean(published**2 / its_variance))
    return Score(float(np.mean(off**2)), nees, published_nees, failover, step)


def _still_heard(listener: Listener, begins: float) -> float:
    """Return how long the first magnetometer had a weight after its fault."""
    for stamp, weight in listener.weights:
        if stamp >= begins and weight < NO_PART:
            return stamp - begins
    return math.inf


def run(drives: int, first: int = 0) -> Iterator[tuple[str, list[Score], list[list[Score]]]]:
    """Return for each case the scores of both together and of each alone."""
    worlds = [world_of(seed) for seed in range(first, first + drives)]
    readings = [(w.reading(0, ROBOTS[0]), w.reading(1, ROBOTS[1])) for w in worlds]
    alone: dict[tuple[int, int], tuple[FloatArray, Score]] = {}

    def received(world: World, fields: Fields, numbers: tuple[int, ...]) -> Score:
        drawn = calibrations(np.random.default_rng((world.seed, 9)))
        listener = Listener({number: drawn[number] for number in numbers})
        listener.hear(world.drive, fields)
        return score(world.drive, listener)

    def heard_alone(world: World, fields: Fields, number: int) -> Score:
        key = world.seed, number
        if key not in alone or alone[key][0] is not fields[number]:
            alone[key] = fields[number], received(world, fields, (number,))
        return alone[key][1]

    for name, fault in CASES:
        cases = [(w, fault(fields, w)) for w, fields in zip(worlds, readings, strict=True)]
        both = [received(w, fields, (0, 1)) for w, fields in cases]
        yield name, both, [[heard_alone(w, f, k) for w, f in cases] for k in (0, 1)]


def mean(scores: list[Score], key: str) -> float:
    """Return the mean of a figure over drives."""
    return float(np.mean([getattr(each, key) for each in scores]))


def main() -> None:
    """Print a row for each case."""
    drives, first = (int(each) for each in (sys.argv[1:] + ["10", "0"][len(sys.argv) - 1 :])[:2])
    print("the first fails after 60 s  both  better alone  ratio   NEES  alone", end="")
    print("  each message  alone  failover  step")
    for name, both, each in run(drives, first):
        better = min(each, key=lambda scores: mean(scores, "square"))
        ours, theirs = (math.degrees(math.sqrt(mean(s, "square"))) for s in (both, better))
        failover, step = (max(getattr(s, key) for s in both) for key in ("failover", "step"))
        after = f"{failover:8.2f} s{step:6.1f}" if name != CASES[0][0] else ""
        print(
            f"{name:24s}{ours:7.2f}°{theirs:13.2f}°{ours / theirs:7.2f}{mean(both, 'nees'):7.2f}"
            f"{mean(better, 'nees'):7.2f}{mean(both, 'published_nees'):14.2f}"
            f"{mean(better, 'published_nees'):7.2f}{after}",
            flush=True,
        )


if __name__ == "__main__":
    main()
