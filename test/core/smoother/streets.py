"""Simulated drives for the smoother, and how far a calibration is off."""

import math
from dataclasses import replace

import numpy as np
from simulated.drive import random_vehicle, simulated_drive
from simulated.legs import city
from simulated.travel import travel

from magcal_ros.core import Window
from magcal_ros.core.geometry import rotation_from_rpy, yaw_from_up_and_field
from magcal_ros.core.knowledge import knowledge_of
from magcal_ros.core.samples import log_of

BOSTON = knowledge_of(51.3, inclination_deg=66.3)


def driven(seed, seconds=300.0, legs=None, vehicle=None, **options):
    """A drive through a city, or along other legs."""
    rng = np.random.default_rng(seed)
    vehicle = random_vehicle(rng) if vehicle is None else vehicle
    truth = travel(city(rng, seconds) if legs is None else legs, rng)
    return simulated_drive(truth, rng, vehicle, receiver=None, **options)


def log_from(drive, *, speed=False):
    """The log that is kept of it."""
    window = Window(drive.time, drive.field, drive.force, drive.rate)
    log = log_of(window)
    if not speed:
        return log
    return replace(log, speed=np.interp(log.time, drive.time, drive.truth.speed))


def heading_error(correction, robot):
    """RMS over headings on the level, the constant taken off, degrees."""
    yaw = np.arange(72) * (math.tau / 72)
    attitude = np.array([rotation_from_rpy(0.0, 0.0, angle).T for angle in yaw])
    raw = robot.raw_field(attitude @ robot.field_enu)
    turn = np.exp(1j * (yaw_from_up_and_field(attitude[:, :, 2], correction.apply(raw)) - yaw))
    away = np.angle(turn / turn.mean())
    return math.degrees(math.sqrt(np.mean(away**2)))
