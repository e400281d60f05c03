"""Where the robot is, from a receiver's fixes: the first good one, and the next that matters."""

from __future__ import annotations

import math
from dataclasses import dataclass

from magcal_ros.core.earth_field.wmm import VALIDITY, Place
from magcal_ros.core.samples.streams import PositionSample


@dataclass(frozen=True)
class PositionTuning:
    """When a place counts as another."""

    moved: float = 10_000.0
    """Metres after which the field is looked up again: in that way it changes by less than 0.1° and
    0.1 µT at most places."""
    confirmed: int = 3
    """Fixes in a row that must agree on a new place: one alone may be wild."""
    far: float = 50_000.0
    """Metres from where the robot is said to be, or was at first, that are worth a word."""
    altitude_unknown: float = 0.0
    """Metres that are taken for it: a hundred change the strength by 0.005%."""


TUNING = PositionTuning()


NO_FIX = "say that there is no fix"
NOT_FINITE = "are not finite"
OFF_EARTH = "lie outside of -90 to 90°, -180 to 180°, and -1 to 850 km of altitude"
NOWHERE = "lie at 0° N 0° E, where receivers without a fix are"


@dataclass(frozen=True)
class Fix:
    """What a receiver says."""

    has_fix: bool
    """Its own word on it."""
    latitude_deg: float
    longitude_deg: float
    altitude: float
    """Degrees and metres; the altitude may be NaN."""
    stamp: float
    """Seconds."""


def place_of(fix: Fix) -> Place | str:
    """Return the place of a fix, or what is wrong with it."""
    spot = (fix.latitude_deg, fix.longitude_deg)
    low, high = VALIDITY.altitudes
    altitude = fix.altitude if math.isfinite(fix.altitude) else TUNING.altitude_unknown
    if not fix.has_fix:
        return NO_FIX
    if not all(math.isfinite(value) for value in spot):
        return NOT_FINITE
    if abs(spot[0]) > 90.0 or abs(spot[1]) > 180.0 or not low <= altitude <= high:
        return OFF_EARTH
    if spot == (0.0, 0.0):
        return NOWHERE
    return Place(*spot, altitude)


class Fixes:
    """Follows a receiver.

    Attributes
    ----------
    place : Place or None
        Where the robot is; None before the first good fix.
    stamp : float
        Of the newest good fix, seconds; zero before it.
    """

    def __init__(self) -> None:
        self.place: Place | None = None
        self.stamp = 0.0
        self._first: Place | None = None
        self._candidates: list[Place] = []
        self._faults: set[str] = set()

    def add(self, fix: Fix) -> bool:
        """Take a fix; returns whether the place is a new one."""
        place = place_of(fix)
        if isinstance(place, str):
            self._faults.add(place)
            return False
        self.stamp = fix.stamp
        if self.place is None:
            self._first = place
        elif not self._has_moved_to(place):
            return False
        self.place, self._candidates = place, []
        return True

    def _has_moved_to(self, place: Place) -> bool:
        assert self.place is not None
        if self.place.distance(place) <= TUNING.moved:
            self._candidates = []
            return False
        self._candidates = [c for c in self._candidates if c.distance(place) <= TUNING.moved] + [
            place
        ]
        return len(self._candidates) >= TUNING.confirmed

    def complaints(self, given: Place | None) -> list[str]:
        """Say what is wrong with the fixes; empty if nothing is."""
        if self.place is None:
            return [
                f"gps/fix: no place yet, its messages {fault}" for fault in sorted(self._faults)
            ]
        if given is not None:
            away = given.distance(self.place)
            if away > TUNING.far:
                return [
                    f"gps/fix says {self.place.words}, {away / 1000.0:.0f} km from the given place "
                    f"{given.words}, which is used: correct reference.latitude_deg and "
                    "reference.longitude_deg, or leave them out"
                ]
            return []
        assert self._first is not None
        away = self._first.distance(self.place)
        if away > TUNING.far:
            return [
                f"gps/fix has moved by {away / 1000.0:.0f} km, from {self._first.words} to "
                f"{self.place.words}: the reference field has followed"
            ]
        return []


RADIUS = 6_371_000.0
"""Metres, mean radius of the Earth: the plane's scale is right to 0.4%, its angles near it."""


class LocalPlane:
    """The plane that touches the Earth at the first good fix (equirectangular)."""

    def __init__(self) -> None:
        self._origin: Place | None = None

    def position(self, fix: Fix) -> PositionSample | None:
        """Return a fix in the plane, metres; None if it has no position."""
        place = place_of(fix)
        if isinstance(place, str):
            return None
        origin = self._origin = self._origin or place
        north = math.radians(place.latitude_deg - origin.latitude_deg)
        east = math.radians(math.remainder(place.longitude_deg - origin.longitude_deg, 360.0))
        shrink = math.cos(math.radians(origin.latitude_deg))
        return PositionSample(fix.stamp, RADIUS * east * shrink, RADIUS * north)
