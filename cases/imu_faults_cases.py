"""Robots with faulty sensors, drawn at random: streams at their own rates, as a driver sends."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from axes_cases import cheap_robot
from scipy.spatial.transform import Rotation
from simulated.turns import smooth_wobble

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import exp_rotations
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.window import SensorLog
from magcal_ros.core.simulation import DEGREE, UP_ENU

FINE = 200.0
"""Hertz at which the truth lives."""

MOTIONS = ("turn", "lift", "half minute", "quarter")


@dataclass(frozen=True, eq=False)
class Drive:
    """The truth at even steps: attitudes ENU to body, rates and accelerations in body axes."""

    time: FloatArray
    attitude: FloatArray
    rate: FloatArray
    acceleration: FloatArray


@dataclass(frozen=True)
class Habit:
    """Unusual properties of a robot and its user.

    Parameters
    ----------
    speed, angle : tuple of float
        °/s and degrees of the turn.
    left : float
        1 to the left, -1 to the right; 0 leaves it to the movement.
    slope : float
        Degrees about each of two axes by which the floor leans, standard deviation's limit.
    lean : float
        Degrees by which it leans at least.
    pauses : int
        Halts in the middle of the turn.
    steps : tuple of int
        Of the IMU and the field, in 200ths of a second; zero leaves it to chance.
    bias : float
        °/s of the gyro's bias about each axis at most.
    weaker : float
        What the robot's body leaves of the field.
    drift : float
        Tesla by which the hard iron wanders from begin to end.
    clock : float
        Seconds that the field's clock gains in one.
    """

    speed: tuple[float, float] = (20.0, 45.0)
    angle: tuple[float, float] = (365.0, 430.0)
    left: float = 0.0
    slope: float = 5.0
    lean: float = 0.0
    pauses: int = 0
    steps: tuple[int, int] = (0, 0)
    bias: float = 0.3
    weaker: float = 1.0
    drift: float = 0.0
    clock: float = 0.0


USUAL = Habit()
HABITS = {
    "to the right": Habit(left=-1.0),
    "slow, 15 °/s": Habit(speed=(15.0, 15.0)),
    "half a turn": Habit(angle=(175.0, 190.0)),
    "slope of 10°": Habit(lean=10.0, slope=0.0),
    "field 20, IMU 200 Hz": Habit(steps=(1, 10)),
    "stop and go": Habit(pauses=3),
    "bias of 2 °/s": Habit(bias=2.0),
    "half the field": Habit(weaker=0.5),
    "hard iron drifts 3 µT": Habit(drift=3e-6),
    "clock 1 % fast": Habit(clock=0.01),
}
"""Movements and robots beside the usual ones."""


def drive(rng: np.random.Generator, kind: str, habit: Habit = USUAL) -> Drive:
    """Stand, turn once (or a quarter) and lift the nose, or drive over a kerb, as it is asked."""
    stand = 5.0 if kind in ("half minute", "quarter") else rng.uniform(2.0, 4.0)
    speed = rng.uniform(*habit.speed) * DEGREE
    angle = rng.uniform(75.0, 110.0) if kind == "quarter" else rng.uniform(*habit.angle)
    ramp, left = rng.uniform(0.4, 1.0), 1.0
    if kind in ("turn", "lift"):
        left = float(rng.choice([-1.0, 1.0]))
    halt = 2.0
    turning = angle * DEGREE / speed + habit.pauses * halt
    lift, lasts = rng.uniform(15.0, 25.0) * DEGREE, rng.uniform(3.0, 5.0)
    begins = stand + turning + ramp + 1.0
    end = begins + lasts + 2.0 if kind in ("half minute", "quarter") else begins + 2.0
    time = np.arange(0.0, end, 1.0 / FINE)
    shape = np.clip((time - stand) / ramp, 0.0, 1.0) * np.clip(
        (stand + turning + ramp - time) / ramp, 0.0, 1.0
    )
    for pause in range(habit.pauses):
        middle = stand + ramp + turning * (pause + 1.0) / (habit.pauses + 1.0)
        shape *= np.clip((np.abs(time - middle) - 0.5 * halt) / ramp + 0.5, 0.0, 1.0)
    yaw_rate = (habit.left or left) * speed * shape
    if kind == "lift":
        begins, lasts = stand + 0.2 * turning, 0.6 * turning
    rise = np.sin(np.pi * np.clip((time - begins) / lasts, 0.0, 1.0)) ** 2
    pitch = -lift * rise * (kind != "turn")
    moving = np.maximum(shape, np.clip(4.0 * rise, 0.0, 1.0) * (kind != "turn"))
    return _sway(rng, time, yaw_rate, pitch, moving, habit)


def _sway(
    rng: np.random.Generator,
    time: FloatArray,
    yaw_rate: FloatArray,
    pitch: FloatArray,
    moving: FloatArray,
    habit: Habit,
) -> Drive:
    """Add the unintended motion of a real robot."""
    n, span = len(time), float(time[-1])
    sway = moving[:, None] * smooth_wobble(rng, n, span, rng.uniform(0.1, 1.0) * DEGREE)
    tilt = sway + np.outer(pitch, [0.0, 1.0, 0.0])
    slope = rng.uniform(0.0, habit.slope) * DEGREE * rng.standard_normal(2)
    slope += np.array([habit.lean, 0.0]) * DEGREE
    ground = exp_rotations(np.array([[*slope, 0.0]]))[0]
    yaw = np.cumsum(yaw_rate) / FINE + rng.uniform(-np.pi, np.pi)
    turned = exp_rotations(np.outer(-yaw, UP_ENU))
    attitude = exp_rotations(-tilt) @ turned @ ground
    between = attitude[1:] @ np.swapaxes(attitude[:-1], 1, 2)
    part = 0.5 * (between[:, [1, 2, 0], [2, 0, 1]] - between[:, [2, 0, 1], [1, 2, 0]])
    between_moments = np.concatenate([part[:1], part, part[-1:]]) * FINE
    rate = 0.5 * (between_moments[1:] + between_moments[:-1])
    # The accelerometer sits off the turn's axis.
    lever = rng.uniform(-0.3, 0.3, 3) * [1.0, 1.0, 0.3]
    spin = np.gradient(rate, 1.0 / FINE, axis=0)
    smooth = np.ones(21) / 21.0
    spin = np.column_stack([np.convolve(spin[:, k], smooth, "same") for k in range(3)])
    acceleration = np.cross(spin, lever) + np.cross(rate, np.cross(rate, lever))
    return Drive(time, attitude, rate, acceleration)


@dataclass(frozen=True, eq=False)
class Case:
    """The samples, and what the user knows and did."""

    log: SensorLog
    knowledge: Knowledge
    turned_left: bool | None
    nose_lifted: bool


def good_case(rng: np.random.Generator, kind: str, hard: float = 1.0, habit: Habit = USUAL) -> Case:
    """Return what good sensors of a realistic robot publish.

    Parameters
    ----------
    hard : float
        Largest hard iron over the field's strength.
    habit : Habit
        What is otherwise than usual.
    """
    robot = cheap_robot(rng, np.eye(3))
    soft = rng.uniform(-0.05, 0.05, (3, 3)) * rng.uniform(0.0, 1.0)
    robot = replace(
        robot,
        gyro_bias=rng.uniform(-habit.bias, habit.bias, 3) * DEGREE,
        hard_iron=robot.hard_iron * hard,
        soft_iron=0.5 * (soft + soft.T) + (habit.weaker - 1.0) * np.eye(3),
    )
    truth = drive(rng, kind, habit)
    imu_step, field_step = int(rng.choice([2, 4])), int(rng.choice([4, 8, 10]))
    imu_step, field_step = (
        own or step for own, step in zip(habit.steps, (imu_step, field_step), strict=True)
    )
    imu, field = np.arange(0, len(truth.time), imu_step), np.arange(0, len(truth.time), field_step)
    shake = rng.choice([0.0, 0.3]) * (np.linalg.norm(truth.rate, axis=1) > 0.05)
    force = 9.80665 * truth.attitude[imu] @ UP_ENU + truth.acceleration[imu]
    noise = np.hypot(rng.uniform(0.02, 0.1), shake[imu])[:, None]
    force = force + noise * rng.standard_normal(force.shape)
    rate = (1.0 + rng.uniform(-0.01, 0.01)) * truth.rate[imu] + robot.gyro_bias
    rate = rate + rng.uniform(0.05, 0.3) * DEGREE * rng.standard_normal(rate.shape)
    raw = robot.raw_field(truth.attitude[field] @ robot.field_enu)
    raw = raw + rng.uniform(0.2e-6, 1e-6) * rng.standard_normal(raw.shape)
    raw = raw + np.outer(np.linspace(0.0, habit.drift, len(raw)), [0.6, -0.64, 0.48])
    raw = np.round(raw / 0.1e-6) * 0.1e-6
    jitter = [1e-3 * rng.standard_normal(len(rows)) for rows in (imu, field)]
    late = rng.uniform(0.0, 4e-3)
    stamps = [100.0 + truth.time[rows] + j for rows, j in zip((imu, field), jitter, strict=True)]
    stamps[1] += habit.clock * truth.time[field]
    # The driver's own orientation, to magnetic north.
    own = Rotation.from_matrix(np.swapaxes(truth.attitude[imu], 1, 2)).as_quat()
    log = SensorLog(np.sort(stamps[0]), force, rate, np.sort(stamps[1]) + late, raw, own)
    knowledge = Knowledge(robot.knowledge(2e-6, 2.0 * DEGREE).reference)
    guided = kind in ("half minute", "quarter")
    return Case(log, knowledge, habit.left >= 0.0 if guided else None, guided)


Fault = Callable[[np.random.Generator, SensorLog], SensorLog]


def _swapped(i: int, j: int) -> list[int]:
    order = [0, 1, 2]
    order[i], order[j] = j, i
    return order


def _rates(change: Callable[[FloatArray], FloatArray]) -> Fault:
    return lambda _, log: replace(log, rate=change(log.rate))


def _biased(rng: np.random.Generator, log: SensorLog) -> SensorLog:
    direction = rng.standard_normal(3)
    bias = rng.uniform(1.0, 5.0) * DEGREE * direction / np.linalg.norm(direction)
    return replace(log, rate=log.rate + bias)


def _late(rng: np.random.Generator, log: SensorLog) -> SensorLog:
    lag = rng.choice([-1.0, 1.0]) * rng.uniform(0.02, 0.5)
    return replace(log, field_time=log.field_time + lag)


def _force_late(rng: np.random.Generator, log: SensorLog) -> SensorLog:
    lag = rng.uniform(0.04, 0.3)
    return replace(log, force=_at(log.imu_time, log.force, log.imu_time - lag))


def _gyro_ahead(rng: np.random.Generator, log: SensorLog) -> SensorLog:
    lag = rng.uniform(0.04, 0.3)
    return replace(log, rate=_at(log.imu_time, log.rate, log.imu_time + lag))


def _at(time: FloatArray, values: FloatArray, moment: FloatArray) -> FloatArray:
    """Return the sample that was newest in each moment, as a driver's buffer has it."""
    return values[np.clip(np.searchsorted(time, moment, "right") - 1, 0, len(time) - 1)]


def _bursts(_: np.random.Generator, log: SensorLog) -> SensorLog:
    def burst(time: FloatArray) -> FloatArray:
        second = np.ceil(time)
        rank = np.arange(len(time)) - np.searchsorted(second, second)
        return np.asarray(second + 1e-3 * rank)

    return replace(log, imu_time=burst(log.imu_time), field_time=burst(log.field_time))


def _repeats(rng: np.random.Generator, log: SensorLog) -> SensorLog:
    field = log.field.copy()
    for row in np.flatnonzero(rng.random(len(field)) < 0.1).tolist():
        field[row] = field[max(row - 1, 0)]
    return replace(log, field=field)


def _coarse(_: np.random.Generator, log: SensorLog) -> SensorLog:
    return replace(log, field=np.round(log.field / 0.6e-6) * 0.6e-6)


def _saturated(rng: np.random.Generator, log: SensorLog) -> SensorLog:
    axis = int(rng.integers(2))
    iron = np.zeros(3)
    middle = 0.5 * (log.field[:, axis].max() + log.field[:, axis].min())
    half = 0.5 * np.ptp(log.field[:, axis])
    iron[axis] = rng.choice([-1.0, 1.0]) * (130e-6 - rng.uniform(0.0, 0.7) * half)
    iron[axis] -= middle
    return replace(log, field=np.clip(log.field + iron, -130e-6, 130e-6))


def _frozen(rng: np.random.Generator, log: SensorLog) -> SensorLog:
    which = str(rng.choice(["force", "rate", "field"]))
    values = getattr(log, which).copy()
    first = int(rng.uniform(0.0, 0.5) * len(values))
    values[first:] = values[first]
    return replace(log, **{which: values})


FAULTS: dict[str, tuple[Fault, tuple[str, ...]]] = {
    "gravity's sign": (lambda _, log: replace(log, force=-log.force), ("gravity_sign",)),
    "g for m/s²": (lambda _, log: replace(log, force=log.force / 9.80665), ("force_unit",)),
    "degrees for rad": (_rates(np.degrees), ("rate_unit",)),
    "rate 57 times small": (_rates(np.radians), ("rate_unit",)),
    "rate 562 times large": (_rates(lambda r: 562.0 * r), ("rate_unit",)),
    **{
        f"gyro {name} mirrored": (
            _rates(partial(np.multiply, np.where(np.arange(3) == k, -1.0, 1.0))),
            ("gyro_axes",),
        )
        for k, name in enumerate("xyz")
    },
    **{
        f"gyro {'xyz'[i]}, {'xyz'[j]} swapped": (
            _rates(partial(np.take, indices=_swapped(i, j), axis=1)),
            ("gyro_axes",),
        )
        for i, j in itertools.combinations(range(3), 2)
    },
    "rate z as x": (
        _rates(lambda r: np.column_stack([r[:, 2], r[:, 1], r[:, 0]])),
        ("gyro_axes",),
    ),
    "scale +5 %": (_rates(lambda r: 1.05 * r), ("rate_scale",)),
    "scale -5 %": (_rates(lambda r: 0.95 * r), ("rate_scale",)),
    "bias 1-5 °/s": (_biased, ("gyro_bias",)),
    "latency 20-500 ms": (_late, ("latency",)),
    "accelerometer late": (_force_late, ("force_latency",)),
    "gyro ahead": (_gyro_ahead, ("latency", "force_latency")),
    "bursts of 1 s": (_bursts, ("bursts",)),
    "10 % repeats": (_repeats, ("repeats",)),
    "LSB .6 µT": (_coarse, ("resolution",)),
    "saturation": (_saturated, ("saturation",)),
    "frozen": (_frozen, ("frozen",)),
}
"""What is done to good streams, and the key of the finding that names it."""
