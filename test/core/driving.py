"""A robot on a long drive: straights, curves, bumps, passing steel; in steps of 0.1 s."""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core import Calibration
from magcal_ros.core.calibration import Evidence
from magcal_ros.core.geometry import STANDARD_GRAVITY, exp_rotations, yaw_from_up_and_field
from magcal_ros.core.heading import CompassReading, Heading
from magcal_ros.core.simulation import Robot
from magcal_ros.core.up import Up

PERIOD = 0.1
SPEED = 0.8

ROBOT = Robot()


def promise(robot=ROBOT, heading_sigma=math.radians(0.3)):
    """The calibration of a perfect turn on this robot."""
    evidence = Evidence("m", "good", "good", "", figures={"heading_sigma": heading_sigma})
    return Calibration(
        robot.true_correction,
        np.zeros((12, 12)),
        robot.noise_field,
        0.01,
        robot.strength,
        robot.inclination,
        evidence,
    )


@dataclass(frozen=True)
class Route:
    """How the robot drives.

    `turns` are the sides it may turn to, `headings` where it may go (None: anywhere), `parked` the
    span of seconds in which it stands, `steel` tesla of a field that comes and goes with the
    place, `slope` radians of ground that leans anyhow.
    """

    turns: tuple = (-1.0, 1.0)
    headings: tuple | None = None
    parked: tuple = (0.0, 0.0)
    steel: float = 0.0
    slope: float = 0.0
    wobble: float = math.radians(1.0)


def yaws(rng, way, moments):
    """Yaw and its rate: straights of 2 to 15 s, and turns between them."""
    rate = []
    heading = 0.0
    while len(rate) < moments:
        rate += [0.0] * int(rng.uniform(20, 150))
        side, speed = rng.choice(way.turns), rng.uniform(0.2, 0.6)
        goal = rng.uniform(0.3, math.pi) if way.headings is None else None
        if goal is None:
            goal = (side * (rng.choice(way.headings) - heading)) % math.tau
        steps = max(1, int(goal / speed / PERIOD))
        rate += [side * goal / (steps * PERIOD)] * steps
        heading += side * goal
    rate = np.array(rate[:moments])
    stands = slice(*(int(moment / PERIOD) for moment in way.parked))
    rate[stands] = 0.0
    return np.cumsum(rate) * PERIOD, rate, stands


def smooth(rng, moments, seconds):
    """Three columns of smooth noise of size one that changes within so many seconds."""
    # Loading it takes as long as a test, and who only collects needs none of it.
    from scipy.signal import lfilter

    share = math.exp(-PERIOD / seconds)
    kicks = rng.standard_normal((moments, 3)) * math.sqrt(1.0 - share**2)
    return lfilter([1.0], [1.0, -share], kicks, axis=0)


def drive(watch, calibration, robots, minutes, way=Route(), seed=1, start=1000.0, gyro=True):
    """Drive one robot after the other for these minutes each, with the same calibration.

    Returns the results of the monitor, a (stamp, MonitorResult) each half minute.
    """
    rng = np.random.default_rng(seed)
    moments = int(sum(minutes) * 60.0 / PERIOD)
    yaw, rate, stands = yaws(rng, way, moments)
    driving = np.ones((moments, 1))
    driving[stands] = 0.0
    lean = way.wobble * smooth(rng, moments, 0.3) + way.slope * smooth(rng, moments, 20.0)
    body = bodies(yaw, lean * driving)
    steel = way.steel * smooth(rng, moments, 4.0)
    ends = np.cumsum(minutes)[:-1] * 60.0 / PERIOD
    pieces = np.split(np.arange(moments), ends.astype(int))
    noise = rng.standard_normal((3, moments, 3))
    field = np.concatenate(
        [
            robot.raw_field(np.einsum("nij,nj->ni", body[rows], robot.field_enu + steel[rows]))
            + robot.noise_field * noise[0, rows]
            for robot, rows in zip(robots, pieces, strict=True)
        ]
    )
    field = calibration.correction.apply(field)
    force = STANDARD_GRAVITY * body[:, :, 2] + 0.3 * driving * noise[1]
    force[:, 1] += SPEED * rate * driving[:, 0]
    turning = rate[:, None] * body[:, :, 2] + 1e-3 * noise[2] + np.radians([0.05, 0.0, 0.1])
    turning = turning if gyro else np.full_like(turning, math.nan)
    heading = yaw_from_up_and_field(force, field)
    stamps = start + PERIOD * np.arange(moments)
    return feed(watch, *(rows.tolist() for rows in (stamps, field, force, heading, turning)))


def feed(watch, *columns):
    stated = []
    for k, (stamp, field, force, heading, turning) in enumerate(zip(*columns, strict=True)):
        up = Up(tuple(np.array(force) / np.linalg.norm(force)), 0.0)
        seen = Heading(0.0, 0.0, heading, 0.0, 0.0, 0.0, 0.0)
        watch.take(CompassReading(stamp, tuple(field), up, seen, tuple(turning)))
        if k % 300 == 299:
            stated.append((stamp, watch.result))
    return stated


def bodies(yaw, lean):
    """Rotations ENU to body (n, 3, 3), with small tilts about the body's x and y."""
    c, s, none, one = np.cos(yaw), np.sin(yaw), np.zeros_like(yaw), np.ones_like(yaw)
    level = np.array([[c, s, none], [-s, c, none], [none, none, one]]).transpose(2, 0, 1)
    return exp_rotations(-lean * np.array([1.0, 1.0, 0.0])) @ level


def changed(x=0.0, y=0.0, z=0.0, **changes):
    """The robot after its hard iron has moved by microtesla in its body axes, or otherwise."""
    moved = dataclasses.replace(ROBOT, **changes)
    shift = moved.distortion @ (np.array([x, y, z]) * 1e-6)
    return dataclasses.replace(moved, hard_iron=ROBOT.hard_iron + shift)
