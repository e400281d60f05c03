"""The robot of the ROS tests, and the measurement of its headings."""

import functools
import math
import time
from dataclasses import replace

import numpy as np
from simulated.turns import measure, turn

from magcal_ros.core import calibrate
from magcal_ros.core.simulation import Robot
from magcal_ros.files import Origin, write_calibration

DEGREE = math.pi / 180.0
SPEED = 4.0
IMU_RATE = 25.0
"""Hz of the robot's time, and half of it the field: each message costs two processes' time."""

PATIENCE = 60.0
"""Seconds to wait for what must happen, on the slowest and busiest machine."""

ROBOT = Robot(
    strength=48e-6,
    inclination=65.0 * DEGREE,
    roll=3.0 * DEGREE,
    pitch=-4.0 * DEGREE,
    hard_iron=np.array([15e-6, -8e-6, 10e-6]),
    noise_field=0.3e-6,
    noise_force=0.02,
)

REFERENCE = {"reference.strength_ut": 48.0, "reference.inclination_deg": 65.0}


AT_ONCE = 10.0
"""Seconds for what takes some tenths of one, against what waits for a turn or for ever."""


def wait_until(condition, patience=PATIENCE):
    """Wait for an event in other threads or processes."""
    deadline = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < deadline, "it did not happen"
        time.sleep(0.01)


def rms_deg(errors):
    """Return the root mean square of radians in degrees."""
    return math.degrees(math.sqrt(float(np.mean(np.square(errors)))))


def assert_silent(actor):
    """No yaw is published, after earlier messages have arrived."""
    for _ in range(30):
        actor.yaws.clear()
        actor.run(0.4)
        if not actor.yaws:
            return
    raise AssertionError("the yaw goes on")


def goes_on(actor):
    """The node answers, by its services and by the yaw."""
    assert actor.answer(actor.call("reset")).success
    assert_silent(actor)
    assert actor.answer(actor.call("load")).success
    actor.run(PATIENCE, stop=lambda: actor.yaws)
    assert actor.yaws


def turn_by(actor, degrees):
    """Turn until the node has measured this part of the circle."""
    actor.run(PATIENCE, 0.5, lambda: (actor.status["progress"] or {}).get("arc_deg", 0.0) > degrees)


def calibrate_quickly(actor):
    """Start, turn enough for a verdict, and finish; returns the answer."""
    started = actor.answer(actor.call("start"))
    assert started.success, started.message
    turn_by(actor, 240.0)
    return actor.answer(actor.call("finish"))


@functools.cache
def calibrated():
    """Return the calibration of the robot by one turn."""
    window = measure(ROBOT, turn(), np.random.default_rng(1))
    return calibrate(window, ROBOT.knowledge()).calibration


def store_calibration(path, subtracted=0.0, frame="mag_link", iron=0.0, **figures):
    """Store a calibration of the robot; `subtracted` is the tilt by a steady acceleration, rad.

    Its hard iron is wrong by `iron`, tesla; `figures` are further ones of its evidence.
    """
    calibration = calibrated()
    correction = calibration.correction
    correction = replace(correction, hard_iron=correction.hard_iron + iron)
    calibration = replace(calibration, correction=correction)
    figures = {**calibration.evidence.figures, "steady_pull": subtracted, **figures}
    evidence = replace(calibration.evidence, figures=figures)
    calibration = replace(calibration, evidence=evidence)
    write_calibration(path, calibration, Origin.now(frame, "imu_link"))
    return path
