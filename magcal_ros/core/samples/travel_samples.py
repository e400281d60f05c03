"""Speeds and positions of a vehicle, from wheels and satellite receivers."""

from __future__ import annotations

from typing import NamedTuple


class SpeedSample(NamedTuple):
    """Speed along the vehicle's x (m/s, negative backwards) at a stamp (s).

    `is_signed` is false where the source knows no backwards: a receiver's speed over ground.
    """

    stamp: float
    speed: float
    is_signed: bool = True


class PositionSample(NamedTuple):
    """Place in a local plane, metres east and north of any origin, at a stamp (s)."""

    stamp: float
    east: float
    north: float


class VelocitySample(NamedTuple):
    """Velocity over ground, m/s east and north, at a stamp (s), and its sigma per axis, m/s."""

    stamp: float
    east: float
    north: float
    sigma: float


TravelSample = SpeedSample | PositionSample | VelocitySample
"""Whatever tells how a vehicle travels."""


class HeadingSample(NamedTuple):
    """ENU yaw (rad) that somebody else measures, with its sigma, at a stamp (s)."""

    stamp: float
    yaw: float
    sigma: float
