"""ArduPilot's DataFlash logs (.BIN, .log) as tables of the wanted messages, read by pymavlink.

A binary log is decoded one message type at a time, at the offsets in the library's index. This is
fifteen times as fast as message by message, which is used for text, and for binary logs of old
releases whose messages have no clock in microseconds or milliseconds.
"""

from __future__ import annotations

from array import array
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.files import logs

BINARY = b"\xa3\x95"
"""The first bytes of a binary log and of each of its messages; the third byte is the type."""

HEADER = 3

IMU = ("I", "AccX", "AccY", "AccZ", "GyrX", "GyrY", "GyrZ", "GH", "AH")
MAG = ("I", "MagX", "MagY", "MagZ", "OfsX", "OfsY", "OfsZ", "MOX", "MOY", "MOZ", "Health")
COLUMNS = {
    **dict.fromkeys(("IMU", "IMU2", "IMU3"), IMU),
    **dict.fromkeys(("MAG", "MAG2", "MAG3"), MAG),
    "GPS": ("I", "Status", "Lat", "Lng", "Alt", "Spd", "GCrs"),
    "ATT": ("Yaw",),
    "XKFS": ("C", "MI"),
    "XKF4": ("PI",),
}
"""The columns to read of each message. XKFS and XKF4 give the compass and the lane of EKF3."""

GPS_MESSAGES = ("GPS", "GPS2")


class DataFlash(NamedTuple):
    """The contents of a log; the numbers are as logged."""

    tables: dict[str, FloatArray]
    """By message type: the stamp and `COLUMNS`, NaN for columns that a release does not log."""
    parameters: list[tuple[float, str, float]]  # stamp, name, value


def flat_arrays() -> dict[str, array[float]]:
    """Return empty arrays for rows, by message type: a tenth of the memory of tuples."""
    return defaultdict(lambda: array("d"))


def tables_of(rows: Mapping[str, array[float]]) -> dict[str, FloatArray]:
    """Return the tables of rows that were appended to flat arrays."""
    return {k: np.array(flat).reshape(-1, 1 + len(COLUMNS[k])) for k, flat in rows.items()}


def read_dataflash(path: Path, head: bytes, deadline: logs.Deadline) -> DataFlash:
    """Read a log; `head` are its first bytes."""
    library = logs.library(path, "pymavlink.DFReader", "ardupilot")
    is_binary = head[:2] == BINARY
    kind: Any = library.DFReader_binary if is_binary else library.DFReader_text

    def recv_msg(reader: Any) -> Any:
        # Without a receiver, the library reads the whole log before it returns a message.
        deadline.check()
        return kind.recv_msg(reader)

    def init_clock(reader: Any) -> None:
        no_receiver = is_binary and not _count(reader, *GPS_MESSAGES)
        if no_receiver and _count(reader, "IMU") and "TimeUS" in _format(reader, "IMU").columns:
            reader.init_clock_usec()
        else:
            kind.init_clock(reader)

    timed: Any = type("TimedReader", (kind,), {"recv_msg": recv_msg, "init_clock": init_clock})
    # The library's index is compiled code, which prints a line for each damaged byte.
    with logs.without_native_errors():
        opened = timed(str(path))
    with opened as reader:
        clocks = (library.DFReaderClock_usec, library.DFReaderClock_msec)
        if is_binary and isinstance(reader.clock, clocks):
            return _by_type(reader, library.FORMAT_TO_STRUCT, deadline)
        return _by_message(reader, deadline)


def _count(reader: Any, *kinds: str) -> int:
    return sum(reader.counts[reader.name_to_id[k]] for k in kinds if k in reader.name_to_id)


def _format(reader: Any, kind: str) -> Any:
    return reader.formats[reader.name_to_id[kind]]


def _by_type(reader: Any, codes: Any, deadline: logs.Deadline) -> DataFlash:
    tables, parameters = dict[str, FloatArray](), list[tuple[float, str, float]]()
    for count, kind in enumerate(COLUMNS):
        deadline.report(count / len(COLUMNS))
        if not _count(reader, kind):
            continue
        rows, stamps = _rows(reader, kind, codes)
        form = _format(reader, kind)
        scales = dict(zip(form.columns, form.msg_mults, strict=False))
        absent = np.full(len(rows), np.nan)
        columns = [
            rows[name] * (scales[name] or 1) if name in scales else absent for name in COLUMNS[kind]
        ]
        tables[kind] = np.column_stack([stamps, *columns]).astype(np.float64)
    if _count(reader, "PARM"):
        rows, stamps = _rows(reader, "PARM", codes)
        names = (each.decode(errors="replace") for each in rows["Name"].tolist())
        parameters = list(zip(stamps.tolist(), names, rows["Value"].tolist(), strict=True))
    return DataFlash(tables, parameters)


def _rows(reader: Any, kind: str, codes: Any) -> tuple[Any, FloatArray]:
    """Return all messages of a type as a structured array, and their stamps."""
    number = reader.name_to_id[kind]
    form = reader.formats[number]
    letters = (codes[letter][0] for letter in form.msg_fmts)
    numpys = (f"S{each[:-1]}" if each.endswith("s") else f"<{each}" for each in letters)
    row = np.dtype(list(zip(form.columns, numpys, strict=False)))
    starts = np.asarray(reader.offsets[number], dtype=np.int64) + HEADER
    size = reader.data_len - row.itemsize
    starts = starts[starts <= size]
    # A view with a row at every byte, of which the rows at the messages' offsets are taken.
    rows = np.ndarray((size + 1,), row, buffer=reader.data_map, strides=(1,))[starts]
    own = "TimeUS" if "TimeUS" in form.columns else "T" if kind in GPS_MESSAGES else "TimeMS"
    unit = 1e-6 if own == "TimeUS" else 1e-3
    return rows, reader.clock.timebase + unit * rows[own]


def _by_message(reader: Any, deadline: logs.Deadline) -> DataFlash:
    flat, parameters = flat_arrays(), list[tuple[float, str, float]]()
    wanted, count = [*COLUMNS, "PARM"], 0
    while (message := reader.recv_match(type=wanted, strict=True)) is not None:
        if count % logs.EVERY == 0:
            deadline.report(0.01 * reader.percent)
        count += 1
        kind, stamp = message.get_type(), message._timestamp
        if kind == "PARM":
            parameters.append((stamp, message.Name, float(message.Value)))
        else:
            row = (float(getattr(message, name, np.nan)) for name in COLUMNS[kind])
            flat[kind].extend((stamp, *row))
    return DataFlash(tables_of(flat), parameters)
