"""PX4's logs (.ulg), read by pyulog.

`sensor_mag` is the raw field in gauss, in the sensor's own forward-right-down axes.
`vehicle_magnetometer` is `L R S (raw + P COMP - OFF) - bias` in the body's, with the parameters
CAL_MAGn of the device (lib/sensor_calibration, VehicleMagnetometer). L levels the board
(SENS_BOARD_X_OFF, Y, Z) and R is CAL_MAGn_ROT or SENS_BOARD_ROT. P is the throttle or current of
CAL_MAG_COMP_TYP, and bias the estimate made while disarmed. By its default profile, PX4 logs
`sensor_mag` once a second and `vehicle_magnetometer` twice or more. The latter is used, with its
calibration removed, if the parameters stayed the same and it has more samples or PX4 compensates
for the power. This compensation stays in the field, because PX4 continues it.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from magcal_ros.core.earth_field.reference import Fix
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import rotation_from_rpy, rpy_from_rotation
from magcal_ros.core.samples.streams import VelocitySample
from magcal_ros.files import logs
from magcal_ros.files.disk import FileError
from magcal_ros.files.recording import Recording
from magcal_ros.files.wire import RECEIVER_SPEED_SIGMA

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
    "magnetometer_bias_estimate",
)
SELECTIONS = ("sensor_selection", "estimator_selector_status", "estimator_status")
"""Topics with the magnetometer that PX4 uses; the first that names one is taken."""

Topic = Mapping[str, FloatArray]
Topics = Mapping[tuple[str, int], Topic]
Parameters = Mapping[str, float]
STAMP = "stamp"  # the stamp of a sample, seconds, which is added to each topic
IMU = "sensor_combined", "set SDLOG_PROFILE to its default and record again"
MAGNETOMETER = "sensor_mag", "check SYS_HAS_MAG and the wiring, and record again"
"""Names of the sensors, and what to do if one is missing."""

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

CUSTOM = 100  # the number of the rotation whose angles are the parameters CAL_MAGn_ROLL, PITCH, YAW

DEFAULT_PRIORITY = 50.0


def read_px4(path: Path, imu: str, mag: str, progress: logs.Progress | None) -> Recording:
    """Read a ULog; arguments and errors are those of `open_recording`."""
    if logs.first_bytes(path, len(MAGIC)) != MAGIC:
        raise FileError.of(path, "is not a ULog: its first bytes are not those of one")
    ulog = logs.library(path, "pyulog", "px4").ULog
    with logs.limited(path, progress) as deadline, _LimitedFile(path, deadline) as handle:
        tables = _tables(ulog(handle, [*TOPICS, *SELECTIONS]))
    return tables.recording(path, imu, mag)


class _LimitedFile(io.BufferedReader):
    """A file whose reading has a time limit and reports its progress."""

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

NOT_COMPENSATED = (
    "PX4 compensates for the power (CAL_MAG_COMP_TYP), and the log has the raw field only: set it "
    "to 0 together with the exported numbers, or log vehicle_magnetometer"
)
COMPENSATED = (
    "the field includes the compensation for the power (CAL_MAG_COMP_TYP): do not change it, the "
    "result depends on it"
)


def rotation_of(number: int) -> FloatArray:
    """Return CAL_MAGn_ROT as the rotation from sensor to body, forward-right-down."""
    if not 0 <= number < len(RIGHT_ANGLES):
        raise FileError(UNKNOWN_ROTATION.format(number))
    return _rotation(*RIGHT_ANGLES[number])


def _rotation(roll: float, pitch: float, yaw: float) -> FloatArray:
    return rotation_from_rpy(math.radians(roll), math.radians(pitch), math.radians(yaw))


def _pose(slot: int | None, parameters: Parameters) -> tuple[FloatArray, str]:
    """Return the rotation from a sensor to the body, and its name in the sensor's frame."""
    mounted = int(parameters.get(f"CAL_MAG{slot}_ROT", -1))
    number = int(parameters.get("SENS_BOARD_ROT", 0)) if mounted < 0 else mounted
    level = [parameters.get(f"SENS_BOARD_{axis}_OFF", 0.0) for axis in "XYZ"]
    if number == CUSTOM:
        names = ("ROLL", "PITCH", "YAW")
        own = _rotation(*(parameters.get(f"CAL_MAG{slot}_{name}", 0.0) for name in names))
    else:
        own = rotation_of(number)
        if not any(level):
            return own, f"rot{number}"
    angles = [round(math.degrees(v), 2) + 0.0 for v in rpy_from_rotation(_rotation(*level) @ own)]
    return _rotation(*angles), "rpy" + "_".join(f"{angle:g}" for angle in angles)


def mounting_of(frame: str) -> tuple[int, FloatArray, str] | None:
    """Return slot, rotation to the body and its name from a magnetometer's frame, or None."""
    angle = r"(-?[\d.]+)"
    found = re.fullmatch(rf"px4_mag(\d)_(rot(\d+)|rpy{angle}_{angle}_{angle})", frame)
    if found is None:
        return None
    slot, name, number, *angles = found.groups()
    pose = rotation_of(int(number)) if number else _rotation(*map(float, angles))
    return int(slot), pose, name


def _tables(log: Any) -> logs.LogTables:
    changes = {name: v for _, name, v in log.changed_parameters}
    parameters = {**log.initial_parameters, **changes}
    is_settled = not any(name.startswith("CAL_MAG") for name in changes)
    topics = {(each.name, each.multi_id): each.data for each in log.data_list}
    shift = _epoch(topics.get(("vehicle_gps_position", 0), {}))
    data = {k: {**each, STAMP: 1e-6 * each["timestamp"] + shift} for k, each in topics.items()}
    tables = logs.LogTables(logs.Sensors(*IMU), logs.Sensors(*MAGNETOMETER))
    for (name, number), topic in data.items():
        stamps = topic[STAMP]
        if name == "sensor_combined":
            force = _vectors(topic, "accelerometer_m_s2") * logs.FLU_FROM_FRD
            rate = _vectors(topic, "gyro_rad") * logs.FLU_FROM_FRD
            tables.imus.found[number] = logs.Sensor(np.column_stack([stamps, force, rate]))
            if "magnetometer_ga[0]" in topic:  # releases before 1.9
                field = _vectors(topic, "magnetometer_ga") * logs.FLU_FROM_FRD * TESLA
                first = logs.Sensor(np.column_stack([stamps, field]))
                tables.fields.found.setdefault(0, first)
        elif name == "vehicle_attitude":
            w, x, y, z = (topic[f"q[{k}]"] for k in range(4))
            yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
            tables.yaw = np.column_stack([stamps, 0.5 * math.pi - yaw])
        elif name == "vehicle_gps_position" and number == 0:
            _take_fixes(tables, topic)
    for number in range(MOST_SENSORS):
        _take_field(tables, data, number, parameters, is_settled)
    if tables.notes and not tables.fields.found:
        raise FileError(tables.notes[0])
    tables.notes = [f"left out: {words}" for words in tables.notes]
    _sort(tables.fields, data, parameters)
    return tables


def _take_field(
    tables: logs.LogTables, data: Topics, number: int, parameters: Parameters, is_settled: bool
) -> None:
    """Add a raw field in the body's forward-left-up axes, or note why it is left out."""
    raw = _of_one(data.get(("sensor_mag", number), {}))
    corrected = _corrected(data, number, _device(raw))
    topic = raw or corrected
    if not topic:
        return
    slot = _slot(_device(topic), parameters)
    compensates = bool(parameters.get("CAL_MAG_COMP_TYP", 0))
    has_power = compensates and any(_of_axes(slot, "COMP", parameters))
    # The calibration can be removed only if its parameters stayed the same.
    if raw and corrected and is_settled:
        more = len(corrected["timestamp"]) > len(raw["timestamp"])
        topic = corrected if more or has_power else raw
    try:
        pose, name = _pose(slot, parameters)
    except FileError as problem:
        tables.notes.append(f"{tables.fields.called(number)}: {problem}")
        return
    if topic is raw:
        field = np.column_stack([topic[axis] for axis in "xyz"]) @ pose.T
    else:
        offset, scale = _of_axes(slot, "OFF", parameters), _of_axes(slot, "SCALE", parameters, 1.0)
        matrix = logs.symmetric(scale, _of_axes(slot, "ODIAG", parameters))
        bias = _bias(data, number, topic["timestamp"])
        inner = (_vectors(topic, "magnetometer_ga") + bias) @ pose
        field = (np.linalg.solve(matrix, inner.T).T + offset) @ pose.T
    rows = np.column_stack([topic[STAMP], field * logs.FLU_FROM_FRD * TESLA])
    frame = f"px4_mag{0 if slot is None else slot}_{name}"
    notes = [NOT_COMPENSATED if topic is raw else COMPENSATED] if has_power else []
    tables.fields.found[number] = logs.Sensor(rows, frame=frame, notes=notes)


def _sort(fields: logs.Sensors, data: Topics, parameters: Parameters) -> None:
    """Put the magnetometers in order: the one PX4 selected, then by CAL_MAGn_PRIO."""
    choices = (data.get((name, 0), {}).get("mag_device_id", np.empty(0)) for name in SELECTIONS)
    selected = next(filter(None, map(logs.most_common, choices)), 0)
    devices = {
        k: _device(data[name, k])
        for name in ("vehicle_magnetometer", "sensor_mag")
        for k in range(MOST_SENSORS)
        if (name, k) in data
    }

    def rank(number: int) -> tuple[bool, float, int]:
        slot = _slot(devices[number], parameters)
        priority = parameters.get(f"CAL_MAG{slot}_PRIO", DEFAULT_PRIORITY)
        return devices[number] != selected, -priority, number

    fields.order = sorted(devices, key=rank)
    if fields.order and selected and devices[fields.order[0]] == selected:
        fields.reason = "which PX4 selected"
    elif any(name.endswith("_PRIO") for name in parameters):
        fields.reason = "the first by CAL_MAG_PRIO"


def _slot(device: int, parameters: Parameters) -> int | None:
    # A device is an unsigned number in the topics, and a signed one in the parameters.
    devices = [int(parameters.get(f"CAL_MAG{k}_ID", 0)) % (1 << 32) for k in range(MOST_SENSORS)]
    return devices.index(device) if device and device in devices else None


def _device(topic: Topic) -> int:
    return int(topic["device_id"][-1]) if "device_id" in topic else 0


def _corrected(data: Topics, number: int, device: int) -> Topic:
    """Return the corrected field of a device; for an unknown device, 0, that of this number."""
    topics = [_of_one(data.get(("vehicle_magnetometer", k), {})) for k in range(MOST_SENSORS)]
    same = [each for each in topics if each and _device(each) == device]
    return same[0] if same else topics[number] if not device else {}


def _of_one(topic: Topic) -> Topic:
    """Return the samples of the last device with its last calibration."""
    # With SENS_MAG_MODE at 1, the first topic changes to the device that is selected.
    marks = [topic[name] for name in ("device_id", "calibration_count") if name in topic]
    same = np.all([mark == mark[-1] for mark in marks], axis=0) if marks else ...
    return {name: values[same] for name, values in topic.items()}


def _bias(data: Topics, number: int, stamps: FloatArray) -> FloatArray:
    """Return the bias that PX4 subtracted, body axes, gauss. Shape (n, 3)."""
    topic = data.get(("magnetometer_bias_estimate", 0))
    if topic is None:
        return np.zeros((len(stamps), 3))
    valid = topic[f"valid[{number}]"] != 0
    known = np.column_stack([topic[f"bias_{axis}[{number}]"][valid] for axis in "xyz"])
    held = np.searchsorted(topic["timestamp"][valid], stamps, "right")
    return np.vstack([np.zeros(3), known])[held]


def _of_axes(
    slot: int | None, name: str, parameters: Parameters, default: float = 0.0
) -> FloatArray:
    """Return three parameters of a slot; their defaults without a slot."""
    return np.array([parameters.get(f"CAL_MAG{slot}_{axis}{name}", default) for axis in "XYZ"])


def _take_fixes(tables: logs.LogTables, topic: Topic) -> None:
    degrees = "latitude_deg" in topic  # since 1.14
    latitude = topic["latitude_deg"] if degrees else 1e-7 * topic["lat"]
    longitude = topic["longitude_deg"] if degrees else 1e-7 * topic["lon"]
    height = topic["altitude_msl_m"] if degrees else 1e-3 * topic["alt"]
    stamps, has_fix = topic[STAMP], topic["fix_type"] >= logs.FIX_3D
    for row in zip(has_fix, latitude, longitude, height, stamps, strict=True):
        tables.fixes.append(Fix(bool(row[0]), *map(float, row[1:])))
    moving = np.column_stack([stamps, topic["vel_e_m_s"], topic["vel_n_m_s"]])[has_fix]
    tables.velocities += [
        VelocitySample(stamp, east, north, RECEIVER_SPEED_SIGMA)
        for stamp, east, north in moving[np.isfinite(moving).all(axis=1)].tolist()
    ]


def _epoch(topic: Topic) -> float:
    """Return the offset of the log's clock to seconds since 1970; zero without a receiver."""
    for utc, own in zip(topic.get("time_utc_usec", ()), topic.get("timestamp", ()), strict=False):
        if utc:
            return 1e-6 * (float(utc) - float(own))
    return 0.0


def _vectors(topic: Topic, name: str) -> FloatArray:
    return np.column_stack([topic[f"{name}[{axis}]"] for axis in range(3)]).astype(np.float64)
