"""Where files go unless the user says otherwise."""

from __future__ import annotations

import hashlib
import os
import re
from pathlib import Path

from magcal_ros.files.atomic import FileTrouble

LONGEST_NAME = 80

LONGEST_FRAME = 200
"""Characters of a frame that are kept; the network may send a million."""

RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)\Z", re.IGNORECASE)
"""Names that are devices on some file systems."""


def ros_home() -> Path:
    """Return the user's ROS home: `$ROS_HOME`, or `~/.ros`.

    Raises
    ------
    FileTrouble
        If there is neither.
    """
    return chosen_path(os.environ.get("ROS_HOME") or "~/.ros")


def chosen_path(text: str) -> Path:
    """Return a path as the user wrote it, `~` included.

    Raises
    ------
    FileTrouble
        If there is no such home.
    """
    try:
        return Path(text).expanduser()
    except RuntimeError as error:
        raise FileTrouble(
            f"there is no home folder for {text!r}: name the whole path, or set ROS_HOME"
        ) from error


def is_missing(path: Path) -> bool:
    """Whether there is surely nothing; a place that cannot be looked at may hold something."""
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return True
    except (OSError, ValueError):
        return False
    return False


def safe_name(text: str) -> str:
    """Turn a name from the network into one that can stand in a path.

    Letters, digits, `_` and `-` stay. Where anything else was, or where the name itself looks as
    if it had one, it gets a digest, so that two different names do not meet.
    """
    plain = re.sub(r"[^A-Za-z0-9_-]", "_", text)[:LONGEST_NAME] or "unnamed"
    looks_made = re.search(r"-[0-9a-f]{8}\Z", text) or RESERVED.match(text)
    return plain if plain == text and not looks_made else f"{plain}-{_digest(text)}"


def known_as(frame: str) -> str:
    """Return the name under which a calibration remembers a frame: itself, unless it is huge."""
    if len(frame) <= LONGEST_FRAME:
        return frame
    return f"{frame[:LONGEST_FRAME]}…{_digest(frame)}"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:8]


def default_calibration_path(magnetometer_frame: str, namespace: str = "/") -> Path:
    """Return where the calibration of a sensor lives.

    Parameters
    ----------
    magnetometer_frame : str
        `frame_id` of the field messages.
    namespace : str
        The node's namespace: two robots may carry the same sensor.
    """
    folder = ros_home() / "magcal"
    if namespace.strip("/"):
        folder /= safe_name(namespace.strip("/"))
    return folder / f"{safe_name(magnetometer_frame)}.yaml"
