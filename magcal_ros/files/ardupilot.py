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
from array import array
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from magcal_ros.core.earth_field.reference import Fix
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import STANDARD_GRAVITY
from magcal_ros.files import logs
from magcal_ros.files.dataflash import BINARY, DataFlash, read_dataflash
from magcal_ros.files.disk import FileError, printable
from magcal_ros.files.recording import Recording

SUFFIXES = (".bin", ".log", ".tlog")

TESLA = 1e-7  # in a milligauss

NAMES = logs.SensorNames(
    logs.SensorName("IMU", "let LOG_BITMASK log IMU, and record again", "GH or AH is 0"),
    logs.SensorName(
        "MAG",
        "check COMPASS_ENABLE and the wiring, let LOG_BITMASK log COMPASS, and record again",
        "Health is 0",
    ),
)
TELEMETRY_NAMES = logs.SensorNames(
    logs.SensorName(
        "IMU",
        "ask for RAW_IMU at 10 Hz or more (SR0_RAW_SENS), or take the log from the autopilot's "
        "card",
    ),
    logs.SensorName("MAG", "check COMPASS_ENABLE and the wiring, and record again"),
)
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

SENSORS = 3
Parameters = dict[str, float]


def read_ardupilot(
    path: Path, imu: str = "", mag: str = "", progress: logs.Progress | None = None
) -> Recording:
    """Read a DataFlash or telemetry log; arguments and errors are those of `open_recording`."""
    begun = logs.first_bytes(path, 8000)
    telemetry = path.suffix.lower() == ".tlog"
    is_text = path.suffix.lower() == ".log" and b"FMT," in begun
    if not (telemetry or is_text or begun[:2] == BINARY):
        raise FileError(
            f"{printable(str(path))} is not a DataFlash log: its first bytes are not those of one"
        )
    deadline = logs.Deadline(path, progress)
    with logs.without_output(path, deadline):
        if telemetry:
            logged = _telemetry(path, deadline)
        else:
            logged = _logged(read_dataflash(path, begun, deadline))
        tables = _raw_tables(logged, telemetry)
        deadline.report(1.0)
    return logs.recording_of(path, tables, TELEMETRY_NAMES if telemetry else NAMES, imu, mag)


@dataclass
class _Logged:
    """The contents of a log by sensor, as logged, in forward-right-down axes."""

    imus: dict[int, FloatArray] = field(default_factory=dict)  # stamp, specific force, rate
    mags: dict[int, FloatArray] = field(default_factory=dict)
    """Stamp (s), field, offsets and motors' part (milligauss); NaN for columns not logged."""
    parameters: list[tuple[float, Parameters]] = field(default_factory=lambda: [(-math.inf, {})])
    """All parameters, with the time from which they are valid: the autopilot may change them."""
    lane: tuple[int, int] | None = None
    """Lane of the EKF that was used most of the time, and the compass of this lane."""
    tables: logs.LogTables = field(default_factory=logs.LogTables)

    def take_parameter(self, stamp: float, name: str, value: float) -> None:
        """Add a parameter; its first value is also valid before it was logged."""
        if not name.startswith(PARAMETERS):
            return
        newest = self.parameters[-1][1]
        if name not in newest:
            for _, each in self.parameters:
                each[name] = value
        elif newest[name] != value:
            self.parameters.append((stamp, {**newest, name: value}))

    def take_fix(self, fix: Fix, speed: float, course: float) -> None:
        """Add a receiver's fix, with speed (m/s) and course (rad)."""
        self.tables.fixes.append(fix)
        if fix.has_fix and math.isfinite(speed + course):
            self.tables.velocities.append(logs.velocity(fix.stamp, speed, course))


def _logged(found: DataFlash) -> _Logged:
    out = _Logged()
    for stamp, name, value in found.parameters:
        out.take_parameter(stamp, name, value)
    for number, part in _instances(found, "IMU"):
        healthy = (part[:, 8] != 0.0) & (part[:, 9] != 0.0)
        out.imus[number] = part[healthy][:, [0, *range(2, 8)]]
        out.tables.unhealthy_imus[number] = int((~healthy).sum())
    for number, part in _instances(found, "MAG"):
        healthy = part[:, 11] != 0.0
        out.mags[number] = part[healthy][:, [0, *range(2, 11)]]
        out.tables.unhealthy_fields[number] = int((~healthy).sum())
    if "ATT" in found.tables:
        stamps, bearing = found.tables["ATT"].T
        out.tables.yaw = np.column_stack([stamps, np.radians(90.0 - bearing)])
    receivers = found.tables.get("GPS", np.empty(0)).tolist()
    for stamp, number, status, latitude, longitude, altitude, speed, course in receivers:
        if not number > 0.0:  # the first receiver, which old releases do not number
            fix = Fix(status >= logs.FIX_3D, latitude, longitude, altitude, stamp)
            out.take_fix(fix, speed, math.radians(course))
    if "XKFS" in found.tables and "XKF4" in found.tables:
        lane = logs.most_common(found.tables["XKF4"][:, 1])
        selected = found.tables["XKFS"]
        out.lane = lane, logs.most_common(selected[selected[:, 1] == lane, 2])
    return out


def _instances(found: DataFlash, kind: str) -> Iterable[tuple[int, FloatArray]]:
    """Yield a sensor's number and its rows; old releases number them by the message's name."""
    for usual, name in enumerate((kind, f"{kind}2", f"{kind}3")):
        table = found.tables.get(name)
        if table is not None:
            numbers = np.where(np.isnan(table[:, 1]), usual, table[:, 1])
            for number in np.unique(numbers):
                yield int(number), table[numbers == number]


def _telemetry(path: Path, deadline: logs.Deadline) -> _Logged:
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
        raise FileError(
            f"{printable(str(path))} is not a telemetry log: no MAVLink message is in it"
        )
    return read.logged()


class _Telemetry:
    """Collects telemetry messages, added one by one."""

    def __init__(self) -> None:
        # Flat arrays take a tenth of the memory of rows.
        self._imus: dict[int, array[float]] = defaultdict(_numbers)
        self._mags: dict[int, array[float]] = defaultdict(_numbers)
        self._yaw = _numbers()
        self._out = _Logged()
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
            stamp = self._by_own_clock(m)
            force = (value * STANDARD_GRAVITY for value in (m.xacc, m.yacc, m.zacc))
            row = [1e-3 * value for value in (*force, m.xgyro, m.ygyro, m.zgyro)]
            self._imus[RAW_KINDS[kind]].extend((stamp, *row))
            self._mags[RAW_KINDS[kind]].extend((stamp, m.xmag, m.ymag, m.zmag))
        elif kind == "ATTITUDE":
            self._yaw.extend((self._by_own_clock(m), 0.5 * math.pi - m.yaw))
        elif kind == "PARAM_VALUE":
            self._out.take_parameter(m._timestamp, m.param_id, float(m.param_value))
        else:
            place = (1e-7 * m.lat, 1e-7 * m.lon, 1e-3 * m.alt)
            fix = Fix(m.fix_type >= logs.FIX_3D, *place, m._timestamp)
            self._out.take_fix(fix, 0.01 * m.vel, math.radians(0.01 * m.cog))

    def _by_own_clock(self, m: Any) -> float:
        """Return a message's stamp by the autopilot's clock, shifted to the receiver's."""
        micros = getattr(m, "time_usec", None)
        own = 1e-3 * m.time_boot_ms if micros is None else 1e-6 * micros
        booted = m._timestamp - own
        if not (own > self._own - BACKWARDS and abs(booted - self._booted) < LATE):
            self._booted = booted
        self._own = own
        return float(own + self._booted)

    def logged(self) -> _Logged:
        """Return the collected messages."""
        out = self._out
        for sensors in (self._imus, self._mags):
            repeated = sensors.pop(REPEATED, _numbers())
            if repeated:
                sensors.setdefault(0, repeated)
        out.tables.yaw = np.array(self._yaw).reshape(-1, 2)
        out.imus = {k: np.array(rows).reshape(-1, 7) for k, rows in self._imus.items()}
        for number, rows in self._mags.items():
            table = np.array(rows).reshape(-1, 4)
            out.mags[number] = np.pad(table, ((0, 0), (0, 6)), constant_values=math.nan)
        return out


def _numbers() -> array[float]:
    return array("d")


def _raw_tables(logged: _Logged, telemetry: bool) -> logs.LogTables:
    """Return the log in SI units and forward-left-up axes, without the autopilot's calibration."""
    tables, newest = logged.tables, logged.parameters[-1][1]
    for number, table in logged.imus.items():
        if len(table):
            table[:, 1:] *= np.tile(logs.FLU_FROM_FRD, 2)
            tables.imus[number] = table
    for number, table in logged.mags.items():
        if len(table):
            _take_field(tables, number, table, logged.parameters)
    # Without messages on the EKF's choice, use the parameters; COMPASS_PRIMARY exists up to 4.0.
    primary = newest.get("EK3_PRIMARY"), newest.get("COMPASS_PRIMARY")
    lane, compass = logged.lane or (None if each is None else int(each) for each in primary)
    # Lanes of the EKF are numbered over the IMUs in EK3_IMU_MASK.
    of_lanes = [k for k in range(SENSORS) if int(newest.get("EK3_IMU_MASK", 3.0)) >> k & 1]
    used = of_lanes[lane] if lane is not None and 0 <= lane < len(of_lanes) else None
    tables.imu_order = _order(tables.imus, newest, "INS_USE", used)
    tables.field_order = _order(tables.fields, newest, "COMPASS_USE", compass)
    if telemetry and "COMPASS_OFS_X" not in newest:
        tables.notes.append(
            "the log does not hold the parameters COMPASS_OFS: the field is taken as if they "
            "were 0. Offsets that are found must be added to those in force"
        )
    return tables


def _take_field(
    tables: logs.LogTables,
    number: int,
    table: FloatArray,
    parameters: list[tuple[float, Parameters]],
) -> None:
    """Add the raw field of a compass; samples with an earlier orientation are left out."""
    newest = parameters[-1][1]
    slot = _slot(number, table[-1, 4:7], newest)
    orientation = f"COMPASS_ORIENT{SLOTS[slot]}"
    parts = np.searchsorted([since for since, _ in parameters], table[:, 0], "right")
    raw, is_turned = np.empty((len(table), 3)), np.zeros(len(table), dtype=bool)
    for part in np.unique(parts):
        rows, held = parts == part, parameters[part - 1][1]
        raw[rows] = _without_calibration(table[rows], slot, held)
        is_turned[rows] = held.get(orientation) != newest.get(orientation)
    raw *= logs.FLU_FROM_FRD * TESLA
    tables.fields[number] = np.column_stack([table[:, 0], raw])[~is_turned]
    tables.frames[number] = f"ardupilot_compass{SLOTS[slot]}"
    notes = tables.field_notes.setdefault(number, [])
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


def _order(
    sensors: Mapping[int, FloatArray], parameters: Parameters, switch: str, used: int | None
) -> logs.Order:
    """Return the order: enabled sensors first, the used one first of them, then by health."""
    longest = max((len(each) for each in sensors.values()), default=0)

    def rank(number: int) -> tuple[bool, bool, bool, int]:
        is_off = parameters.get(f"{switch}{SLOTS[min(number, SENSORS - 1)]}") == 0.0
        return is_off, number != used, len(sensors[number]) < 0.5 * longest, number

    numbers = tuple(sorted(sensors, key=rank))
    if numbers and numbers[0] == used:
        return logs.Order(numbers, "which the autopilot used")
    is_said = any(name.startswith(switch) for name in parameters)
    return logs.Order(numbers, f"the first by {switch} and health" if is_said else "")


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
