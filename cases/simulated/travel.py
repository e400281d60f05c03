"""The truth of a drive: position, attitude and motion of the vehicle."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import exp_rotations, rotation_about
from magcal_ros.core.simulation import UP_ENU
from simulated.legs import Leg
from simulated.turns import Motion

LEFT: FloatArray = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True)
class Body:
    """The motion of a vehicle's body on its wheels.

    Parameters
    ----------
    ease : float
        Seconds over which speed, steering and slope are smoothed: nothing changes at once.
    wobble : float
        Radians, roll and pitch of the body on the road while it moves, standard deviation.
    wobble_lasts : float
        Seconds over which that is alike.
    dive : float
        Radians of pitch and roll per m/s² of acceleration: springs.
    camber : float
        Radians, standard deviation of the road's own lean to the sides, alike over 50 m.
    """

    ease: float = 0.6
    wobble: float = math.radians(0.3)
    wobble_lasts: float = 0.15
    dive: float = math.radians(0.3)
    camber: float = math.radians(0.7)


@dataclass(frozen=True, eq=False)
class Travel:
    """Where a vehicle was, in ENU axes with true north and its own FLU axes.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Seconds, evenly spaced.
    yaw : ndarray, shape (n,)
        Of the vehicle's x, ENU, radians, unwrapped.
    speed : ndarray, shape (n,)
        Along the vehicle's x, m/s, negative backwards.
    position : ndarray, shape (n, 2)
        Metres east and north.
    attitude : ndarray, shape (n, 3, 3)
        ENU to vehicle axes.
    acceleration : ndarray, shape (n, 3)
        Of the vehicle over ground, m/s² in its axes.
    """

    time: FloatArray
    yaw: FloatArray
    speed: FloatArray
    position: FloatArray
    attitude: FloatArray
    acceleration: FloatArray

    @property
    def angular_rate(self) -> FloatArray:
        """rad/s in vehicle axes, shape (n, 3)."""
        return Motion(self.time, self.attitude).angular_rate

    @property
    def metres(self) -> FloatArray:
        """Length of way driven so far, either direction, shape (n,)."""
        return np.asarray(np.cumsum(np.abs(self.speed)) * self.period)

    @property
    def period(self) -> float:
        """Seconds between moments."""
        return float(self.time[1] - self.time[0])


def travel(
    legs: list[Leg],
    rng: np.random.Generator,
    *,
    rate: float = 50.0,
    start: float = 1000.0,
    heading: float = 0.0,
    current: tuple[float, float] = (0.0, 0.0),
    body: Body = Body(),
) -> Travel:
    """Drive the legs.

    Parameters
    ----------
    legs : list of Leg
        What is driven.
    rng : numpy.random.Generator
        Source of chance: the road.
    rate : float
        Moments a second.
    start : float
        First stamp, seconds.
    heading : float
        ENU yaw at the start, radians.
    current : tuple of float
        m/s east and north by which a boat drifts over ground.
    body : Body
        How the vehicle sits on its wheels.
    """
    speed, curvature, turn_rate, pitch = _eased(legs, rate, body.ease)
    period = 1.0 / rate
    yaw_rate = speed * curvature + turn_rate
    yaw = np.asarray(heading + np.cumsum(yaw_rate) * period)
    forward = np.column_stack([np.cos(yaw), np.sin(yaw)])
    velocity = (speed * np.cos(pitch))[:, None] * forward + np.asarray(current)
    # Of the way: no rolling, and the vehicle's x along it.
    way = rotation_about(LEFT, pitch) @ rotation_about(UP_ENU, -yaw)
    accelerations = np.column_stack(
        [np.gradient(speed, period), speed * yaw_rate, speed * np.gradient(pitch, period)]
    )
    lean = _lean(speed, accelerations, period, rng, body)
    on_wheels = exp_rotations(-lean)
    return Travel(
        np.asarray(start + period * np.arange(len(speed)), dtype=np.float64),
        yaw,
        speed,
        np.cumsum(velocity, axis=0) * period,
        np.asarray(on_wheels @ way),
        np.einsum("nij,nj->ni", on_wheels, accelerations),
    )


def _eased(legs: list[Leg], rate: float, ease: float) -> tuple[FloatArray, ...]:
    """Return speed, curvature, turn rate and pitch of each moment, shape (n,) each."""
    columns: list[list[FloatArray]] = [[], [], [], []]
    speed = pitch = 0.0
    for leg in legs:
        count = max(1, round(leg.seconds * rate))
        share = np.arange(1, count + 1) / count
        columns[0].append(speed + (leg.speed - speed) * share)
        columns[1].append(np.full(count, leg.curvature))
        columns[2].append(np.full(count, leg.turn_rate))
        columns[3].append(pitch + (leg.pitch - pitch) * share)
        speed, pitch = leg.speed, leg.pitch
    width = max(1, round(ease * rate))
    joined = (np.concatenate(column) for column in columns)
    # Twice a moving mean: the change of acceleration has an end as well.
    return tuple(running_mean(running_mean(column, width), width) for column in joined)


def _lean(
    speed: FloatArray,
    accelerations: FloatArray,
    period: float,
    rng: np.random.Generator,
    body: Body,
) -> FloatArray:
    """Return the body's small rotation on its way, radians, shape (n, 3)."""
    moving = np.minimum(1.0, np.abs(speed))[:, None]
    wobble = body.wobble * moving * smooth_noise(rng, len(speed), period, body.wobble_lasts)
    metres = np.cumsum(np.abs(speed)) * period
    marks = np.arange(0.0, metres[-1] + 20.0, 10.0)
    camber = np.interp(metres, marks, smooth_noise(rng, len(marks), 10.0, 25.0)[:, 0])
    lean = np.zeros((len(speed), 3))
    # The nose dives when braking; the body leans out of a bend.
    lean[:, 0] = wobble[:, 0] + body.camber * camber + body.dive * accelerations[:, 1]
    lean[:, 1] = wobble[:, 1] - body.dive * accelerations[:, 0]
    return lean


SMALLEST = 1e-4
"""Where the tail of an exponential is cut off."""


def exponential_noise(
    rng: np.random.Generator, count: int, period: float, lasts: float
) -> FloatArray:
    """Return two columns of unit noise whose correlation falls by e over `lasts`, (count, 2)."""
    keeps = math.exp(-period / lasts)
    return _filtered(rng, count, _tail(keeps))


def smooth_noise(rng: np.random.Generator, count: int, period: float, lasts: float) -> FloatArray:
    """Return the same with a derivative: low-passed twice, shape (count, 2)."""
    tail = _tail(math.exp(-period / lasts))
    return _filtered(rng, count, np.convolve(tail, tail))


def running_mean(values: FloatArray, width: int) -> FloatArray:
    """Return the mean over so many neighbours, the ends held, shape (n,)."""
    left = (width - 1) // 2
    padded = np.pad(values, (left, width - 1 - left), mode="edge")
    return np.asarray(np.convolve(padded, np.full(width, 1.0 / width), mode="valid"))


def _tail(keeps: float) -> FloatArray:
    return np.asarray(keeps ** np.arange(math.ceil(math.log(SMALLEST) / math.log(keeps)) + 1))


def _filtered(rng: np.random.Generator, count: int, kernel: FloatArray) -> FloatArray:
    kernel = kernel / np.linalg.norm(kernel)
    noise = rng.standard_normal((2, count + len(kernel) - 1))
    return np.column_stack([np.convolve(row, kernel, mode="valid") for row in noise])
