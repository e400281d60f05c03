"""Fixes in metres east and north of the first one."""

from __future__ import annotations

import math

from magcal_ros.core.earth_field.position import Fix, place_of
from magcal_ros.core.earth_field.wmm import Place
from magcal_ros.core.samples.travel_samples import PositionSample

RADIUS = 6_371_000.0
"""Metres, mean radius of the Earth: the plane's scale is right to 0.4%, its angles near it."""


class LocalPlane:
    """The plane that touches the Earth at the first good fix (equirectangular)."""

    def __init__(self) -> None:
        self._origin: Place | None = None

    def position(self, fix: Fix) -> PositionSample | None:
        """Return a fix in the plane, metres; None if it tells no place."""
        place = place_of(fix)
        if isinstance(place, str):
            return None
        origin = self._origin = self._origin or place
        north = math.radians(place.latitude_deg - origin.latitude_deg)
        east = math.radians(math.remainder(place.longitude_deg - origin.longitude_deg, 360.0))
        shrink = math.cos(math.radians(origin.latitude_deg))
        return PositionSample(fix.stamp, RADIUS * east * shrink, RADIUS * north)
