"""The calibration as YAML, with a header that distinguishes it from other files."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import yaml

from magcal_ros import __version__
from magcal_ros.core.calibration.calibration import Calibration, Evidence
from magcal_ros.core.calibration.correction import Correction, MotorField, MotorInput
from magcal_ros.core.heading.base_heading import VehicleYaw
from magcal_ros.files.default_paths import identifier
from magcal_ros.files.disk import (
    REMEDY,
    FileError,
    NotRegularFile,
    read_small,
    write_atomically,
)
from magcal_ros.files.plausibility import require_possible

FORMAT = "magcal_ros/calibration"
FORMAT_VERSION = 1
LARGEST_FILE = 100_000
"""Bytes. A calibration has about ten thousand."""

DEEPEST = 10  # levels of nesting; a calibration has three

_FORMAT_MARK = re.compile(
    rb"""^(format: *["']?magcal_ros/calibration\b|# Magnetometer calibration by magcal_ros\.)""",
    re.MULTILINE,
)

_INVALID_CONTENT = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError)
"""Errors of the YAML loader, and of reading its document, for invalid content."""

HEADER = """\
# Magnetometer calibration by magcal_ros.
# field_body = correction_matrix * (field_raw - hard_iron): tesla, body axes (x forward, y left,
# z up). magnetometer_bias_x/y/z repeat the hard iron for tools that look for it there.
"""


@dataclass(frozen=True)
class Origin:
    """Where and when a calibration was made."""

    magnetometer_frame: str
    imu_frame: str
    """`frame_id` of the two sensors' messages."""
    created: str  # ISO 8601, UTC
    node: str = ""  # fully qualified name of the node that made it; empty without a node
    vehicle_yaw: VehicleYaw | None = None
    """Yaw of the IMU in the vehicle, estimated by drives; no part of the calibration."""

    @classmethod
    def now(
        cls, field_frame: str, imu_frame: str, node: str = "", vehicle_yaw: VehicleYaw | None = None
    ) -> Origin:
        """Return the origin of a calibration made at this moment."""
        stamp = datetime.now(timezone.utc).isoformat(timespec="seconds")
        return cls(identifier(field_frame), identifier(imu_frame), stamp, node, vehicle_yaw)


class _PlainLoader(yaml.SafeLoader):
    """Safe YAML without aliases and deep nesting, which could exhaust the memory.

    An entry given twice is an error (YAML takes the last); one without a value is missing.
    """

    _depth = 0

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        names = [each.value for each, _ in node.value]
        if twice := [name for name in names if names.count(name) > 1]:
            raise yaml.YAMLError(f"{twice[0]!r} is given twice")
        return {k: v for k, v in super().construct_mapping(node, deep).items() if v is not None}

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("aliases do not belong in a calibration file")
        if self._depth >= DEEPEST:
            raise yaml.YAMLError("a calibration file is not nested so deeply")
        self._depth += 1
        try:
            return super().compose_node(parent, index)
        finally:
            self._depth -= 1


class _PlainDumper(yaml.SafeDumper):
    """Safe YAML that quotes texts with unprintable characters, which may else change in reading."""


_TEXT = "tag:yaml.org,2002:str"
_PlainDumper.add_representer(
    str, lambda to, text: to.represent_scalar(_TEXT, text, None if text.isprintable() else '"')
)


def write_calibration(
    path: Path,
    calibration: Calibration,
    origin: Origin,
    when_written: Callable[[], object] | None = None,
    remedy: str = REMEDY,
) -> None:
    """Write a calibration in one step, at full precision.

    FileError if the file cannot be written, or exists and is no calibration of this package; it
    is then unchanged. `when_written` and `remedy` are as in `write_atomically`.
    """
    require_ours(path)
    document = {k: v for k, v in _document(calibration, origin).items() if v is not None}
    style: dict[str, Any] = {"sort_keys": False, "allow_unicode": True, "default_flow_style": None}
    body = yaml.dump(document, Dumper=_PlainDumper, **style)
    write_atomically(path, HEADER + body, remedy, when_written)


def is_free_or_ours(path: Path) -> bool:
    """Whether the file is missing, empty, or marked as a calibration of this package."""
    try:
        content = read_small(path, LARGEST_FILE)
    except (FileNotFoundError, NotADirectoryError):
        return True
    except (OSError, NotRegularFile):
        return False
    return not content.strip() or _FORMAT_MARK.search(content) is not None


def require_ours(path: Path) -> None:
    """Raise a FileError unless `is_free_or_ours`."""
    if not is_free_or_ours(path):
        raise FileError(
            f"{path} is not a calibration of magcal_ros, and was not changed; choose another name"
        )


def require_not_ours(path: Path) -> None:
    """Raise a FileError if the file is a calibration of this package."""
    if path.exists() and is_free_or_ours(path) and read_small(path, LARGEST_FILE).strip():
        raise FileError(
            f"{path} is a calibration of magcal_ros, and was not changed; choose another name"
        )


def read_calibration(path: Path) -> tuple[Calibration, Origin]:
    """Return a calibration and its origin, with exactly the numbers that were written.

    FileError if the file is missing, damaged, of another format or version, or has impossible
    numbers.
    """
    document = _parse(path)
    try:
        calibration, origin = _calibration(document), _origin(document)
        require_possible(calibration)
    except _INVALID_CONTENT as error:
        detail = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else str(error)
        raise _damaged(path, detail) from error
    return calibration, origin


def _parse(path: Path) -> Mapping[str, Any]:
    try:
        content = read_small(path, LARGEST_FILE)
        # The mark is checked first: YAML takes a second for a large file of another kind.
        is_marked = _FORMAT_MARK.search(content) is not None
        text = content.decode("utf-8")
        document = yaml.load(text, Loader=_PlainLoader) if is_marked else None
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from error
    except NotRegularFile as error:
        raise _damaged(path, str(error)) from error
    except (yaml.YAMLError, RecursionError, *_INVALID_CONTENT) as error:
        reason = " ".join(str(error).split())[:200]
        raise _damaged(path, f"it is not readable YAML ({reason})") from error
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise _damaged(path, f"it does not say 'format: {FORMAT}'")
    version = document.get("format_version")
    if version != FORMAT_VERSION:
        raise _damaged(path, f"its format version is {version!r}, this package reads 1")
    return document


def _damaged(path: Path, detail: str) -> FileError:
    # A file of another program is never replaced.
    remedy = "Calibrate again to replace it, or name" if is_free_or_ours(path) else "Name"
    return FileError(f"{path} is not a usable calibration: {detail}. {remedy} another file.")


def _document(calibration: Calibration, origin: Origin) -> dict[str, Any]:
    hard_iron = [float(value) for value in calibration.correction.hard_iron]
    evidence, yaw = calibration.evidence, origin.vehicle_yaw
    return {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "written_by": f"magcal_ros {__version__}",
        "created": origin.created,
        "node": origin.node or None,
        "formula": "field_body = correction_matrix * (field_raw - hard_iron)",
        "units": {
            "hard_iron": "tesla",
            "correction_matrix": "1",
            "noise_up": "radian",
            "inclination": "radian",
        },
        "frames": {"field_raw": origin.magnetometer_frame, "field_body": origin.imu_frame},
        "vehicle_yaw_offset": None
        if yaw is None
        else {"yaw": float(yaw.offset), "sigma": float(yaw.sigma), "source": yaw.source},
        **{f"magnetometer_bias_{axis}": iron for axis, iron in zip("xyz", hard_iron, strict=True)},
        "hard_iron": hard_iron,
        "correction_matrix": calibration.correction.matrix.tolist(),
        "upward": calibration.upward.tolist(),
        "covariance": calibration.covariance.tolist(),
        "noise_field": float(calibration.noise_field),
        "noise_up": float(calibration.noise_up),
        "motors": _motors_entry(calibration.motors),
        "reference": {
            "strength": float(calibration.strength),
            "inclination": float(calibration.inclination),
        },
        "method": evidence.method,
        "evidence": {
            "quality": evidence.quality,
            "confidence": evidence.confidence,
            "summary": evidence.summary,
            "accepted_by_user": evidence.accepted_by_user,
            "reasons": list(evidence.reasons),
            "not_shown": list(evidence.not_shown),
            "figures": {name: float(value) for name, value in evidence.figures.items()},
        },
    }


def _vehicle_yaw(document: Mapping[str, Any]) -> VehicleYaw | None:
    """Return the IMU's yaw in the vehicle; None in files without this entry."""
    entry = document.get("vehicle_yaw_offset")
    if entry is None:
        return None
    offset = _finite(entry["yaw"], "vehicle_yaw_offset.yaw")
    sigma = _positive(entry["sigma"], "vehicle_yaw_offset.sigma")
    if abs(offset) > math.tau:
        raise ValueError("vehicle_yaw_offset.yaw must be in radians, within a turn")
    return VehicleYaw(offset, sigma, str(entry["source"]))


def _calibration(document: Mapping[str, Any]) -> Calibration:
    correction = Correction(
        _numbers(document["correction_matrix"]), _numbers(document["hard_iron"])
    )
    bias = [_number(document[f"magnetometer_bias_{axis}"]) for axis in "xyz"]
    if bias != list(correction.hard_iron):
        raise ValueError("magnetometer_bias_x/y/z and hard_iron contradict each other")
    reference = document["reference"]
    return Calibration(
        correction,
        _numbers(document["covariance"]),
        _positive(document["noise_field"], "noise_field"),
        _positive(document["noise_up"], "noise_up"),
        _positive(reference["strength"], "strength"),
        _finite(reference["inclination"], "inclination"),
        _evidence(document),
        _motors(document),
        _numbers(document.get("upward", [0.0, 0.0, 1.0])),
    )


def _motors_entry(motors: MotorField | None) -> dict[str, Any] | None:
    if motors is None:
        return None
    return {
        "formula": "field_raw - hard_iron - sum of field * input, in tesla while the robot moves",
        "inputs": [each.value for each in motors.inputs],
        "units": [each.unit for each in motors.inputs],
        "field": motors.gain.tolist(),
        "usual": [float(each) for each in motors.usual],
        "ripple": float(motors.ripple),
        "reference_current": None if math.isnan(motors.reference) else float(motors.reference),
        "covariance": motors.covariance.tolist(),
        "covariance_with_calibration": motors.cross_covariance.tolist(),
    }


def _motors(document: Mapping[str, Any]) -> MotorField | None:
    """Return the field of the motors; None in files without this entry."""
    entry = document.get("motors")
    if entry is None:
        return None
    reference = entry.get("reference_current")
    return MotorField(
        tuple(MotorInput(str(each)) for each in entry["inputs"]),
        _numbers(entry["field"]),
        _numbers(entry["covariance"]),
        _numbers(entry["covariance_with_calibration"]),
        _positive(entry["ripple"], "motors.ripple"),
        tuple(_positive(each, "motors.usual") for each in entry["usual"]),
        math.nan if reference is None else _finite(reference, "motors.reference_current"),
    )


def _evidence(document: Mapping[str, Any]) -> Evidence:
    stored = document["evidence"]
    quality, confidence, summary = (str(stored[k]) for k in ("quality", "confidence", "summary"))
    reasons, not_shown = (tuple(map(str, stored[k])) for k in ("reasons", "not_shown"))
    figures = {str(name): _number(value) for name, value in stored["figures"].items()}
    accepted, method = bool(stored["accepted_by_user"]), str(document["method"])
    return Evidence(method, quality, confidence, summary, reasons, not_shown, accepted, figures)


def _origin(document: Mapping[str, Any]) -> Origin:
    frames, node = document["frames"], str(document.get("node", ""))
    raw, body = str(frames["field_raw"]), str(frames["field_body"])
    return Origin(raw, body, str(document["created"]), node, _vehicle_yaw(document))


def _number(value: Any) -> float:
    # YAML 1.1 reads 1e-5 as text, and a file edited by hand may contain such numbers.
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise ValueError(f"{value!r} is not a number")
    return float(value)


def _numbers(values: Any) -> Any:
    if isinstance(values, list):
        return [_numbers(value) for value in values]
    return _number(values)


def _finite(value: Any, name: str) -> float:
    number = _number(value)
    if not math.isfinite(number):
        raise ValueError(f"{name} must be a finite number")
    return number


def _positive(value: Any, name: str) -> float:
    number = _finite(value, name)
    if number < 0.0:
        raise ValueError(f"{name} must be zero or more")
    return number


KEPT = 3  # number of backups


def backup_files(path: Path) -> list[Path]:
    """Return the paths of a file's backups, the newest first; they need not exist."""
    return [path.with_name(f"{path.stem}.before_{k}{path.suffix}") for k in range(1, KEPT + 1)]


def keep_backup(path: Path, successor: Calibration) -> None:
    """Copy a file to its newest backup; older backups move on by one name.

    Nothing is done if the file holds no usable calibration, the successor's numbers, or those of
    the newest backup. If an older backup has the same numbers, the copy replaces it: calibrations
    that alternate use one backup each. Files with these names that are not ours are neither changed
    nor counted. After a FileError the backups are unchanged.
    """
    held = _stored_correction(path)
    if held is None:
        return
    content = read_small(path, LARGEST_FILE)
    files = [file for file in backup_files(path) if is_free_or_ours(file) and not file.is_symlink()]
    if not files:
        raise FileError("all names for it belong to files that are not ours")
    each = [_stored_correction(file) for file in files]
    kept = next((k for k, other in enumerate(each) if other and other.is_same(held)), None)
    if kept == 0 or held.is_same(successor.correction):
        return
    missing = (k for k, file in enumerate(files) if not file.exists())
    free = next(missing, len(files) - 1) if kept is None else kept
    text = content.decode("utf-8")
    write_atomically(files[0], text, when_written=lambda: _shift_names(files, free))


def _stored_correction(file: Path) -> Correction | None:
    """Return the correction stored in a file; None if the file cannot be loaded."""
    try:
        return read_calibration(file)[0].correction
    except (OSError, ValueError, FileError):
        return None


def _shift_names(files: list[Path], free: int) -> None:
    """Rename each file before index `free` to the next name; the file at `free` is replaced."""
    for k in range(free, 0, -1):
        os.replace(files[k - 1], files[k])
