"""Compare a calibration with the course, or with an autopilot's yaw, on a recorded drive."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.driving.chords import CourseOffset
from magcal_ros.core.driving.mounting_yaw import MountingYaw
from magcal_ros.core.driving.travel_estimator import TravelReplay
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import mean_angle, wrap_angle, wrapped
from magcal_ros.core.heading.compass import Compass, CompassReader
from magcal_ros.core.samples.samples_tuning import STREAMS
from magcal_ros.core.samples.streams import FieldSample, ImuSample, Streams, TravelSample


@dataclass(frozen=True, eq=False)
class RecordedCourse:
    """Compass against course over a recording."""

    offset: CourseOffset
    mounting: MountingYaw | None = None  # of the IMU, by its acceleration
    declination: float | None = None
    """Radians, positive east, of the place, a part of the offset; None if unknown."""

    @property
    def words(self) -> str:
        """The comparison in one sentence."""
        found, north = self.offset, self.declination
        part = "this includes the declination, which is not known: give the position"
        if north is not None:
            rest = math.degrees(math.remainder(found.offset - north, math.tau))
            part = (
                f"{math.degrees(north):+.1f}° of it is declination, {rest:+.1f}° is the mounting "
                "of the IMU in the vehicle, or an error"
            )
        return (
            f"compass minus course {math.degrees(found.offset):+.1f}° "
            f"±{math.degrees(found.sigma):.1f}° over {found.metres:.0f} m of straight driving, "
            f"{found.sectors} of 8 courses; {part}"
        )

    def facts(self) -> dict[str, Any]:
        """Return the same for a program."""
        found, known = self.offset, self.declination
        declination = None if known is None else round(math.degrees(known), 2)
        return {
            "offset_deg": round(math.degrees(found.offset), 2),
            "sigma_deg": round(math.degrees(found.sigma), 2),
            "declination_deg": declination,
            "metres": round(found.metres),
            "courses": found.sectors,
        }


def recorded_course(
    calibration: Calibration,
    readings: Iterable[ImuSample | FieldSample | None],
    travel: Iterable[TravelSample],
    declination: float | None = None,
) -> RecordedCourse | None:
    """Compare a calibration's compass with course; None without straight driving.

    Readings are in order of arrival, travel in order of stamps; `declination` (rad) is that of the
    place.
    """
    replay = TravelReplay(travel, Streams(STREAMS.max_gap))
    estimator = replay.estimator
    for _, yaw in _yaws(calibration, replay, readings):
        estimator.add_yaw(yaw)
    course = estimator.fit_course()
    if course is None:
        return None
    return RecordedCourse(course, estimator.known_mounting, declination)


def _yaws(
    calibration: Calibration,
    replay: TravelReplay,
    readings: Iterable[ImuSample | FieldSample | None],
) -> Iterator[tuple[float, float]]:
    """Yield stamp (s) and yaw (rad) of each field sample, which is without the motors' field."""
    compass, reader = Compass(replace(calibration, motors=None)), CompassReader(replay.up)
    for sample in replay.readings(readings):
        if isinstance(sample, FieldSample):
            heading = reader.read(compass, sample).heading
            if heading is not None:
                yield sample.stamp, heading.yaw


def against_own_yaw(
    calibration: Calibration,
    readings: Iterable[ImuSample | FieldSample | None],
    yaw: FloatArray,
    declination: float | None = None,
) -> str:
    """Compare a compass with an autopilot's yaw (n, 2), s and rad, ENU; empty if it has none."""
    if len(yaw) < 2:
        return ""
    replay = TravelReplay((), Streams(STREAMS.max_gap))
    seen = _yaws(calibration, replay, readings)
    inside = [each for each in seen if yaw[0, 0] <= each[0] <= yaw[-1, 0]]
    if not inside:
        return ""
    stamps, compass_yaw = np.array(inside).T
    own = np.interp(stamps, yaw[:, 0], np.unwrap(yaw[:, 1]))
    gaps = wrap_angle(compass_yaw - (declination or 0.0) - own)
    middle = mean_angle(gaps)
    offset = middle + float(np.median(wrap_angle(gaps - middle)))
    scatter = 1.4826 * float(np.median(np.abs(wrap_angle(gaps - offset))))
    north = "with the declination, which is not known"
    if declination is not None:
        north = "declination subtracted"
    return (
        f"compass minus the autopilot's own yaw {math.degrees(wrapped(offset)):+.1f}°, scattered "
        f"by {math.degrees(scatter):.1f}° (1σ) over {len(gaps)} samples, {north}: this proves "
        "nothing, as the autopilot's yaw depends on its own compass and calibration"
    )
