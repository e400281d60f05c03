"""Turns of robots with real sensors: one error at a time, or all together.

A fifth of the robots that are drawn with `by_turn` have no reference field. Some errors have a
course of their own: a rest before and after the turn, stops on the way, an uneven speed. Such turns
go through a session, as those of a robot do.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from places import PLACES, added_field
from simulated.turns import Motion, measure, slope_rpy, smooth_wobble, turn
from turn_kinds import KINDS, drawn_motion, drawn_robot

from magcal_ros.core.calibration.correction import Correction
from magcal_ros.core.geometry.arrays import FloatArray, interpolated
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, wrap_angle, yaw_from_up_and_field
from magcal_ros.core.geometry.rotations import exp_rotations, rotation_about, rotation_from_rpy
from magcal_ros.core.knowledge import Belief, Knowledge, Mounting, ReferenceField
from magcal_ros.core.samples.battery import Messages
from magcal_ros.core.samples.streams import FieldSample, ImuSample, Pair
from magcal_ros.core.samples.window import Window
from magcal_ros.core.session.session import Limits, Session
from magcal_ros.core.simulation import DEGREE, LEVEL_TILT, UP_ENU, Robot, trial_attitudes

SAMPLES, SECONDS = 600, 20.0
FULL_TURN = (1.0, 1.15)
"""Turns, from and to."""
REST = 3.0
"""Seconds before and after a turn that starts and ends at rest."""
RUNS_FROM = 0.02
"""rad/s from which the motors run."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A measured turn, and the sensor errors that remain in use."""

    robot: Robot
    motion: Motion
    window: Window
    distortion: FloatArray = field(default_factory=lambda: np.eye(3))
    force: FloatArray = field(default_factory=lambda: np.zeros(3))
    has_course: bool = False


Spoil = Callable[[np.random.Generator, Scene], Scene]
Scenes = Callable[[int], tuple[Scene, Knowledge]]
"""Turns and what is known of the field, by their number."""
Course = Callable[[FloatArray], FloatArray]
"""How fast a robot turns at moments (seconds from the turn's start), over its fastest."""


def evenly(time: FloatArray) -> FloatArray:
    return np.clip(np.minimum(time, SECONDS - time) / 0.5, 0.0, 1.0)


def stop_and_go(time: FloatArray) -> FloatArray:
    return evenly(time) * np.clip(4.0 * np.sin(math.tau * time / 5.0) + 2.0, 0.0, 1.0)


def unevenly(time: FloatArray) -> FloatArray:
    return evenly(time) * (1.0 + 0.5 * np.sin(math.tau * time / 7.0))


def there_and_back(time: FloatArray) -> FloatArray:
    return evenly(time) * np.clip(2.0 * (0.5 * SECONDS - time), -1.0, 1.0)


RESTED: dict[str, Course] = {
    "even": evenly,
    "uneven": unevenly,
    "there and back": there_and_back,
    "stops": stop_and_go,
}


ARCS: dict[str, Course | None] = {"no rests": None, "rests": evenly}


def driven(
    course: Course, arc: float, start_rpy: tuple[float, float, float], sway: FloatArray
) -> Motion:
    """Return a turn that begins and ends at rest; it sways while it turns."""
    step = SECONDS / SAMPLES
    time = np.arange(-REST, SECONDS + REST, step)
    rate = course(time)
    yaw = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * step)])
    yaw *= arc / np.ptp(yaw)
    lean = np.zeros((len(time), 3))
    lean[: len(sway)] = sway
    lean = np.roll(lean, round(REST / step), axis=0) * np.minimum(np.abs(rate), 1.0)[:, None]
    slope = rotation_from_rpy(*start_rpy).T
    return Motion(time, exp_rotations(lean) @ rotation_about(UP_ENU, -yaw) @ slope)


def collected(window: Window, currents: Messages = ()) -> Window:
    """Return the window that a session collects from samples and a battery's messages."""
    session = Session(Limits(), Mounting(), 0.0)
    session.note_currents(*currents)
    rates = window.angular_rate
    rates = np.full_like(window.field, math.nan) if rates is None else rates
    rows = zip(window.time, window.field, window.specific_force, rates, strict=True)
    for stamp, field_, force, rate in rows:
        imu = ImuSample(stamp, tuple(force), tuple(rate))
        session.add(Pair(FieldSample(stamp, tuple(field_)), imu), stamp)
    return session.window()


def usual_robot(rng: np.random.Generator) -> Robot:
    """Draw a robot with usual noise."""
    return Robot(
        inclination=rng.uniform(50.0, 70.0) * DEGREE,
        roll=rng.normal(0.0, 3.0) * DEGREE,
        pitch=rng.normal(0.0, 3.0) * DEGREE,
        hard_iron=rng.normal(0.0, 20e-6, 3),
        noise_field=0.3e-6,
        noise_force=0.05,
        noise_rate=2e-3,
        gyro_bias=rng.normal(0.0, 0.002, 3),
    )


def drawn_knowledge(rng: np.random.Generator, robot: Robot) -> Knowledge:
    """Draw what is known of the field at the robot's place."""
    strength = Belief(robot.strength + rng.normal(0.0, 1.5e-6), 1.5e-6)
    dip = Belief(robot.inclination + rng.normal(0.0, 1.0) * DEGREE, 1.0 * DEGREE)
    return Knowledge(ReferenceField(strength, dip))


def drawn(
    rng: np.random.Generator,
    course: Course | None = None,
    turns: tuple[float, float] = FULL_TURN,
) -> tuple[Scene, Knowledge]:
    """Draw a robot, its turn (of so many turns), and what is known of the field."""
    robot = usual_robot(rng)
    slope = slope_rpy(abs(rng.normal(0.0, 2.0)) * DEGREE, *rng.uniform(0.0, math.tau, 2))
    sway = smooth_wobble(rng, SAMPLES, SECONDS, 1.0 * DEGREE, (0.2, 2.0))
    arc = rng.choice([-1.0, 1.0]) * rng.uniform(*turns) * math.tau
    if course is None:
        motion = turn(arc=arc, samples=SAMPLES, duration=SECONDS, start_rpy=slope, wobble=sway)
    else:
        motion = driven(course, arc, slope, sway)
    knowledge = drawn_knowledge(rng, robot)
    return Scene(robot, motion, measure(robot, motion, rng, gyro=True)), knowledge


def direction(rng: np.random.Generator) -> FloatArray:
    vector = rng.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))


def with_field(scene: Scene, added: FloatArray) -> Scene:
    return replace(scene, window=replace(scene.window, field=scene.window.field + added))


def with_force(scene: Scene, added: FloatArray) -> Scene:
    force = scene.window.specific_force + added
    return replace(scene, window=replace(scene.window, specific_force=force))


def rate_of(scene: Scene) -> FloatArray:
    rate = scene.window.angular_rate
    assert rate is not None
    return rate


def with_rate(scene: Scene, added: FloatArray) -> Scene:
    return replace(scene, window=replace(scene.window, angular_rate=rate_of(scene) + added))


def axes(size: float, *, iron: bool = False) -> Spoil:
    """Axes out of square, or soft iron, which is symmetric."""

    def spoil(rng: np.random.Generator, scene: Scene) -> Scene:
        error = size * rng.standard_normal((3, 3))
        error = 0.5 * (error + error.T) if iron else error
        turned = scene.window.field - scene.robot.hard_iron
        return replace(with_field(scene, turned @ error.T), distortion=np.eye(3) + error)

    return spoil


def over_time(shape: Callable[[np.random.Generator, FloatArray], FloatArray], size: float) -> Spoil:
    """Add a field (tesla) in one direction of the body that follows a shape over time."""

    def spoil(rng: np.random.Generator, scene: Scene) -> Scene:
        return with_field(scene, size * np.outer(shape(rng, scene.window.time), direction(rng)))

    return spoil


def scattered(effect: Callable[[float], Spoil], size: float) -> Spoil:
    """Draw the size of an effect anew for each robot, half as large or twice."""
    return lambda rng, scene: effect(size * math.exp(0.6 * rng.standard_normal()))(rng, scene)


def coloured(size: float, seconds: float) -> Spoil:
    """Add noise of three axes that lasts for seconds; endless seconds: a random walk."""

    def spoil(rng: np.random.Generator, scene: Scene) -> Scene:
        count, step = len(scene.window), float(np.ptp(scene.window.time)) / len(scene.window)
        keeps = math.exp(-step / seconds)
        grows = math.sqrt(step if math.isinf(seconds) else 1.0 - keeps**2)
        noise = np.zeros((count, 3))
        for k in range(1, count):
            noise[k] = keeps * noise[k - 1] + grows * rng.standard_normal(3)
        return with_field(scene, size * (noise - noise.mean(axis=0)))

    return spoil


def motors(size: float, *, signed: bool = False) -> Spoil:
    """Add a field (tesla) of the body while the robot turns; it turns round with the turn."""

    def spoil(rng: np.random.Generator, scene: Scene) -> Scene:
        rate = scene.motion.angular_rate[:, 2]
        runs = (np.abs(rate) > RUNS_FROM) * (np.sign(rate) if signed else 1.0)
        return with_field(scene, size * np.outer(runs, direction(rng)))

    return spoil


def late(seconds: float) -> Spoil:
    def spoil(_: np.random.Generator, scene: Scene) -> Scene:
        time, raw = scene.window.time, scene.window.field
        moved = interpolated(time - seconds, time, raw)
        return with_field(scene, moved - raw)

    return spoil


def lever_arm(metres: float) -> Spoil:
    def spoil(rng: np.random.Generator, scene: Scene) -> Scene:
        arm = metres * np.append(direction(rng)[:2], 0.0)
        rate = scene.motion.angular_rate
        swing = np.gradient(rate, scene.motion.time, axis=0)
        return with_force(scene, np.cross(rate, np.cross(rate, arm)) + np.cross(swing, arm))

    return spoil


def off(size: float) -> Spoil:
    def spoil(rng: np.random.Generator, scene: Scene) -> Scene:
        added = size * direction(rng)
        return replace(with_force(scene, added), force=added)

    return spoil


def biased(degrees: float) -> Spoil:
    return lambda rng, scene: with_rate(scene, degrees * DEGREE * direction(rng))


def crossed(size: float) -> Spoil:
    return lambda rng, scene: with_rate(
        scene, rate_of(scene) @ (size * rng.standard_normal((3, 3)))
    )


def together(*effects: Spoil) -> Spoil:
    def spoil(rng: np.random.Generator, scene: Scene) -> Scene:
        for effect in effects:
            scene = effect(rng, scene)
        return scene

    return spoil


def even(_: np.random.Generator, time: FloatArray) -> FloatArray:
    return np.asarray(time / time[-1] - 0.5)


def switched(_: np.random.Generator, time: FloatArray) -> FloatArray:
    return (time % 4.0 < 2.5).astype(float)


def drifting(size: float) -> Spoil:
    return over_time(even, size)


def switching(size: float) -> Spoil:
    return over_time(switched, size)


def lasting(size: float) -> Spoil:
    return coloured(size, 3.0)


TYPICAL = together(
    axes(0.005),
    drifting(0.3e-6),
    switching(0.15e-6),
    lasting(0.15e-6),
    late(0.01),
    lever_arm(0.1),
    off(0.05),
    biased(0.1),
    crossed(0.01),
)
"""A MEMS set on a robot that turns in the open; what each part does alone stands below."""


def of_sizes(share: float = 1.0) -> Spoil:
    """Return all errors of MEMS sensors, as a multiple of the usual size, drawn for each robot."""
    return together(
        scattered(axes, share * 0.005),
        scattered(drifting, share * 0.2e-6),
        scattered(switching, share * 0.1e-6),
        scattered(lasting, share * 0.15e-6),
        scattered(late, share * 0.008),
        scattered(lever_arm, share * 0.08),
        scattered(off, share * 0.05),
        scattered(biased, share * 0.2),
        scattered(crossed, share * 0.008),
    )


SENSORS: dict[str, Spoil] = {
    "perfect": lambda _, scene: scene,
    "good": of_sizes(0.6),
    "typical": of_sizes(),
    "cheap": together(
        scattered(axes, 0.012),
        scattered(drifting, 0.4e-6),
        scattered(switching, 0.2e-6),
        scattered(lasting, 0.2e-6),
        scattered(late, 0.01),
        scattered(lever_arm, 0.1),
        lambda rng, scene: off(float(rng.choice([0.2, 0.5])))(rng, scene),
        scattered(biased, 2.0),
        crossed(0.02),
    ),
}
"""For `--turns`; sizes but the offset and the crossed axes are drawn anew for each robot."""

EFFECTS: dict[str, Spoil] = {
    "none": lambda _, scene: scene,
    "all that is typical": TYPICAL,
    "axes 1 %": axes(0.01),
    "axes 3 %": axes(0.03),
    "soft iron 10 %": axes(0.1, iron=True),
    "drift 1 µT": drifting(1e-6),
    "drift 3 µT": drifting(3e-6),
    "motor 1 µT": switching(1e-6),
    "motor 3 µT": switching(3e-6),
    "aliased hum 1 µT": over_time(
        lambda rng, t: np.sin(math.tau * rng.uniform(0.05, 0.3) * t + rng.uniform(0.0, 6.0)), 1e-6
    ),
    "noise 1 µT, 3 s": lasting(1e-6),
    "walk .3 µT/√s": coloured(0.3e-6, math.inf),
    "latency 50 ms": late(0.05),
    "lever arm .2 m": lever_arm(0.2),
    "lever arm .5 m": lever_arm(0.5),
    "acceleration .2 m/s²": off(0.2),
    "acceleration .5 m/s²": off(0.5),
    "gyro bias .5 °/s": biased(0.5),
    "gyro bias 2 °/s": biased(2.0),
    "gyro cross-axis 2 %": crossed(0.02),
}


COURSES: dict[str, tuple[Course, Spoil]] = {
    "rests": (evenly, lambda _, scene: scene),
    "rests, all that is typical": (evenly, TYPICAL),
    "rests, motors 1 µT": (evenly, motors(1e-6)),
    "rests, motors 3 µT": (evenly, motors(3e-6)),
    "rests, gyro bias 2 °/s": (evenly, biased(2.0)),
    "rests, acceleration .5": (evenly, off(0.5)),
    "stops": (stop_and_go, lambda _, scene: scene),
    "stops, all that is typical": (stop_and_go, TYPICAL),
    "stops, motors 1 µT": (stop_and_go, motors(1e-6)),
    "stops, motors 3 µT": (stop_and_go, motors(3e-6)),
    "stops, latency 50 ms": (stop_and_go, late(0.05)),
    "stops, lever arm .5 m": (stop_and_go, lever_arm(0.5)),
    "uneven": (unevenly, lambda _, scene: scene),
    "uneven, motors 1 µT": (unevenly, motors(1e-6)),
    "uneven, latency 50 ms": (unevenly, late(0.05)),
    "uneven, lever arm .5 m": (unevenly, lever_arm(0.5)),
    "there and back, motors 1 µT": (there_and_back, motors(1e-6)),
    "there and back, signed 1 µT": (there_and_back, motors(1e-6, signed=True)),
}
"""Effects that show where a robot rests, or turns at another speed."""


def heading_errors(scene: Scene, correction: Correction) -> FloatArray:
    """Return the heading errors on the level with the sensors as they are, radians."""
    poses = trial_attitudes()[:, LEVEL_TILT]
    robot, up, truth = scene.robot, poses[:, :, 2], poses @ scene.robot.field_enu
    raw = (robot.raw_field(truth) - robot.hard_iron) @ scene.distortion.T + robot.hard_iron
    seen = STANDARD_GRAVITY * up + scene.force
    gap = yaw_from_up_and_field(seen, correction.apply(raw)) - yaw_from_up_and_field(up, truth)
    return wrap_angle(gap)


def heading_error(scene: Scene, correction: Correction) -> float:
    """Return the RMS of `heading_errors`, radians."""
    return math.sqrt(float(np.mean(heading_errors(scene, correction) ** 2)))


def by_effect(name: str) -> Scenes:
    def scene(number: int) -> tuple[Scene, Knowledge]:
        course, effect = COURSES.get(name) or (None, EFFECTS[name])
        scene, knowledge = drawn(np.random.default_rng([1, number]), course)
        scene = replace(scene, has_course=course is not None)
        return effect(np.random.default_rng([2, number]), scene), knowledge

    return scene


def by_turn(kind: str, sensors: str, place: str) -> Scenes:
    def scene(number: int) -> tuple[Scene, Knowledge]:
        rng = np.random.default_rng([3, KINDS.index(kind), number])
        robot, motion = drawn_robot(rng, kind), drawn_motion(rng, kind)
        strength = Belief(robot.strength + rng.normal(0.0, 1.5e-6), 1.5e-6)
        dip = Belief(robot.inclination + rng.normal(0.0, 1.0) * DEGREE, 1.0 * DEGREE)
        known = Knowledge(ReferenceField(strength, dip)) if rng.random() > 0.2 else Knowledge()
        scene = Scene(robot, motion, measure(robot, motion, rng, gyro=True))
        scene, around = SENSORS[sensors](rng, scene), PLACES[place]
        if around is not None:
            scene = with_field(scene, added_field(rng, motion, around) @ robot.distortion.T)
        return scene, known

    return scene


def by_rested_turn(course: str, sensors: str, place: str) -> Scenes:
    def scene(number: int) -> tuple[Scene, Knowledge]:
        rng = np.random.default_rng([4, list(RESTED).index(course), number])
        scene, known = drawn(rng, RESTED[course])
        known = known if rng.random() > 0.2 else Knowledge()
        scene, around = SENSORS[sensors](rng, scene), PLACES[place]
        if around is not None:
            bent = added_field(rng, scene.motion, around) @ scene.robot.distortion.T
            scene = with_field(scene, bent)
        return replace(scene, has_course=True), known

    return scene


def by_arc(course: str, sensors: str, least: float) -> Scenes:
    def scene(number: int) -> tuple[Scene, Knowledge]:
        arcs = (least / 360.0, 90.0 / 360.0)
        scene, known = drawn(np.random.default_rng([5, number]), ARCS[course], arcs)
        scene = SENSORS[sensors](np.random.default_rng([6, number]), scene)
        return replace(scene, has_course=True), known

    return scene


def with_motors(kind: str, size: float) -> Scenes:
    """Return turns from rest to rest of a robot whose motors add a field (tesla)."""

    def case(number: int) -> tuple[Scene, Knowledge]:
        rng = np.random.default_rng([5, number])
        scene, known = drawn(rng, evenly)
        scene = SENSORS["typical"](rng, scene)
        rate = scene.motion.angular_rate[:, 2]
        shapes = {
            "in step": (np.abs(rate) > 0.02).astype(float),
            "by rate": rate / np.abs(rate).max(),
            "switching": (np.abs(rate) > 0.02) * switched(rng, scene.window.time),
        }
        added = size * np.outer(shapes[kind], direction(rng))
        return replace(with_field(scene, added), has_course=True), known

    return case
