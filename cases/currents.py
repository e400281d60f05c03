"""Turns from rest to rest of robots whose battery reports its current."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from realistic_robots import (
    RESTED,
    SENSORS,
    Course,
    Scene,
    direction,
    drawn,
    evenly,
    with_field,
)
from simulated.travel import exponential_noise

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.battery import Messages

ELECTRONICS = 0.5
"""Amperes that a robot draws whatever its motors do: the field of these is hard iron."""
LARGEST = 3.8
"""Amperes of the motors, without ripple, at the fastest of a turn."""
LATE = 0.1  # seconds by which the battery reports its current late

SHAPES = {
    "hold": (1.0 / LARGEST, 1.0 / LARGEST, 0.0),
    "turn rate": (1.0 / LARGEST, 0.0, 0.0),
    "step, hold": (0.0, 0.0, 1.0),
    "none": (0.0, 0.0, 0.0),
}
"""The field over its largest: per ampere while the robot turns, per ampere while it stands, and
while it moves."""
HOLDS = "hold", "step, hold"


def with_long_rests(time: FloatArray) -> FloatArray:
    return np.asarray(evenly(time) * np.clip(4.0 * np.sin(math.tau * time / 6.0), 0.0, 1.0))


COURSES: dict[str, Course] = {**RESTED, "rests": with_long_rests}
"""Those from rest to rest; "stops" stands for 1.7 seconds each time, "rests" for 3."""


def turn_with_current(
    shape: str,
    size: float,
    number: int,
    course: str = "stops",
    gap: float = 0.125,
    *,
    are_means: bool = False,
) -> tuple[Scene, Knowledge, Messages]:
    """Return a turn of a robot whose motors add a field of so many tesla, with its battery.

    The current of the turn is in proportion to the turn rate, with a ripple of a fifth. With a
    shape of `HOLDS` the robot also holds itself by its motors while it stands, by up to 3 A, which
    differ from stand to stand. `gap` is in seconds between the battery's messages, each of which is
    the current of one moment, or its mean since the message before.
    """
    rng = np.random.default_rng([12, number])
    scene, known = drawn(rng, COURSES[course])
    scene = SENSORS["typical"](rng, scene)
    time, rate = scene.window.time, np.abs(scene.motion.angular_rate[:, 2])
    moves = rate > 0.02
    ripple = exponential_noise(rng, len(time), float(np.median(np.diff(time))), 0.5)[:, 0]
    turning = (3.5 * rate / rate.max() * (1.0 + 0.2 * ripple) + 0.3) * moves
    stand = np.cumsum(np.abs(np.diff(moves.astype(int), prepend=int(moves[0]))))
    holding = rng.uniform(0.0, 3.0, stand.max() + 1)[stand] * ~moves * (shape in HOLDS)
    share = np.column_stack([turning, holding, moves]) @ SHAPES[shape]
    added = size * np.outer(share, direction(rng))
    scene = with_field(scene, added @ scene.robot.distortion.T)
    stamps = np.arange(time[0], time[-1] + gap, gap)
    around = np.linspace(-gap, 0.0, 50) if are_means else np.zeros(1)
    moments = stamps[:, None] - LATE + around
    current = np.interp(moments, time, turning + holding + ELECTRONICS).mean(axis=1)
    reported = -current + rng.normal(0.0, 0.03, len(stamps))
    battery = tuple(zip(stamps.tolist(), reported.tolist(), strict=True))
    return replace(scene, has_course=True), known, battery
