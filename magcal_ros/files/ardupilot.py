"""ArduPilot's logs: DataFlash (.BIN, .log) and telemetry (.tlog), read by pymavlink.

MAG holds the corrected field, `D (raw + OFS) SCALE + motor part` in milligauss, body axes
forward-right-down (AP_Compass_Backend::correct_field); the offsets stand beside it, D and SCALE
are parameters. What the calibration in force added is taken off; the compensation of the motors
stays, as it goes on in flight. RAW_IMU and SCALED_IMU of telemetry hold the same field.
"""

from __future__ import annotations

import math
from array import array
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from magcal_ros.core.earth_field.reference import Fix
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.files import logs
from magcal_ros.files.disk import FileTrouble, plain
from magcal_ros.files.recording import Recording

SUFFIXES = (".bin", ".log", ".tlog")
BINARY = b"\xa3\x95"
"""The first bytes of a binary log."""

TESLA = 1e-7
"""In a milligauss."""

NAMES = logs.Names(
    "IMU",
    "MAG",
    "let LOG_BITMASK log IMU, and record again",
    "look at COMPASS_ENABLE and the wiring, let LOG_BITMASK log COMPASS, and record again",
)
TELEMETRY_NAMES = logs.Names(
    "IMU",
    "MAG",
    "ask for RAW_IMU at 10 Hz or more (SR0_RAW_SENS), or take the log from the autopilot's card",
    "look at COMPASS_ENABLE and the wiring, and record again",
)
KINDS = {"IMU": 0, "IMU2": 1, "IMU3": 2, "MAG": 0, "MAG2": 1, "MAG3": 2}
"""Messages of the sensors, and their number in releases that name it so."""

RAW_KINDS = {"RAW_IMU": 0, "SCALED_IMU": 0, "SCALED_IMU2": 1, "SCALED_IMU3": 2}
AUTOPILOT = 1
"""Component of MAVLink: cameras and gimbals have others."""

SLOTS = ("", "2", "3")
"""How the parameters of the compasses are numbered."""

NO_OFFSETS = (math.nan, math.nan, math.nan)

BACKWARDS, LATE = 1.0, 10.0
"""Seconds by which an autopilot's clock goes back, or a message is late, where it started anew."""


def read_ardupilot(
    path: Path, imu: str = "", mag: str = "", progress: logs.Progress | None = None
) -> Recording:
    """Read a DataFlash or telemetry log; arguments and errors as of `open_recording`."""
    begun = logs.begun_with(path, 8000)
    telemetry = path.suffix.lower() == ".tlog"
    is_text = path.suffix.lower() == ".log" and b"FMT," in begun
    if not (telemetry or is_text or begun[:2] == BINARY):
        raise FileTrouble(f"{plain(str(path))} is no DataFlash log: it does not begin as one")
    deadline = logs.Deadline(path, progress)
    with logs.quietly(path, deadline):
        messages = _telemetry(path) if telemetry else _dataflash(path, begun, deadline)
        read = _Rows(telemetry)
        for count, (message, share) in enumerate(messages):
            if count % logs.EVERY == 0:
                deadline.report(share)
            if message is not None:
                read.take(message.get_type(), message)
        tables = read.tables()
    return logs.recording_of(path, tables, TELEMETRY_NAMES if telemetry else NAMES, imu, mag)


def _dataflash(path: Path, begun: bytes, deadline: logs.Deadline) -> Iterator[tuple[Any, float]]:
    """Yield the wanted messages of a log and the share that has been read."""
    dataflash = logs.library(path, "pymavlink.DFReader", "ardupilot")
    kind: Any = dataflash.DFReader_binary if begun[:2] == BINARY else dataflash.DFReader_text

    def recv_msg(reader: Any) -> Any:
        # Without a receiver the library goes through the whole log before it gives a message.
        deadline.check()
        return kind.recv_msg(reader)

    timed: Any = type("TimedReader", (kind,), {"recv_msg": recv_msg})
    wanted = [*KINDS, "GPS", "ATT", "PARM"]
    with timed(str(path)) as reader:
        while (message := reader.recv_match(type=wanted, strict=True)) is not None:
            yield message, 0.01 * reader.percent


def _telemetry(path: Path) -> Iterator[tuple[Any, float]]:
    """Yield the same of telemetry, and None for any other message and for damage."""
    reader = logs.library(path, "pymavlink.mavutil", "ardupilot").mavlogfile(str(path))
    wanted = {*RAW_KINDS, "ATTITUDE", "GPS_RAW_INT", "PARAM_VALUE"}
    try:
        while (message := reader.recv_msg()) is not None:
            is_wanted = message.get_type() in wanted
            yield message if is_wanted else None, 0.01 * reader.percent
    finally:
        reader.close()


class _Rows:
    """Takes messages one by one; the numbers are as logged, forward-right-down."""

    def __init__(self, telemetry: bool) -> None:
        self.take = self._take_telemetry if telemetry else self._take_logged
        """Takes a message of any wanted kind."""
        self._telemetry = telemetry
        # Flat arrays take a tenth of the memory of rows.
        self._imus: dict[int, array[float]] = defaultdict(_numbers)
        self._mags: dict[int, array[float]] = defaultdict(_numbers)
        self._yaw = _numbers()
        self._parameters = [(-math.inf, dict[str, float]())]
        """From when on they hold; a log may span a calibration by the autopilot."""
        self._tables = logs.LogTables()
        self._system: int | None = None
        self._booted = self._own = math.nan

    def _take_logged(self, kind: str, m: Any) -> None:
        stamp = m._timestamp
        if kind.startswith("IMU"):
            row = [m.AccX, m.AccY, m.AccZ, m.GyrX, m.GyrY, m.GyrZ]
            self._imus[getattr(m, "I", KINDS[kind])].extend((stamp, *row))
        elif kind.startswith("MAG"):
            if getattr(m, "Health", 1):
                row = [m.MagX, m.MagY, m.MagZ, m.OfsX, m.OfsY, m.OfsZ]
                self._mags[getattr(m, "I", KINDS[kind])].extend((stamp, *row))
        elif kind == "ATT":
            self._yaw.extend((stamp, math.radians(90.0 - m.Yaw)))
        elif kind == "PARM":
            self._take_parameter(stamp, m.Name, float(m.Value))
        elif not getattr(m, "I", 0):
            has_fix = m.Status >= logs.FIX_3D
            self._fix(stamp, has_fix, (m.Lat, m.Lng, m.Alt), m.Spd, math.radians(m.GCrs))

    def _take_telemetry(self, kind: str, m: Any) -> None:
        if m.get_srcComponent() != AUTOPILOT:
            return
        if self._system is None:
            self._system = m.get_srcSystem()
        if m.get_srcSystem() != self._system:
            return
        if kind in RAW_KINDS:
            stamp = self._by_own_clock(m)
            force = (value * logs.GRAVITY for value in (m.xacc, m.yacc, m.zacc))
            row = [1e-3 * value for value in (*force, m.xgyro, m.ygyro, m.zgyro)]
            self._imus[RAW_KINDS[kind]].extend((stamp, *row))
            self._mags[RAW_KINDS[kind]].extend((stamp, m.xmag, m.ymag, m.zmag, *NO_OFFSETS))
        elif kind == "ATTITUDE":
            self._yaw.extend((self._by_own_clock(m), 0.5 * math.pi - m.yaw))
        elif kind == "PARAM_VALUE":
            self._take_parameter(m._timestamp, m.param_id, float(m.param_value))
        else:
            place = (1e-7 * m.lat, 1e-7 * m.lon, 1e-3 * m.alt)
            course = math.radians(0.01 * m.cog)
            self._fix(m._timestamp, m.fix_type >= logs.FIX_3D, place, 0.01 * m.vel, course)

    def _take_parameter(self, stamp: float, name: str, value: float) -> None:
        """Take a parameter; the first value also holds before it was logged."""
        if not name.startswith("COMPASS_"):
            return
        newest = self._parameters[-1][1]
        if name not in newest:
            for _, each in self._parameters:
                each[name] = value
        elif newest[name] != value:
            self._parameters.append((stamp, {**newest, name: value}))

    def _by_own_clock(self, m: Any) -> float:
        """Return a message's stamp by the autopilot's clock, shifted to the receiver's.

        That clock starts anew with the autopilot.
        """
        micros = getattr(m, "time_usec", None)
        own = 1e-3 * m.time_boot_ms if micros is None else 1e-6 * micros
        booted = m._timestamp - own
        if not (own > self._own - BACKWARDS and abs(booted - self._booted) < LATE):
            self._booted = booted
        self._own = own
        return float(own + self._booted)

    def _fix(
        self,
        stamp: float,
        has_fix: bool,
        place: tuple[float, float, float],
        speed: float,
        course: float,
    ) -> None:
        self._tables.fixes.append(Fix(has_fix, *place, stamp))
        if has_fix and math.isfinite(speed + course):
            self._tables.velocities.append(logs.velocity(stamp, speed, course))

    def tables(self) -> logs.LogTables:
        """Return everything in SI units, forward-left-up axes, calibrations taken off."""
        tables = self._tables
        tables.yaw = np.array(self._yaw).reshape(-1, 2)
        for number, rows in self._imus.items():
            table = np.array(rows).reshape(-1, 7)
            table[:, 1:4] *= logs.FLU_FROM_FRD
            table[:, 4:7] *= logs.FLU_FROM_FRD
            tables.imus[number] = table
        for number, rows in self._mags.items():
            table = np.array(rows).reshape(-1, 7)
            slot = _slot(number, table[-1, 4:7], self._parameters[-1][1])
            parts = np.searchsorted([since for since, _ in self._parameters], table[:, 0], "right")
            raw = np.empty((len(table), 3))
            for part in np.unique(parts):
                rows = parts == part
                held = self._parameters[part - 1][1]
                raw[rows] = _without_calibration(table[rows], slot, held)
            raw *= logs.FLU_FROM_FRD * TESLA
            tables.fields[number] = np.column_stack([table[:, 0], raw])
            tables.frames[number] = f"ardupilot_compass{SLOTS[slot]}"
        if self._telemetry and "COMPASS_OFS_X" not in self._parameters[-1][1]:
            tables.notes.append(
                "the log does not hold the parameters COMPASS_OFS: the field is taken as if they "
                "were 0. Offsets that are found must be added to those in force"
            )
        return tables


def _numbers() -> array[float]:
    return array("d")


def _slot(number: int, offsets: FloatArray, parameters: Mapping[str, float]) -> int:
    """Return which of the parameters' compasses a sensor is: the one with its offsets.

    Priorities may put the sensors of a log into another order than the parameters.
    """
    gaps = [
        float(np.abs(_three(parameters, f"COMPASS_OFS{slot}_", "XYZ") - offsets).max())
        for slot in SLOTS
    ]
    known = [gap if math.isfinite(gap) else math.inf for gap in gaps]
    usual = min(number, len(SLOTS) - 1)
    best = min(range(len(SLOTS)), key=lambda slot: (known[slot], slot != usual))
    return best if known[best] <= 1.0 else usual  # logged offsets are whole milligauss


def _without_calibration(
    table: FloatArray, slot: int, parameters: Mapping[str, float]
) -> FloatArray:
    """Return the field before the autopilot's own calibration, milligauss."""
    name = SLOTS[slot]
    x, y, z = _three(parameters, f"COMPASS_DIA{name}_", "XYZ")
    xy, xz, yz = np.nan_to_num(_three(parameters, f"COMPASS_ODI{name}_", "XYZ"))
    matrix = np.array([[x, xy, xz], [xy, y, yz], [xz, yz, z]])
    if not np.isfinite(matrix).all() or not matrix.diagonal().any():
        matrix = np.eye(3)
    scale = parameters.get(f"COMPASS_SCALE{name}", 0.0) or 1.0
    offsets = table[:, 4:7]
    if np.isnan(offsets).all():
        offsets = np.nan_to_num(_three(parameters, f"COMPASS_OFS{name}_", "XYZ"))
    return np.linalg.solve(matrix * scale, table[:, 1:4].T).T - offsets


def _three(parameters: Mapping[str, float], prefix: str, axes: Iterable[str]) -> FloatArray:
    return np.array([parameters.get(prefix + axis, math.nan) for axis in axes])
