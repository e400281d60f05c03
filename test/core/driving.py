"""A robot on a long drive: straights, curves, bumps, passing steel; in moments 0.1 s apart."""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.attitude import STANDARD_GRAVITY, yaw_from_up_and_field
from magcal_ros.core.calibration import Calibration, Evidence
from magcal_ros.core.simulator import Robot

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
class Way:
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
    share = math.exp(-PERIOD / seconds)
    kicks = rng.standard_normal((moments, 3)) * math.sqrt(1.0 - share**2)
    out = np.zeros((moments, 3))
    for k in range(1, moments):
        out[k] = share * out[k - 1] + kicks[k]
    return out


def drive(watch, calibration, robots, minutes, way=Way(), seed=1, start=1000.0, gyro=True):
    """Drive one robot after the other, each for so many minutes, under the same calibration.

    Returns what the watch said, a (stamp, Watched) each half minute.
    """
    rng = np.random.default_rng(seed)
    said = []
    moments = int(sum(minutes) * 60.0 / PERIOD)
    yaw, rate, stands = yaws(rng, way, moments)
    lean = way.wobble * smooth(rng, moments, 0.3) + way.slope * smooth(rng, moments, 20.0)
    steel = way.steel * smooth(rng, moments, 4.0)
    ends = np.cumsum(minutes) * 60.0
    for k in range(moments):
        robot = robots[int(np.searchsorted(ends, k * PERIOD, side="right"))]
        stamp = start + k * PERIOD
        driving = not stands.start <= k < stands.stop
        watch.add(stamp, *moment(robot, calibration, yaw[k], rate[k], lean[k], steel[k], rng,
                                 driving, gyro))  # fmt: skip
        if k % 300 == 299:
            said.append((stamp, watch.watched))
    return said


def moment(robot, calibration, yaw, rate, lean, steel, rng, driving, gyro):
    """What the node has in hand at one moment: field, force, yaw, rate."""
    c, s = math.cos(yaw), math.sin(yaw)
    body = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    tilt = np.array([[1, 0, -lean[1]], [0, 1, lean[0]], [lean[1], -lean[0], 1.0]])
    body = tilt @ body if driving else body
    field = robot.raw_field((body @ (robot.field_enu + steel))[None])[0]
    field = calibration.correction.apply(field + robot.noise_field * rng.standard_normal(3))
    force = STANDARD_GRAVITY * body[:, 2] + 0.3 * driving * rng.standard_normal(3)
    if driving:
        force[1] += SPEED * rate
    measured = rate * body[:, 2] + 1e-3 * rng.standard_normal(3) + np.radians([0.05, 0.0, 0.1])
    measured = measured if gyro else np.full(3, math.nan)
    heading = float(yaw_from_up_and_field(force, field))
    return tuple(field), tuple(force), heading, tuple(measured)


def changed(x=0.0, y=0.0, z=0.0, **changes):
    """The robot after its hard iron has moved by microtesla in its body axes, or otherwise."""
    moved = dataclasses.replace(ROBOT, **changes)
    shift = moved.distortion @ (np.array([x, y, z]) * 1e-6)
    return dataclasses.replace(moved, hard_iron=ROBOT.hard_iron + shift)
