"""ArduPilot's logs: DataFlash (.BIN, .log) and telemetry (.tlog), read by pymavlink.

MAG holds the corrected field, `D SCALE (raw + OFS) + motors` in milligauss, cut to whole numbers
(AP_Compass_Backend::correct_field; releases before 3.6 add the motors' part before D). The raw
field is that of the sensor after COMPASS_ORIENT and, for a sensor on the board, after
AHRS_ORIENTATION. So field and IMU are in the vehicle's axes, forward-right-down. MAG also holds the
offsets; D and SCALE are parameters. The autopilot's calibration is removed from the field. The
compensation of the motors (COMPASS_MOT) is kept, because it continues in flight: without it, the
motors' mean field would be part of the hard iron, and would be subtracted twice. RAW_IMU and
SCALED_IMU of telemetry hold the same field.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from magcal_ros.core.earth_field.reference import Fix
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY
from magcal_ros.files import logs
from magcal_ros.files.dataflash import BINARY, DataFlash, flat_arrays, read_dataflash, tables_of
from magcal_ros.files.disk import FileError
from magcal_ros.files.recording import Recording

SUFFIXES = (".bin", ".log", ".tlog")

TESLA = 1e-7  # in a milligauss

LOGGED = (
    ("IMU", "let LOG_BITMASK log IMU, and record again", "GH or AH is 0"),
    (
        "MAG",
        "check COMPASS_ENABLE and the wiring, let LOG_BITMASK log COMPASS, and record again",
        "Health is 0",
    ),
)
TRANSMITTED = (
    (
        "IMU",
        "ask for RAW_IMU at 10 Hz or more (SR0_RAW_SENS), or take the log from the autopilot's "
        "card",
    ),
    ("MAG", "check COMPASS_ENABLE and the wiring, and record again"),
)
"""Name of IMU and magnetometer, what to do without one, and the mark of an unhealthy one."""

REPEATED = -1
RAW_KINDS = {"RAW_IMU": 0, "SCALED_IMU": REPEATED, "SCALED_IMU2": 1, "SCALED_IMU3": 2}
"""Messages of telemetry, and the number of the sensor. SCALED_IMU repeats RAW_IMU."""

TELEMETRY_KINDS = {*RAW_KINDS, "ATTITUDE", "GPS_RAW_INT", "PARAM_VALUE"}

AUTOPILOT = 1  # component of MAVLink: cameras and gimbals have others
SLOTS = ("", "2", "3")  # how the parameters of the compasses, and of the IMUs, are numbered
PARAMETERS = ("COMPASS_", "EK3_", "INS_USE")  # prefixes of the parameters that are read

SMALLEST_SCALE, LARGEST_SCALE = 1.0 / 1.5, 1.5
"""Range of COMPASS_SCALE; the autopilot ignores other values (Compass::have_scale_factor)."""

BACKWARDS, LATE = 1.0, 10.0
"""Seconds by which the clock goes back, or a message is late, if the autopilot was restarted."""

Parameters = dict[str, float]
History = list[tuple[float, Parameters]]
"""All parameters, with the time from which they are valid: the autopilot may change them."""


def read_ardupilot(path: Path, imu: str, mag: str, progress: logs.Progress | None) -> Recording:
    """Read a DataFlash or telemetry log; arguments and errors are those of `open_recording`."""
    head = logs.first_bytes(path, 8000)
    telemetry = path.suffix.lower() == ".tlog"
    is_text = path.suffix.lower() == ".log" and b"FMT," in head
    if not (telemetry or is_text or head[:2] == BINARY):
        raise FileError.of(path, "is not a DataFlash log: its first bytes are not those of one")
    with logs.limited(path, progress) as deadline:
        if telemetry:
            tables = _tables(_telemetry(path, deadline), TRANSMITTED)
        else:
            tables = _tables(read_dataflash(path, head, deadline), LOGGED)
        deadline.report(1.0)
    return tables.recording(path, imu, mag)


def _tables(found: DataFlash, names: tuple[tuple[str, ...], ...]) -> logs.LogTables:
    """Return the log in SI units and forward-left-up axes, without the autopilot's calibration."""
    imus, fields = (logs.Sensors(*each) for each in names)
    tables, parameters = logs.LogTables(imus, fields), _history(found)
    for number, part in _instances(found, "IMU"):
        healthy = part[(part[:, 8] != 0.0) & (part[:, 9] != 0.0)]
        turned = healthy[:, 2:8] * np.tile(logs.FLU_FROM_FRD, 2)
        rows = np.column_stack([healthy[:, 0], turned])
        imus.found[number] = logs.Sensor(rows, len(part) - len(healthy))
    for number, part in _instances(found, "MAG"):
        fields.found[number] = _compass(number, part, parameters)
    if "ATT" in found.tables:
        stamps, bearing = found.tables["ATT"].T
        tables.yaw = np.column_stack([stamps, np.radians(90.0 - bearing)])
    receivers = found.tables.get("GPS", np.empty(0)).tolist()
    for stamp, number, status, latitude, longitude, altitude, speed, course in receivers:
        if not number > 0.0:  # the first receiver, which old releases do not number
            fix = Fix(status >= logs.FIX_3D, latitude, longitude, altitude, stamp)
            tables.take_fix(fix, speed, math.radians(course))
    newest = parameters[-1][1]
    _sort_sensors(tables, newest, _lane(found))
    if names is TRANSMITTED and "COMPASS_OFS_X" not in newest:
        tables.notes.append(
            "the log does not hold the parameters COMPASS_OFS: the field is taken as if they "
            "were 0. Offsets that are found must be added to those in force"
        )
    return tables


def _history(found: DataFlash) -> History:
    """Return all parameters by time; a parameter's first value is also valid before it."""
    history: History = [(-math.inf, {})]
    for stamp, name, value in found.parameters:
        newest = history[-1][1]
        if not name.startswith(PARAMETERS):
            continue
        if name not in newest:
            for _, each in history:
                each[name] = value
        elif newest[name] != value:
            history.append((stamp, {**newest, name: value}))
    return history


def _lane(found: DataFlash) -> tuple[int, int] | None:
    """Return the EKF's lane that was used most of the time, and its compass; None if unknown."""
    if not {"XKFS", "XKF4"} <= found.tables.keys():
        return None
    selected, lane = found.tables["XKFS"], logs.most_common(found.tables["XKF4"][:, 1])
    return lane, logs.most_common(selected[selected[:, 1] == lane, 2])


def _instances(found: DataFlash, kind: str) -> Iterable[tuple[int, FloatArray]]:
    """Yield a sensor's number and its rows; old releases number them by the message's name."""
    for usual, name in enumerate((kind, f"{kind}2", f"{kind}3")):
        table = found.tables.get(name)
        if table is not None:
            numbers = np.where(np.isnan(table[:, 1]), usual, table[:, 1])
            for number in np.unique(numbers):
                yield int(number), table[numbers == number]


def _telemetry(path: Path, deadline: logs.Deadline) -> DataFlash:
    """Read a telemetry log into the tables of a DataFlash log."""
    reader = logs.library(path, "pymavlink.mavutil", "ardupilot").mavlogfile(str(path))
    read, count, known = _Telemetry(), 0, 0
    try:
        while (message := reader.recv_msg()) is not None:
            if count % logs.EVERY == 0:
                deadline.report(0.01 * reader.percent)
            count += 1
            kind = message.get_type()
            known += not kind.startswith(("BAD_DATA", "UNKNOWN"))
            read.take(kind, message)
    finally:
        reader.close()
    if not known:
        raise FileError.of(path, "is not a telemetry log: no MAVLink message is in it")
    return read.logged()


NOT_SENT = (math.nan,) * 7  # offsets, motors' part and health of a magnetometer


class _Telemetry:
    """Collects telemetry messages, added one by one, as messages of a DataFlash log."""

    def __init__(self) -> None:
        self._rows = flat_arrays()
        self._parameters: list[tuple[float, str, float]] = []
        self._system: int | None = None
        self._booted = self._own = math.nan

    def take(self, kind: str, m: Any) -> None:
        """Add a message of any kind."""
        if kind not in TELEMETRY_KINDS or m.get_srcComponent() != AUTOPILOT:
            return
        if self._system is None:
            self._system = m.get_srcSystem()
        if m.get_srcSystem() != self._system:
            return
        if kind in RAW_KINDS:
            stamp, number = self._by_own_clock(m), RAW_KINDS[kind]
            force = (value * STANDARD_GRAVITY for value in (m.xacc, m.yacc, m.zacc))
            row = [1e-3 * value for value in (*force, m.xgyro, m.ygyro, m.zgyro)]
            self._rows["IMU"].extend((stamp, number, *row, 1.0, 1.0))
            self._rows["MAG"].extend((stamp, number, m.xmag, m.ymag, m.zmag, *NOT_SENT))
        elif kind == "ATTITUDE":
            self._rows["ATT"].extend((self._by_own_clock(m), math.degrees(m.yaw)))
        elif kind == "PARAM_VALUE":
            self._parameters.append((m._timestamp, m.param_id, float(m.param_value)))
        else:
            place = (1e-7 * m.lat, 1e-7 * m.lon, 1e-3 * m.alt)
            motion = 0.01 * m.vel, 0.01 * m.cog
            self._rows["GPS"].extend((m._timestamp, 0.0, m.fix_type, *place, *motion))

    def _by_own_clock(self, m: Any) -> float:
        """Return a message's stamp by the autopilot's clock, shifted to the receiver's."""
        micros = getattr(m, "time_usec", None)
        own = 1e-3 * m.time_boot_ms if micros is None else 1e-6 * micros
        booted = m._timestamp - own
        if not (own > self._own - BACKWARDS and abs(booted - self._booted) < LATE):
            self._booted = booted
        self._own = own
        return float(own + self._booted)

    def logged(self) -> DataFlash:
        """Return the collected messages."""
        tables = tables_of(self._rows)
        for kind in {"IMU", "MAG"} & tables.keys():
            table = tables[kind]
            repeated = table[:, 1] == REPEATED
            if (table[:, 1] == 0.0).any():
                tables[kind] = table[~repeated]
            else:
                table[repeated, 1] = 0.0
        return DataFlash(tables, self._parameters)


def _sort_sensors(
    tables: logs.LogTables, parameters: Parameters, chosen: tuple[int, int] | None
) -> None:
    """Put the sensors in order by what the autopilot has `chosen`: lane of the EKF and compass."""
    # Without messages on the EKF's choice, use the parameters; COMPASS_PRIMARY exists up to 4.0.
    primary = parameters.get("EK3_PRIMARY"), parameters.get("COMPASS_PRIMARY")
    lane, compass = chosen or (None if each is None else int(each) for each in primary)
    # Lanes of the EKF are numbered over the IMUs in EK3_IMU_MASK.
    of_lanes = [k for k in range(len(SLOTS)) if int(parameters.get("EK3_IMU_MASK", 3.0)) >> k & 1]
    used = of_lanes[lane] if lane is not None and 0 <= lane < len(of_lanes) else None
    _sort(tables.imus, parameters, "INS_USE", used)
    _sort(tables.fields, parameters, "COMPASS_USE", compass)


def _compass(number: int, logged: FloatArray, parameters: History) -> logs.Sensor:
    """Return a compass with its raw field; samples with an earlier orientation are left out."""
    table = logged[logged[:, 11] != 0.0][:, [0, *range(2, 11)]]
    unhealthy = len(logged) - len(table)
    if not len(table):
        return logs.Sensor(table, unhealthy)
    newest, notes = parameters[-1][1], list[str]()
    slot = _slot(number, table[-1, 4:7], newest)
    orientation = f"COMPASS_ORIENT{SLOTS[slot]}"
    parts = np.searchsorted([since for since, _ in parameters], table[:, 0], "right")
    raw, is_turned = np.empty((len(table), 3)), np.zeros(len(table), dtype=bool)
    for part in np.unique(parts):
        rows, held = parts == part, parameters[part - 1][1]
        raw[rows] = _without_calibration(table[rows], slot, held)
        is_turned[rows] = held.get(orientation) != newest.get(orientation)
    raw *= logs.FLU_FROM_FRD * TESLA
    if is_turned.any():
        notes.append(
            f"{orientation} was changed during the log: the field is used only from then on"
        )
    motors = np.linalg.norm(np.nan_to_num(table[:, 7:10]), axis=1).max()
    if motors > 0.0:
        notes.append(
            "the field includes the compensation of the motors (COMPASS_MOT, up to "
            f"{1e6 * TESLA * motors:.1f} µT): do not change it, the result depends on it"
        )
    rows = np.column_stack([table[:, 0], raw])[~is_turned]
    return logs.Sensor(rows, unhealthy, f"ardupilot_compass{SLOTS[slot]}", notes)


def _sort(sensors: logs.Sensors, parameters: Parameters, switch: str, used: int | None) -> None:
    """Put sensors in order: enabled ones first, the used one first of them, then by health."""
    lengths = {number: len(each.rows) for number, each in sensors.found.items() if len(each.rows)}
    longest = max(lengths.values(), default=0)

    def rank(number: int) -> tuple[bool, bool, bool, int]:
        is_off = parameters.get(f"{switch}{SLOTS[min(number, len(SLOTS) - 1)]}") == 0.0
        return is_off, number != used, lengths[number] < 0.5 * longest, number

    sensors.order = sorted(lengths, key=rank)
    if sensors.order and sensors.order[0] == used:
        sensors.reason = "which the autopilot used"
    elif any(name.startswith(switch) for name in parameters):
        sensors.reason = f"the first by {switch} and health"


def _slot(number: int, offsets: FloatArray, parameters: Parameters) -> int:
    """Return which compass of the parameters a sensor is: the one with the logged offsets."""
    # Priorities may give the sensors of a log another order than that of the parameters.
    gaps = [np.abs(_three(parameters, f"COMPASS_OFS{slot}_") - offsets).max() for slot in SLOTS]
    known = np.nan_to_num(gaps, nan=math.inf)
    usual = min(number, len(SLOTS) - 1)
    best = min(range(len(SLOTS)), key=lambda slot: (known[slot], slot != usual))
    return best if known[best] <= 1.0 else usual  # logged offsets are whole milligauss


def _without_calibration(table: FloatArray, slot: int, parameters: Parameters) -> FloatArray:
    """Return the field without the autopilot's calibration, milligauss."""
    name = SLOTS[slot]
    off_diagonal = np.nan_to_num(_three(parameters, f"COMPASS_ODI{name}_"))
    matrix = logs.symmetric(_three(parameters, f"COMPASS_DIA{name}_"), off_diagonal)
    if not np.isfinite(matrix).all() or not matrix.diagonal().any():
        matrix = np.eye(3)
    scale = parameters.get(f"COMPASS_SCALE{name}", 1.0)
    if not SMALLEST_SCALE <= scale <= LARGEST_SCALE:
        scale = 1.0
    # The logged offsets are truncated to integers, the parameters are not.
    exact, offsets = _three(parameters, f"COMPASS_OFS{name}_"), table[:, 4:7]
    is_same = np.isnan(offsets) | (np.abs(exact - offsets) < 1.0)
    offsets = np.nan_to_num(np.where(is_same, exact, offsets))
    uncut = table[:, 1:4] + 0.5 * np.sign(table[:, 1:4])
    return np.linalg.solve(matrix * scale, uncut.T).T - offsets


def _three(parameters: Parameters, prefix: str) -> FloatArray:
    return np.array([parameters.get(prefix + axis, math.nan) for axis in "XYZ"])
