"""Random turns and their faults, for `honesty.py`."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from simulated.turns import Motion, Trouble, measure, smooth_wobble, turn

from magcal_ros.core.assessment.grading import Grade
from magcal_ros.core.calibrate import Outcome, calibrate
from magcal_ros.core.calibration.calibration import Estimate, yaw_jacobian
from magcal_ros.core.calibration.heading_sigma import calibration_sigma
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import yaw_from_up_and_field as yaw_of
from magcal_ros.core.geometry.rotations import rotation_about
from magcal_ros.core.knowledge import Belief, Knowledge, ReferenceField
from magcal_ros.core.samples.window import Window
from magcal_ros.core.simulation import DEGREE, LEVEL_TILT, Robot, trial_attitudes

MIRRORS = {
    "swap x and y": np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]]),
    "swap y and z": np.array([[1.0, 0, 0], [0, 0, 1], [0, 1, 0]]),
    "cycle": np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]),
    "negate x": np.diag([-1.0, 1.0, 1.0]),
    "negate z": np.diag([1.0, 1.0, -1.0]),
}


@dataclass(frozen=True, eq=False)
class Case:
    """One measured turn, and its truth."""

    robot: Robot
    motion: Motion
    window: Window
    knowledge: Knowledge
    wiring: FloatArray
    """What became of the field's axes between sensor and topic."""
    body: FloatArray = field(default_factory=lambda: np.eye(3))
    """The body's axes as the topics have them, in the robot's."""
    hidden: bool = False


@dataclass(frozen=True)
class Draw:
    """The numbers of one turn without further faults."""

    robot: Robot
    motion: Motion
    trouble: Trouble
    gyro: bool
    reference: str


Spoil = Callable[[np.random.Generator, Case], Case]


def draw_case(seed: int, number: int) -> tuple[str, Case]:
    """Draw one case; the same numbers give the same case."""
    rng = np.random.default_rng([seed, number])
    kind = list(KINDS)[number % len(KINDS)]
    wild = kind == "wild" or (kind != "good" and rng.random() < 0.3)
    draw = draw_turn(rng, wild)
    if kind in NEEDS_GYRO:
        draw = replace(draw, gyro=True)
    window = measure(draw.robot, draw.motion, rng, gyro=draw.gyro, trouble=draw.trouble)
    knowledge = draw_knowledge(rng, draw.robot, draw.reference)
    case = Case(draw.robot, draw.motion, window, knowledge, np.eye(3))
    return kind, KINDS[kind](rng, case)


def draw_turn(rng: np.random.Generator, wild: bool) -> Draw:
    def up_to(mild: float, worst: float) -> float:
        return float(rng.uniform(0.0, worst if wild else mild))

    arc = rng.uniform(20, 400) if wild else rng.uniform(360, 400)
    samples = round(math.exp(rng.uniform(math.log(30 if wild else 150), math.log(3000))))
    duration = rng.uniform(6.0, 40.0)
    noise = math.exp(rng.uniform(math.log(0.3), math.log(4.0 if wild else 1.5)))
    dip = rng.uniform(-80, 80) if wild else rng.choice([-1, 1]) * rng.uniform(0, 72)
    strength = rng.uniform(25e-6, 65e-6)
    direction = rng.standard_normal(3)
    iron = direction / np.linalg.norm(direction) * up_to(1.5, 3.0) * strength
    soft = up_to(0.02, 0.15) * rng.uniform(-1, 1, (3, 3))
    lean, slope = up_to(8, 60) * DEGREE, up_to(8, 20) * DEGREE
    spin, side = rng.uniform(0, math.tau, 2)
    turned, installed = rng.uniform(0, math.tau), up_to(8, 60) * DEGREE
    robot = Robot(
        strength=strength,
        inclination=dip * DEGREE,
        roll=installed * math.cos(turned),
        pitch=installed * math.sin(turned),
        hard_iron=iron,
        soft_iron=0.5 * (soft + soft.T),
        noise_field=noise * 0.5e-6,
        noise_force=noise * 0.098,
        noise_rate=1e-3 * noise,
        gyro_bias=2e-3 * rng.standard_normal(3),
    )
    motion = turn(
        arc=arc * DEGREE * rng.choice([-1, 1]),
        samples=samples,
        duration=duration,
        axis=np.array([math.sin(lean) * math.cos(spin), math.sin(lean) * math.sin(spin),
                       math.cos(lean)]),
        start_rpy=(slope * math.cos(side), slope * math.sin(side), rng.uniform(0, math.tau)),
        # No faster than such a gyro, sampled so slowly, can follow.
        wobble=smooth_wobble(
            rng, samples, duration, up_to(3, 15) * DEGREE, (0.05, min(1.5, samples / duration / 15))
        ),
    )  # fmt: skip
    trouble = Trouble(outliers=up_to(0.02, 0.4) if rng.random() < 0.5 else 0.0)
    reference = rng.choice(["exact", "model", "indoors", "unknown"][: 4 if wild else 3])
    return Draw(robot, motion, trouble, bool(rng.random() < 0.6), str(reference))


def draw_knowledge(rng: np.random.Generator, robot: Robot, reference: str) -> Knowledge:
    """Return the knowledge of the reference field, with an error of its sigma."""
    if reference == "exact":
        return replace(robot.knowledge(), exact_sensors=False)
    if reference == "unknown":
        return Knowledge(ReferenceField())
    share, angle = (0.03, 1.0 * DEGREE) if reference == "model" else (0.15, 5.0 * DEGREE)
    strength = robot.strength * (1.0 + share * rng.standard_normal())
    dip = robot.inclination + angle * rng.standard_normal()
    limit = 79.0 * DEGREE
    beliefs = Belief(strength, share * strength), Belief(float(np.clip(dip, -limit, limit)), angle)
    return Knowledge(ReferenceField(*beliefs))


def with_field(case: Case, extra_enu: FloatArray) -> Case:
    """Add a field that is fixed in the world but differs from sample to sample."""
    body = np.einsum("nij,nj->ni", case.motion.attitude, extra_enu)
    raw = case.window.field + body @ case.robot.distortion.T
    return replace(case, window=replace(case.window, field=raw), hidden=is_blind(case))


def is_blind(case: Case) -> bool:
    return case.window.angular_rate is None


def headings(case: Case) -> FloatArray:
    attitude = case.motion.attitude
    return np.arctan2(attitude[:, 0, 1], attitude[:, 0, 0])


def leave(_: np.random.Generator, case: Case) -> Case:
    return case


def swing(rng: np.random.Generator, case: Case) -> Case:
    """A room that rotates the field periodically and keeps its length: the circle is unchanged."""
    angle = rng.uniform(3, 25) * DEGREE * np.sin(headings(case) + rng.uniform(0, math.tau))
    straight = case.robot.field_enu
    turned = rotation_about(np.array([0.0, 0.0, 1.0]), angle) @ straight
    return with_field(case, turned - straight)


def gradient(rng: np.random.Generator, case: Case) -> Case:
    """A sensor that goes round off the axis, beside iron: 2 to 30 % of the field."""
    size = rng.uniform(0.02, 0.3) * case.robot.strength
    angle = -headings(case) + rng.uniform(0, math.tau)
    up = rng.uniform(-1, 1) * np.cos(headings(case) + rng.uniform(0, math.tau))
    return with_field(case, size * np.column_stack([np.cos(angle), np.sin(angle), up]))


def passing(rng: np.random.Generator, case: Case) -> Case:
    """Something magnetic comes and goes for 5 to 50 % of the turn."""
    n = len(case.window)
    share = rng.uniform(0.05, 0.5)
    phase = (np.arange(n) / n - rng.uniform(0, 1 - share)) / share
    bump = np.where((phase > 0) & (phase < 1), np.sin(math.pi * phase) ** 2, 0.0)
    direction = rng.standard_normal(3)
    size = rng.uniform(0.03, 0.6) * case.robot.strength / np.linalg.norm(direction)
    return replace(with_field(case, size * bump[:, None] * direction), hidden=False)


def wire_field(rng: np.random.Generator, case: Case) -> Case:
    """Axes of the magnetometer that are not the IMU's."""
    wiring = MIRRORS[str(rng.choice(list(MIRRORS)))]
    window = replace(case.window, field=case.window.field @ wiring.T)
    return replace(case, window=window, wiring=wiring, hidden=is_blind(case))


def flip_magnetometer(_: np.random.Generator, case: Case) -> Case:
    """The magnetometer alone sits upside down."""
    wiring = rotation_about(np.array([1.0, 0, 0]), np.array([math.pi]))[0]
    window = replace(case.window, field=case.window.field @ wiring.T)
    return replace(case, window=window, wiring=wiring, hidden=is_blind(case))


def flip_board(rng: np.random.Generator, case: Case) -> Case:
    """Both sensors upside down, or an accelerometer published as gravity."""
    if rng.random() < 0.5:
        return replace(
            case, window=replace(case.window, specific_force=-case.window.specific_force)
        )
    flip, rate = np.diag([1.0, -1.0, -1.0]), case.window.angular_rate
    window = Window(
        case.window.time,
        case.window.field @ flip,
        case.window.specific_force @ flip,
        None if rate is None else rate @ flip,
    )
    # A body turned over is a body of its own: heading is asked of it with its own z up.
    return replace(case, window=window, wiring=flip, body=flip)


def wire_gyro(rng: np.random.Generator, case: Case) -> Case:
    wiring = -np.eye(3) if rng.random() < 0.5 else MIRRORS[str(rng.choice(list(MIRRORS)))]
    rate = case.window.angular_rate
    assert rate is not None
    return replace(case, window=replace(case.window, angular_rate=rate @ wiring.T))


def wrong_unit(rng: np.random.Generator, case: Case) -> Case:
    factor = float(rng.choice([1e4, 1e6, 1e7, 1e9]))
    window = replace(case.window, field=factor * case.window.field)
    return replace(case, window=window, wiring=factor * np.eye(3))


def wrong_gravity(rng: np.random.Generator, case: Case) -> Case:
    factor = float(rng.choice([1 / 9.80665, 0.5, 0.75, 2.0, 1000 / 9.80665]))
    return replace(
        case, window=replace(case.window, specific_force=factor * case.window.specific_force)
    )


def wrong_reference(rng: np.random.Generator, case: Case) -> Case:
    robot = case.robot
    strength = robot.strength * math.exp(rng.choice([-1, 1]) * rng.uniform(0.05, 0.5))
    dip = robot.inclination + float(rng.choice([-1.0, 1.0])) * rng.uniform(3, 20) * DEGREE
    sigma = float(rng.choice([0.0, 0.03]))
    dip = float(np.clip(dip, -79 * DEGREE, 79 * DEGREE))
    beliefs = Belief(strength, sigma * strength), Belief(dip, sigma * 0.6)
    return replace(case, knowledge=Knowledge(ReferenceField(*beliefs)))


def centripetal(rng: np.random.Generator, case: Case) -> Case:
    rate, arm = case.motion.angular_rate, np.append(rng.uniform(-4, 4, 2), 0.0)
    acceleration = np.cross(rate, np.cross(rate, arm))
    force = case.window.specific_force + acceleration
    window = replace(case.window, specific_force=force)
    return replace(case, window=window, hidden=is_blind(case))


def standing(rng: np.random.Generator, case: Case) -> Case:
    """Mostly noise: less than five degrees of turn."""
    few = np.linspace(0, len(case.window) * rng.uniform(0, 0.012), len(case.window)).astype(int)
    return _held(rng, case, few)


def pauses(rng: np.random.Generator, case: Case) -> Case:
    n = len(case.window)
    share, where = rng.uniform(0.2, 0.7), rng.uniform(0.1, 0.9)
    stops = np.interp(np.arange(n) / n, [0, where * (1 - share), where * (1 - share) + share, 1],
                      [0, where, where, 1])  # fmt: skip
    return _held(rng, case, np.minimum((stops * n).astype(int), n - 1))


def _held(rng: np.random.Generator, case: Case, rows: FloatArray) -> Case:
    motion = Motion(case.motion.time, case.motion.attitude[rows])
    window = measure(case.robot, motion, rng, gyro=not is_blind(case))
    return replace(case, motion=motion, window=window)


KINDS: dict[str, Spoil] = {
    "good": leave, "wild": leave, "pauses": pauses, "no motion": standing,
    "room, clean circle": swing, "room, gradient": gradient, "passing iron": passing,
    "field axes": wire_field, "magnetometer flipped": flip_magnetometer,
    "upside down": flip_board, "gyro axes": wire_gyro, "field unit": wrong_unit,
    "gravity unit": wrong_gravity, "wrong reference": wrong_reference,
    "centripetal": centripetal,
}  # fmt: skip
NEEDS_GYRO = {"gyro axes"}


SIGMAS = 5.0
FLOOR = 0.1 * DEGREE
"""The truth is not asked for more than this, whatever is predicted."""
WORST = 3.0 * DEGREE


@dataclass
class Row:
    """The count of one kind of fault."""

    runs: int = 0
    refused: int = 0
    warned: int = 0
    accepted: int = 0
    misses: int = 0
    hidden: int = 0
    broken: int = 0
    slowest: float = 0.0

    def run(self, case: Case, name: str) -> None:
        self.runs += 1
        start = time.perf_counter()
        try:
            outcome = calibrate(case.window, case.knowledge)
        except Exception as problem:
            self.broken += 1
            print(f"broken: {name}: {problem!r}")
            return
        self.slowest = max(self.slowest, time.perf_counter() - start)
        self.count(case, outcome, name)

    def count(self, case: Case, outcome: Outcome, name: str) -> None:
        grades = outcome.verdict.quality, outcome.verdict.confidence
        if outcome.estimate is not None and not is_finite(outcome.estimate):
            self.broken += 1
            print(f"not finite: {name}")
        if Grade.REFUSED in grades:
            self.refused += 1
        elif Grade.WARN in grades:
            self.warned += 1
        else:
            self.accepted += 1
            assert outcome.estimate is not None
            error, sigma = heading_error(case, outcome.estimate)
            if error > min(SIGMAS * math.hypot(sigma, FLOOR), WORST):
                self.misses += not case.hidden
                self.hidden += case.hidden
                apart = " (hidden)" if case.hidden else ""
                words = f"{error / DEGREE:.2f}° for a predicted {sigma / DEGREE:.2f}°"
                print(f"miss{apart}: {name}: {words}")


def is_finite(estimate: Estimate) -> bool:
    numbers = [estimate.correction.matrix, estimate.correction.hard_iron, estimate.covariance,
               np.array(list(estimate.figures.values()))]  # fmt: skip
    return all(np.isfinite(number).all() for number in numbers)


def heading_error(case: Case, estimate: Estimate) -> tuple[float, float]:
    """Return the heading's RMS error on the level, and what was predicted, radians."""
    poses = trial_attitudes()[:, LEVEL_TILT]
    up, truth = poses[:, :, 2], poses @ case.robot.field_enu
    raw = case.robot.raw_field(truth @ case.body.T) @ case.wiring.T
    gap = yaw_of(up, estimate.correction.apply(raw)) - yaw_of(up, truth)
    gap = (gap + math.pi) % math.tau - math.pi
    error = math.sqrt(float(np.mean(gap**2)))
    return error, calibration_sigma(estimate, 0.0)


def sigma_at(estimate: Estimate, up: FloatArray, field_body: FloatArray) -> FloatArray:
    """Return the yaw's sigma by the covariance of the twelve numbers, radians, shape (...).

    `up` and the true field (tesla), both (..., 3), are in body axes.
    """
    jacobian = yaw_jacobian(estimate.correction, up, field_body)
    variance = np.einsum("...i,ij,...j->...", jacobian, estimate.covariance, jacobian)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))
