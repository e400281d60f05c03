"""Known headings instead of a turn: `python benchmarks/known_headings.py [--robots N]`.

Robots with the sensors of `realistic.py` stand at one to three known headings, on slopes and in a
field that differs from place to place. Printed are the RMS error of the heading over all headings
on the level, its sigma, and NEES; then the results for wrong headings.

With `--outages N`: N drives through a city (those of `driving.py`) with two antennas for four
minutes, which calibrate the compass; then they are silent. Printed are the errors of the fused yaw
after 60, 300 and 600 s and their sigmas. Those of the gyro alone are printed with the bias that
the antennas have shown, and with the bias that each rest shows.
"""

from __future__ import annotations

import argparse
import copy
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import shared_cases  # noqa: F401
from honesty_cases import sigma_at
from simulated.drive import Drive, Vehicle, simulated_drive
from simulated.legs import city
from simulated.travel import travel
from simulated.turns import slope_rpy

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.heading_sigma import predicted_heading_sigma
from magcal_ros.core.errors import Refusal
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import (
    STANDARD_GRAVITY,
    wrap_angle,
    wrapped,
    yaw_from_up_and_field,
)
from magcal_ros.core.geometry.rotations import rotation_from_rpy
from magcal_ros.core.geometry.vec3 import minus, plus
from magcal_ros.core.heading.compass import Compass, CompassReader
from magcal_ros.core.heading.fused_yaw import FusedYaw
from magcal_ros.core.knowledge import Belief, Knowledge, ReferenceField
from magcal_ros.core.methods.known_headings import declination_hint, fit
from magcal_ros.core.samples.streams import FieldSample, HeadingSample, ImuSample
from magcal_ros.core.session.at_known_heading import HeadingCollector, fit_log
from magcal_ros.core.simulation import DEGREE, Robot
from magcal_ros.core.smoother.headings import KnownHeadingMeasurement
from magcal_ros.core.up.follower import UpFollower
from magcal_ros.core.up.propagation import GyroBias

HEADINGS = 24
TOLD: dict[str, Callable[[float, float], float]] = {
    "right": lambda reported, _: reported,
    "as a compass bearing": lambda reported, _: 0.5 * math.pi - reported,
    "with the wrong sign": lambda reported, _: -reported,
    "half a turn off": lambda reported, _: reported + math.pi,
    "a quarter turn off": lambda reported, _: reported - 0.5 * math.pi,
    "magnetic for true": lambda reported, declination: reported + declination,
}
"""The heading that is given instead of one to true north, by it and the declination, radians."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A robot with the errors of its sensors, the prior knowledge, and its known headings."""

    robot: Robot
    distortion: FloatArray
    offset: FloatArray
    knowledge: Knowledge
    measurements: list[KnownHeadingMeasurement]

    def errors(
        self, measurements: list[KnownHeadingMeasurement] | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return the heading's errors on the level, and its variances."""
        estimate = fit(self.measurements if measurements is None else measurements, self.knowledge)
        yaws = np.arange(HEADINGS) * math.tau / HEADINGS
        poses = np.array([rotation_from_rpy(0.0, 0.0, yaw).T for yaw in yaws])
        field = poses @ self.robot.field_enu @ self.distortion.T + self.robot.hard_iron
        up = STANDARD_GRAVITY * poses[:, :, 2] + self.offset
        corrected = estimate.correction.apply(field)
        magnetic = yaws + self.robot.declination
        off = wrap_angle(yaw_from_up_and_field(up, corrected) - magnetic)
        return off, sigma_at(estimate, up, corrected) ** 2


def drawn(
    rng: np.random.Generator, count: int, sigma: float = 1.0, declination: float = 0.0
) -> Scene:
    """Draw a robot that has stood at so many headings, spread over the circle by about a tenth."""
    robot = Robot(
        inclination=rng.uniform(50.0, 70.0) * DEGREE,
        declination=declination * DEGREE,
        roll=rng.normal(0.0, 3.0) * DEGREE,
        pitch=rng.normal(0.0, 3.0) * DEGREE,
        yaw=rng.normal(0.0, 2.0) * DEGREE,
        hard_iron=rng.normal(0.0, 20e-6, 3),
    )
    axes = 0.005 * math.exp(0.6 * rng.standard_normal()) * rng.standard_normal((3, 3))
    distortion = (np.eye(3) + axes) @ robot.distortion
    offset = 0.05 * rng.standard_normal(3)
    place = 0.7e-6 * math.exp(0.5 * rng.standard_normal())
    first, measurements = rng.uniform(0.0, math.tau), []
    for k in range(count):
        yaw = first + k * math.tau / count + rng.normal(0.0, 0.3)
        slope = abs(rng.normal(0.0, 2.0)) * DEGREE
        pose = rotation_from_rpy(*slope_rpy(slope, rng.uniform(0.0, math.tau), yaw)).T
        here = robot.field_enu + place * rng.standard_normal(3)
        field = distortion @ (pose @ here) + robot.hard_iron + 0.15e-6 * rng.standard_normal(3)
        force = STANDARD_GRAVITY * pose[:, 2] + offset + 0.005 * rng.standard_normal(3)
        reported = math.atan2(pose[0, 1], pose[0, 0]) + sigma * DEGREE * rng.standard_normal()
        measurements.append(
            KnownHeadingMeasurement(
                field,
                force,
                wrapped(reported + robot.declination),
                sigma * DEGREE,
                by_declination=declination != 0.0,
            )
        )
    strength = Belief(robot.strength + rng.normal(0.0, 1.5e-6), 1.5e-6)
    dip = Belief(robot.inclination + rng.normal(0.0, 1.0) * DEGREE, DEGREE)
    reference = ReferenceField(strength, dip, declination * DEGREE, 0.5 * DEGREE)
    return Scene(robot, distortion, offset, Knowledge(reference), measurements)


def row(robots: int, count: int, sigma: float, declination: float = 0.0) -> str:
    """Return a row of the table: RMS error, median sigma, NEES."""
    square, stated, nees, refused = [], [], [], 0
    for seed in range(robots):
        scene = drawn(np.random.default_rng(seed), count, sigma, declination)
        try:
            off, variance = scene.errors()
        except Refusal:
            refused += 1
            continue
        square.append(np.mean(off**2))
        stated.append(math.sqrt(np.mean(variance)))
        nees.append(np.mean(off**2) / np.mean(variance))
    rms, median = math.sqrt(np.mean(square)) / DEGREE, np.median(stated) / DEGREE
    north = "true" if declination else "magnetic"
    return (
        f"| {count} | {sigma:g}° to {north} north | {rms:.2f} | {median:.2f} | "
        f"{np.mean(nees):.2f} | {refused} of {robots} |"
    )


def told_wrongly(robots: int, count: int, declination: float) -> None:
    """Print the results with wrong headings."""
    print(f"\n{count} headings, told wrongly; the declination is {declination:g}°")
    print("| told | taken | named | refused |\n|---|---|---|---|")
    for name, change in TOLD.items():
        came: Counter[str] = Counter()
        for seed in range(robots):
            scene = drawn(np.random.default_rng(1000 + seed), count, 1.0, declination)
            shift = scene.robot.declination
            reported = [
                replace(each, heading=wrapped(change(each.heading - shift, shift) + shift))
                for each in scene.measurements
            ]
            try:
                estimate = fit(reported, scene.knowledge)
                hint = declination_hint(estimate, reported, scene.knowledge)
                came["named" if hint else "taken"] += 1
            except Refusal as refusal:
                came["named" if "Corrected so" in str(refusal) else "refused"] += 1
        print(f"| {name} | {came['taken']} | {came['named']} | {came['refused']} |")


HEARD, SILENT = 240.0, (60.0, 300.0, 600.0)
"""Seconds with the antennas, and of the silence after which the yaw is looked at."""
PATIENCE = 30.0


class Follower:
    """Processes a drive as the node does, with the headings of two antennas and without."""

    def __init__(self, drive: Drive, knowledge: Knowledge, rng: np.random.Generator) -> None:
        self._drive, self._knowledge, self._rng = drive, knowledge, rng
        self._forward = drive.vehicle.imu_pose[0]
        self._up = UpFollower()
        self._collector = HeadingCollector(self._up)
        self._fused: FusedYaw | None = None
        self._compass: Compass | None = None
        self._gyros: list[FusedYaw] = []
        self._shown: GyroBias | None = None
        self.calibration: Calibration | None = None
        self.found: list[list[float]] = []
        """Seconds of silence; radians: error of the fused yaw, its sigma, errors of the gyro with
        the bias that headings showed, and where rests show it as well."""

    def run(self) -> None:
        """Go through the drive."""
        begin, next_, k = self._drive.time[0], self._drive.time[0], -1
        truth = self._drive.imu_yaw
        waiting = list(SILENT)
        for sample in self._drive.samples():
            since = sample.stamp - begin
            if isinstance(sample, ImuSample):
                k += 1
                self._on_imu(sample)
                if since > HEARD and self._fused and not self._gyros:
                    self._gyros = [copy.deepcopy(self._fused), copy.deepcopy(self._fused)]
                    self._shown = self._up.gyro_bias
                if waiting and since >= HEARD + waiting[0] and self._fused:
                    yaws = [each.heading() for each in (self._fused, *self._gyros)]
                    off = [wrapped(each.yaw - truth[k]) for each in yaws if each]
                    assert yaws[0] is not None
                    sigma = math.sqrt(yaws[0].yaw_variance)
                    self.found.append([waiting.pop(0), off[0], sigma, *off[1:]])
            elif isinstance(sample, FieldSample):
                self._on_field(sample, since, k)
                if since < HEARD and sample.stamp >= next_:
                    next_ += 0.2
                    self._on_heading(self._told(sample.stamp, k))

    def _told(self, stamp: float, k: int) -> HeadingSample:
        """Return the headings of the antennas, to true north."""
        attitude = self._drive.truth.attitude[k]
        yaw = math.atan2(attitude[0, 1], attitude[0, 0])
        return HeadingSample(stamp, yaw + DEGREE * self._rng.standard_normal(), DEGREE)

    def _on_imu(self, sample: ImuSample) -> None:
        self._up.add(sample)
        follower = self._up
        up = follower.at(sample.stamp, 0.0)
        self._collector.on_imu(sample.stamp)
        if up is None or self._fused is None:
            return
        for fused in (self._fused, *self._gyros[1:]):
            fused.propagate_by(sample.stamp, follower)
        if self._shown is not None:
            rate = plus(follower.mean_rate, minus(follower.gyro_bias.rate, self._shown.rate))
            self._gyros[0].propagate(sample.stamp, up, rate, self._shown)

    def _on_field(self, sample: FieldSample, since: float, k: int) -> None:
        self._up.add_field(sample.stamp, sample.field)
        if self._up.at(sample.stamp, 0.2) is None:
            return
        if since < HEARD:
            self._collector.on_heading(self._told(sample.stamp, k))
            if self._collector.on_field(
                sample, self._forward, True, self._knowledge.reference, 0.2
            ):
                self._calibrate()
        if self._compass is not None and self._fused is not None:
            self._fused.correct(CompassReader(self._up).read(self._compass, sample))

    def _calibrate(self) -> None:
        outcome, _ = fit_log(self._collector.measurements, self._knowledge)
        if outcome.verdict.accepted and outcome.calibration is not None:
            self.calibration = outcome.calibration
            self._compass = Compass(outcome.calibration)
            if self._fused is None:
                self._fused = FusedYaw(outcome.calibration, PATIENCE)
            self._fused.use(outcome.calibration, PATIENCE)

    def _on_heading(self, reported: HeadingSample) -> None:
        if self._fused is not None:
            x, y, z = self._forward.tolist()
            yaw = reported.yaw + (self._knowledge.reference.declination or 0.0)
            self._fused.take_heading(reported.stamp, yaw, reported.sigma**2, (x, y, z))


def outages(drives: int, first: int) -> None:
    """Print the errors of the fused yaw after two antennas stop."""
    print(
        "| silent, s | fused, RMS° (worst) | said° | NEES | gyro alone, RMS° | fused is better",
        end="",
    )
    print(" | gyro and rests, RMS° | fused is better |")
    print("|---|---|---|---|---|---|---|---|")
    found, sigmas = [], []
    for seed in range(first, first + drives):
        rng = np.random.default_rng(seed)
        robot = Robot(
            yaw=rng.normal(0.0, 2.0) * DEGREE,
            declination=5.0 * DEGREE,
            hard_iron=rng.normal(0.0, 20e-6, 3),
            noise_force=0.05,
            noise_rate=2e-3,
            noise_field=0.3e-6,
            gyro_bias=rng.normal(0.0, 0.002, 3),
        )
        vehicle = Vehicle(robot, imu_yaw=0.3, imu_ahead=0.5)
        truth = travel(city(rng, HEARD + SILENT[-1] + 20.0), rng, rate=25.0)
        drive = simulated_drive(truth, rng, vehicle, wheels=None, receiver=None)
        strength = Belief(robot.strength + rng.normal(0.0, 1.5e-6), 1.5e-6)
        dip = Belief(robot.inclination + rng.normal(0.0, 1.0) * DEGREE, DEGREE)
        reference = ReferenceField(strength, dip, robot.declination, 0.5 * DEGREE)
        follower = Follower(drive, Knowledge(reference), rng)
        follower.run()
        found += follower.found
        if follower.calibration is not None:
            sigmas.append(predicted_heading_sigma(follower.calibration))
    for silent in SILENT:
        rows = np.array([row[1:] for row in found if row[0] == silent])
        fused, stated, *gyros = rows.T
        worst = np.abs(fused).max() / DEGREE
        print(
            f"| {silent:g} | {rms_degrees(fused):.2f} ({worst:.1f}) | "
            f"{np.median(stated) / DEGREE:.2f} | {np.mean((fused / stated) ** 2):.2f} |",
            *(
                f"{rms_degrees(gyro):.2f} | {np.sum(np.abs(fused) < np.abs(gyro))} of {len(rows)} |"
                for gyro in gyros
            ),
        )
    print(f"the compass is calibrated to ±{np.median(sigmas) / DEGREE:.1f}° (median)")


def rms_degrees(errors: FloatArray) -> float:
    """Return the root mean square of radians in degrees."""
    return math.sqrt(np.mean(errors**2)) / DEGREE


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=150, help="in each row (default 150)")
    parser.add_argument("--outages", type=int, default=0, help="drives with antennas; alone")
    parser.add_argument("--first", type=int, default=0, help="first seed of those drives")
    options = parser.parse_args()
    if options.outages:
        outages(options.outages, options.first)
        return
    robots = options.robots
    print("| headings | told to | RMS° | said° | NEES | refused |\n|---|---|---|---|---|---|")
    for count in (1, 2, 3):
        print(row(robots, count, 1.0), flush=True)
    print(row(robots, 3, 3.0))
    print(row(robots, 3, 1.0, 10.0))
    for count in (2, 3):
        told_wrongly(max(1, robots // 6), count, 10.0)


if __name__ == "__main__":
    main()
