"""PX4's logs (.ulg), read by pyulog.

`sensor_mag` is the raw field in gauss, in the sensor's own forward-right-down axes;
`vehicle_magnetometer` is `R S (raw - OFF)` in the body's, with the parameters CAL_MAGn of the
device (lib/sensor_calibration). By its default profile PX4 logs the raw one once a second and the
other one twice. The other one is taken, less its calibration, where it came more often and its
calibration stayed the same.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from magcal_ros.core.earth_field.reference import Fix
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import rotation_from_rpy
from magcal_ros.core.messages import RECEIVER_SPEED_SIGMA
from magcal_ros.core.samples.streams import VelocitySample
from magcal_ros.files import logs
from magcal_ros.files.disk import FileTrouble, plain
from magcal_ros.files.recording import Recording

MAGIC = b"ULog\x01\x12\x35"
TESLA = 1e-4
"""In a gauss."""

MOST_SENSORS = 4
TOPICS = (
    "sensor_combined",
    "sensor_mag",
    "vehicle_magnetometer",
    "vehicle_gps_position",
    "vehicle_attitude",
)
NAMES = logs.Names(
    "sensor_combined",
    "sensor_mag",
    "set SDLOG_PROFILE to its default and record again",
    "look at SYS_HAS_MAG and the wiring, and record again",
)
RIGHT_ANGLES = (
    *((0, 0, 45 * k) for k in range(8)),
    *((180, 0, 45 * k) for k in range(4)), (0, 180, 0), *((180, 0, 45 * k) for k in range(5, 8)),
    *((90, 0, 45 * k) for k in range(4)),
    *((270, 0, 45 * k) for k in range(4)),
    (0, 90, 0), (0, 270, 0), (0, 180, 90), (0, 180, 270), (90, 90, 0), (180, 90, 0), (270, 90, 0),
    (90, 180, 0), (270, 180, 0), (90, 270, 0), (180, 270, 0), (270, 270, 0), (90, 180, 90),
    (90, 0, 270), (90, 68, 293), (0, 315, 0), (90, 315, 0),
)  # fmt: skip
"""Roll, pitch and yaw of MAV_SENSOR_ORIENTATION, degrees, by its number."""


def read_px4(
    path: Path, imu: str = "", mag: str = "", progress: logs.Progress | None = None
) -> Recording:
    """Read a ULog; arguments and errors as of `open_recording`."""
    if logs.begun_with(path, len(MAGIC)) != MAGIC:
        raise FileTrouble(f"{plain(str(path))} is no ULog: it does not begin as one")
    ulog = logs.library(path, "pyulog", "px4").ULog
    deadline = logs.Deadline(path, progress)
    with logs.quietly(path, deadline), _Watched(path, deadline) as handle:
        tables = _tables(ulog(handle, list(TOPICS)))
    return logs.recording_of(path, tables, NAMES, imu, mag)


class _Watched(io.BufferedReader):
    """A file whose reading may end by time, with its progress."""

    def __init__(self, path: Path, deadline: logs.Deadline) -> None:
        super().__init__(io.FileIO(path))
        self._deadline, self._size, self._count = deadline, max(path.stat().st_size, 1), 0

    def read(self, size: int | None = -1, /) -> bytes:
        self._count += 1
        if self._count % logs.EVERY == 0:
            self._deadline.report(self.tell() / self._size)
        return super().read(size)


UNKNOWN_ROTATION = (
    "the rotation {} of the magnetometer (CAL_MAG_ROT, SENS_BOARD_ROT) is not known here: choose "
    "another magnetometer with --mag"
)


def is_known(number: int) -> bool:
    """Whether `rotation_of` takes a number."""
    return 0 <= number < len(RIGHT_ANGLES)


def rotation_of(number: int) -> FloatArray:
    """Return CAL_MAGn_ROT as the rotation from sensor to body, forward-right-down."""
    if not is_known(number):
        raise FileTrouble(UNKNOWN_ROTATION.format(number))
    return rotation_from_rpy(*(math.radians(angle) for angle in RIGHT_ANGLES[number]))


def _tables(log: Any) -> logs.LogTables:
    changes = {name: v for _, name, v in log.changed_parameters}
    parameters = {**log.initial_parameters, **changes}
    is_settled = not any(name.startswith("CAL_MAG") for name in changes)
    data = {(each.name, each.multi_id): each.data for each in log.data_list}
    shift = _epoch(data.get(("vehicle_gps_position", 0)))
    tables = logs.LogTables()
    for (name, number), topic in data.items():
        stamps = 1e-6 * topic["timestamp"] + shift
        if name == "sensor_combined":
            force = _vectors(topic, "accelerometer_m_s2") * logs.FLU_FROM_FRD
            rate = _vectors(topic, "gyro_rad") * logs.FLU_FROM_FRD
            tables.imus[number] = np.column_stack([stamps, force, rate])
            if "magnetometer_ga[0]" in topic:  # releases before 1.9
                field = _vectors(topic, "magnetometer_ga") * logs.FLU_FROM_FRD * TESLA
                tables.fields.setdefault(0, np.column_stack([stamps, field]))
        elif name == "vehicle_attitude":
            w, x, y, z = (topic[f"q[{k}]"] for k in range(4))
            yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
            tables.yaw = np.column_stack([stamps, 0.5 * math.pi - yaw])
        elif name == "vehicle_gps_position" and number == 0:
            _take_fixes(tables, topic, stamps)
    refused = [
        words
        for number in range(MOST_SENSORS)
        if (words := _take_field(tables, data, number, parameters, shift, is_settled))
    ]
    if refused and not tables.fields:
        raise FileTrouble(refused[0])
    tables.notes += [f"left out: {words}" for words in refused]
    return tables


def _take_field(
    tables: logs.LogTables,
    data: Mapping[tuple[str, int], Mapping[str, FloatArray]],
    number: int,
    parameters: Mapping[str, float],
    shift: float,
    is_settled: bool,
) -> str:
    """Add a magnetometer, raw, in the body's forward-left-up axes, or return why it is left out.

    `is_settled` is whether its parameters stayed the same.
    """
    raw = data.get(("sensor_mag", number))
    device = _device(raw) if raw is not None else 0
    corrected = _corrected(data, number, device)
    if raw is not None and corrected is not None and is_settled and _is_one(corrected):
        raw = raw if len(raw["timestamp"]) >= len(corrected["timestamp"]) else None
    topic = raw if raw is not None else corrected
    if topic is None:
        return ""
    device = device or _device(topic)
    # The topics write a device unsigned, the parameters signed.
    devices = [int(parameters.get(f"CAL_MAG{k}_ID", 0)) % (1 << 32) for k in range(MOST_SENSORS)]
    slot = devices.index(device) if device in devices else None
    mounted = int(parameters.get(f"CAL_MAG{slot}_ROT", -1))
    board = int(parameters.get("SENS_BOARD_ROT", 0))
    rotation = board if mounted < 0 else mounted
    if not is_known(rotation):
        return f"{NAMES.field}[{number}]: {UNKNOWN_ROTATION.format(rotation)}"
    pose = rotation_of(rotation)
    if raw is not None:
        field = np.column_stack([raw[axis] for axis in "xyz"]) @ pose.T
    else:
        offset, matrix = _calibration(slot, parameters)
        corrected_field = _vectors(topic, "magnetometer_ga")
        inner = np.linalg.solve(matrix, (corrected_field @ pose).T).T + offset
        field = inner @ pose.T
    stamps = 1e-6 * topic["timestamp"] + shift
    tables.fields[number] = np.column_stack([stamps, field * logs.FLU_FROM_FRD * TESLA])
    tables.frames[number] = f"px4_mag{0 if slot is None else slot}_rot{rotation}"
    return ""


def _device(topic: Mapping[str, FloatArray]) -> int:
    return int(topic["device_id"][-1]) if "device_id" in topic else 0


def _corrected(
    data: Mapping[tuple[str, int], Mapping[str, FloatArray]], number: int, device: int
) -> Mapping[str, FloatArray] | None:
    """Return the corrected field of a device, of which 0 is not known, or else of this number."""
    topics = [data.get(("vehicle_magnetometer", k)) for k in range(MOST_SENSORS)]
    same = [each for each in topics if each is not None and _device(each) == device]
    return same[0] if same else topics[number] if not device else None


def _is_one(corrected: Mapping[str, FloatArray]) -> bool:
    """Whether a corrected field is of one device and one calibration."""
    marks = (corrected[name] for name in ("device_id", "calibration_count") if name in corrected)
    return not any(np.ptp(each) for each in marks)


def _calibration(
    slot: int | None, parameters: Mapping[str, float]
) -> tuple[FloatArray, FloatArray]:
    """Return offset and matrix of a slot; those of a sensor without one change nothing."""

    def of(name: str, default: float) -> list[float]:
        return [parameters.get(f"CAL_MAG{slot}_{axis}{name}", default) for axis in "XYZ"]

    (x, y, z), (xy, xz, yz) = of("SCALE", 1.0), of("ODIAG", 0.0)
    return np.array(of("OFF", 0.0)), np.array([[x, xy, xz], [xy, y, yz], [xz, yz, z]])


def _take_fixes(
    tables: logs.LogTables, topic: Mapping[str, FloatArray], stamps: FloatArray
) -> None:
    degrees = "latitude_deg" in topic  # since 1.14
    latitude = topic["latitude_deg"] if degrees else 1e-7 * topic["lat"]
    longitude = topic["longitude_deg"] if degrees else 1e-7 * topic["lon"]
    height = topic["altitude_msl_m"] if degrees else 1e-3 * topic["alt"]
    has_fix = topic["fix_type"] >= logs.FIX_3D
    for row in zip(has_fix, latitude, longitude, height, stamps, strict=True):
        tables.fixes.append(Fix(bool(row[0]), *map(float, row[1:])))
    moving = np.column_stack([stamps, topic["vel_e_m_s"], topic["vel_n_m_s"]])[has_fix]
    tables.velocities += [
        VelocitySample(stamp, east, north, RECEIVER_SPEED_SIGMA)
        for stamp, east, north in moving[np.isfinite(moving).all(axis=1)].tolist()
    ]


def _epoch(topic: Mapping[str, FloatArray] | None) -> float:
    """Return what takes the log's clock to seconds since 1970, by the receiver; else zero."""
    if topic is None or "time_utc_usec" not in topic:
        return 0.0
    known = np.flatnonzero(topic["time_utc_usec"])
    if not len(known):
        return 0.0
    return 1e-6 * (float(topic["time_utc_usec"][known[0]]) - float(topic["timestamp"][known[0]]))


def _vectors(topic: Mapping[str, FloatArray], name: str) -> FloatArray:
    return np.column_stack([topic[f"{name}[{axis}]"] for axis in range(3)]).astype(np.float64)
