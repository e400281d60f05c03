"""Speed and fixes beside a recorded drive: `odom.csv` and `gps.csv`, both optional."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from magcal_ros.core.driving.local_plane import LocalPlane
from magcal_ros.core.earth_field.position import Fix, place_of
from magcal_ros.core.earth_field.wmm import Place
from magcal_ros.core.samples.travel_samples import PositionSample, SpeedSample, TravelSample
from magcal_ros.files.tables import read_columns

SPEED_COLUMNS = ("t", "speed")
FIX_COLUMNS = ("t", "latitude", "longitude", "altitude")
LEVEL_FIX_COLUMNS = FIX_COLUMNS[:3]
PLANE_COLUMNS = ("t", "east", "north")


@dataclass(frozen=True)
class Tables:
    """What wheels and receiver said, by stamp, and where the first good fix was."""

    travel: tuple[TravelSample, ...] = ()
    place: Place | None = None


def read_travel(folder: Path) -> Tables:
    """Read `odom.csv` (t,speed) and `gps.csv` (t,latitude,longitude or t,east,north) of a folder.

    Parameters
    ----------
    folder : Path
        May hold the two files, each with a header line; seconds, m/s (negative backwards), degrees
        and metres. A row that is not finite is no sample.

    Raises
    ------
    FileTrouble
        If a column is missing, or a line is not numbers.
    """
    found, place = list[TravelSample](), None
    if (folder / "odom.csv").exists():
        _, rows = read_columns(folder / "odom.csv", SPEED_COLUMNS)
        found += [SpeedSample(*row) for row in rows.tolist()]
    if (folder / "gps.csv").exists():
        columns, rows = read_columns(
            folder / "gps.csv", FIX_COLUMNS, LEVEL_FIX_COLUMNS, PLANE_COLUMNS
        )
        if columns == PLANE_COLUMNS:
            found += [PositionSample(*row) for row in rows.tolist()]
        else:
            fixes = [
                Fix(True, latitude, longitude, height[0] if height else math.nan, stamp)
                for stamp, latitude, longitude, *height in rows.tolist()
            ]
            plane = LocalPlane()
            found += [each for each in map(plane.position, fixes) if each is not None]
            place = next((each for each in map(place_of, fixes) if isinstance(each, Place)), None)
    return Tables(tuple(sorted(found, key=lambda sample: sample.stamp)), place)
