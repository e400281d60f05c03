"""Where files go unless the user says otherwise."""

from __future__ import annotations

import hashlib
import os
import re
from pathlib import Path

LONGEST_NAME = 80


def ros_home() -> Path:
    """Return the user's ROS home: `$ROS_HOME`, or `~/.ros`."""
    return Path(os.environ.get("ROS_HOME") or Path.home() / ".ros")


def safe_name(text: str) -> str:
    """Turn a name from the network into one that can stand in a path.

    Letters, digits, `_` and `-` stay. Where anything else was, or where the name itself looks as
    if it had one, it gets a digest, so that two different names do not meet.
    """
    plain = re.sub(r"[^A-Za-z0-9_-]", "_", text)[:LONGEST_NAME] or "unnamed"
    if plain == text and not re.search(r"-[0-9a-f]{8}\Z", text):
        return plain
    digest = hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:8]
    return f"{plain}-{digest}"


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
