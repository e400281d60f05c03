"""Paths of files that the user has not named; a FileError without a home folder."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path

from magcal_ros.files.disk import FileError

LONGEST_NAME = 80

LONGEST_FRAME = 200  # characters of a frame that are kept; the network may send a million

RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)\Z", re.IGNORECASE)
"""Names that are devices on some file systems."""


def own_folder() -> Path:
    """Return this package's folder in the user's ROS home (`$ROS_HOME`, or `~/.ros`)."""
    return chosen_path(os.environ.get("ROS_HOME") or "~/.ros") / "magcal"


def chosen_path(text: str) -> Path:
    """Return a path as the user wrote it, `~` included."""
    try:
        return Path(text).expanduser()
    except RuntimeError as error:
        raise FileError(
            f"there is no home folder for {text!r}: name the whole path, or set ROS_HOME"
        ) from error


def lies_within(path: Path, places: Iterable[Path]) -> bool:
    """Whether a path is one of the places or lies below one, by its text alone.

    Links are not resolved: only a user who may write to a place can have made a link there.
    """
    if ".." in path.parts or "\0" in str(path):
        return False
    return any(path.absolute().is_relative_to(place.absolute()) for place in places)


def numbered(path: Path, number: int) -> Path:
    """Return the file of a magnetometer by its number: `name.2.yaml` for the second."""
    return path if number == 1 else path.with_name(f"{path.stem}.{number}{path.suffix}")


def is_missing(path: Path) -> bool:
    """Whether a file is certainly missing; False if the file system cannot tell."""
    try:
        path.stat()
    except (OSError, ValueError) as error:
        return isinstance(error, (FileNotFoundError, NotADirectoryError))
    return False


def safe_name(text: str) -> str:
    """Convert a name from the network to one that is safe in a path.

    Letters, digits, `_` and `-` stay. A name that is changed or reserved, or already seems to end
    in a digest, gets a digest, so that different names remain different.
    """
    plain = re.sub(r"[^A-Za-z0-9_-]", "_", text)[:LONGEST_NAME] or "unnamed"
    looks_made = re.search(r"-[0-9a-f]{8}\Z", text) or RESERVED.match(text)
    return plain if plain == text and not looks_made else f"{plain}-{_digest(text)}"


def identifier(frame: str) -> str:
    """Return the name of a frame in a calibration; a very long frame is cut, with a digest."""
    if len(frame) <= LONGEST_FRAME:
        return frame
    return f"{frame[:LONGEST_FRAME]}…{_digest(frame)}"


def _digest(text: str) -> str:
    # Most names need no digest, and a node starts sooner without the import.
    import hashlib

    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:8]


def sensor_file(frame: str, namespace: str, node: str) -> Path:
    """Return the path of a node's calibration of a sensor: `<node>.<frame>.yaml`.

    Two robots may carry the same sensor, and one node may have several. Neither part of the name
    contains a dot. A sensor without a frame is called `magnetometer`.
    """
    folder, inner = own_folder(), namespace.strip("/")
    folder = folder / safe_name(inner) if inner else folder
    return folder / f"{safe_name(node)}.{safe_name(frame or 'magnetometer')}.yaml"
