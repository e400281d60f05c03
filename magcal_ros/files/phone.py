"""Folders that a phone's Sensor Logger or phyphox exports, unpacked.

Sensor Logger writes one file for each sensor: `time` (ns since 1970), `seconds_elapsed`, z, y, x;
fields in microtesla. phyphox has the unit in the header: `"Time (s)","Magnetic field x (µT)"`. A
phone's x points to the right of its screen, y to its upper edge and z out of the screen. In the
recording, x points to the upper edge and y to the left. --imu-rpy-deg gives the pose of the phone
in the vehicle.
"""

from __future__ import annotations

import contextlib
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from magcal_ros.core.earth_field.reference import Fix
from magcal_ros.core.geometry.arrays import FloatArray, interpolated
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY, usual_size
from magcal_ros.files import logs
from magcal_ros.files.disk import FileError
from magcal_ros.files.recording import Recording, read_header, read_numbers

NANOSECOND = 1e9
FLU_FROM_PHONE = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
METADATA = "Metadata.csv"
IMU = "phone IMU", "record accelerometer (with gravity) and gyroscope"
MAGNETOMETER = (
    "phone magnetometer",
    "not every phone has one; record the magnetometer, best uncalibrated",
)
"""Names of the sensors, and what to do if one is missing."""
NO_GYRO = (
    "there is no gyroscope: record it if the phone has one. Without it only a slow turn on the "
    "spot is calibrated"
)
FORCE, RATE, FIELD = "m/s^2", "rad/s", "T"
MICRO = re.compile(r"[µμu]T")
UNIT = re.compile(r"\(([^()]*)\)\s*$")
SPEED_AND_COURSE = ("speed", "bearing"), ("velocity", "direction")
"""Columns of the velocity over ground by Sensor Logger and by phyphox."""
LEAST_GRAVITY = 0.5 * STANDARD_GRAVITY
"""m/s². If the usual reading of an accelerometer is less, gravity was subtracted."""


def is_phone_folder(path: Path) -> bool:
    """Whether a folder looks like a phone's: CSV files with headers of one of the two programs."""
    return path.is_dir() and any(
        _is_logger(header) or _is_phyphox(header) for header in _headers(path).values()
    )


def read_phone(path: Path) -> Recording:
    """Read a folder of Sensor Logger or phyphox.

    FileError, with the sensors to record, if accelerometer or magnetometer is missing or gravity
    was subtracted. Without a gyroscope the rates are NaN.
    """
    headers = _headers(path)
    logger = any(map(_is_logger, headers.values()))
    notes: list[str] = []
    read = _logger_sensors if logger else _phyphox_sensors
    force, rate, field = read(path, headers, notes)
    if force is None or field is None:
        names = zip(("accelerometer", "field"), (force, field), strict=True)
        missing = [name for name, table in names if table is None]
        raise FileError.of(
            path,
            f"has no {' and no '.join(missing)}. Record accelerometer (with gravity), gyroscope "
            "and magnetometer with the phone, and unpack what it exports",
        )
    size = usual_size(force[:, 1:])
    if size < LEAST_GRAVITY:
        raise FileError.of(
            path,
            f"has acceleration without gravity ({size:.1f} m/s²): record the accelerometer with "
            "gravity (phyphox: Acceleration with g; Sensor Logger: Total Acceleration, or Gravity "
            "beside the accelerometer)",
        )
    turns = np.full_like(force[:, 1:], math.nan)
    if rate is None:
        notes.append(NO_GYRO)
    else:
        turns = interpolated(force[:, 0], rate[:, 0], rate[:, 1:4])
        turns[(force[:, 0] < rate[0, 0]) | (force[:, 0] > rate[-1, 0])] = math.nan
    tables = logs.LogTables(logs.Sensors(*IMU), logs.Sensors(*MAGNETOMETER), notes=notes)
    imu = [force[:, 0], force[:, 1:] @ FLU_FROM_PHONE.T, turns @ FLU_FROM_PHONE.T]
    mag = [field[:, 0], 1e-6 * field[:, 1:] @ FLU_FROM_PHONE.T]
    tables.imus.found[0] = logs.Sensor(np.column_stack(imu))
    tables.fields.found[0] = logs.Sensor(np.column_stack(mag))
    _add_fixes(path, headers, tables)
    return replace(tables.recording(path), imu_topic=IMU[0], field_topic=MAGNETOMETER[0])


def _headers(path: Path) -> dict[str, list[str]]:
    """Return the header of each CSV file, by the file's name."""
    found = {}
    for file in sorted(path.glob("*.csv")):
        # Other files in the folder do not matter.
        with contextlib.suppress(FileError):
            found[file.name] = read_header(file)
    return found


def _is_logger(header: list[str]) -> bool:
    return {"time", "seconds_elapsed", "x", "y", "z"} <= set(header)


def _is_phyphox(header: list[str]) -> bool:
    return header[0] == "Time (s)" and len(header) > 3


Sensors = tuple[FloatArray | None, FloatArray | None, FloatArray | None]
"""Stamps and the phone's x, y, z of acceleration with gravity, rate, and field in microtesla."""


def _logger_sensors(path: Path, headers: dict[str, list[str]], notes: list[str]) -> Sensors:
    def read(name: str) -> FloatArray | None:
        header = headers.get(f"{name}.csv", [])
        if not _is_logger(header):
            return None
        columns = [header.index(each) for each in ("time", "x", "y", "z")]
        return _in_order(read_numbers(path / f"{name}.csv", columns, NANOSECOND))

    force = read("TotalAcceleration")
    if force is None:
        own, gravity = read("Accelerometer"), read("Gravity")
        if own is not None and gravity is not None:
            own[:, 1:] += interpolated(own[:, 0], gravity[:, 0], gravity[:, 1:])
            force = own
    if force is None:
        force = read("AccelerometerUncalibrated")
        if force is not None and usual_size(force[:, 1:]) < LEAST_GRAVITY:
            force[:, 1:] *= STANDARD_GRAVITY
    if force is not None and _points_down(path, headers):
        force[:, 1:] *= -1.0
    rate = read("Gyroscope")
    field = read("MagnetometerUncalibrated")
    if field is None:
        field = read("Magnetometer")
        notes.append(
            "the field includes the phone's own calibration, which may jump when the phone "
            "updates it: record the uncalibrated magnetometer"
        )
    return force, rate if rate is not None else read("GyroscopeUncalibrated"), field


def _points_down(path: Path, headers: dict[str, list[str]]) -> bool:
    """Whether the accelerometer has the sign of iOS: -1 g on z if the screen points up."""
    header = headers.get(METADATA, [])
    if not {"platform", "standardisation"} <= set(header):
        return False
    lines = (path / METADATA).read_text(encoding="utf-8", errors="replace").splitlines()
    cells = lines[1].split(",") if len(lines) > 1 else []
    if len(cells) != len(header):
        return False
    columns = dict(zip(header, cells, strict=True))
    return columns["platform"].lower() == "ios" and columns["standardisation"].lower() != "true"


def _phyphox_sensors(path: Path, headers: dict[str, list[str]], _: list[str]) -> Sensors:
    found: dict[str, FloatArray] = {}
    for name, header in headers.items():
        if not _is_phyphox(header) or "linear" in f"{name} {header[1]}".lower():
            continue
        unit = UNIT.search(header[1])
        kind = "" if unit is None else FIELD if MICRO.match(unit[1]) else unit[1]
        if kind in (FORCE, RATE, FIELD) and kind not in found:
            found[kind] = _in_order(read_numbers(path / name, range(4)))
    return found.get(FORCE), found.get(RATE), found.get(FIELD)


def _add_fixes(path: Path, headers: dict[str, list[str]], tables: logs.LogTables) -> None:
    """Add fixes and velocities of `Location.csv`, or of the first file with latitudes."""
    for name, header in headers.items():
        plain_names = [each.split(" (")[0].lower() for each in header]
        if not {"time", "latitude", "longitude"} <= set(plain_names) or name.startswith("Watch"):
            continue
        second = NANOSECOND if "seconds_elapsed" in plain_names else 1.0
        moving = next((each for each in SPEED_AND_COURSE if set(each) <= set(plain_names)), ())
        wanted = ("time", "latitude", "longitude", *moving)
        columns = [plain_names.index(each) for each in wanted]
        for stamp, latitude, longitude, *motion in read_numbers(
            path / name, columns, second
        ).tolist():
            # A negative speed or course is unknown.
            is_known = motion and min(motion) >= 0.0
            over_ground, bearing = motion if is_known else (math.nan, math.nan)
            fix = Fix(True, latitude, longitude, math.nan, stamp)
            tables.take_fix(fix, over_ground, math.radians(bearing))
        return


def _in_order(table: FloatArray) -> FloatArray:
    """Return the rows sorted by stamp, without duplicate stamps."""
    table = table[np.isfinite(table[:, 0])]
    return table[np.unique(table[:, 0], return_index=True)[1]]
