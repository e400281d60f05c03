"""The fixed and moving joints of a robot, from its description (URDF)."""

from __future__ import annotations

import contextlib
import math
from xml.parsers import expat

from magcal_ros.core.errors import MagcalError
from magcal_ros.core.geometry.frame_tree import FrameJoint
from magcal_ros.core.geometry.rotations import rotation_from_rpy
from magcal_ros.files.default_paths import identifier

LARGEST = 4_000_000  # characters, four times the description of the largest humanoid

KINDS = ("fixed", "revolute", "continuous", "prismatic", "floating", "planar")


class RobotDescriptionError(MagcalError):
    """A robot description that cannot be read; the text says where and why."""


def joints_of(text: str) -> tuple[FrameJoint, ...]:
    """Return the joints of a URDF in their order; other elements are skipped.

    RobotDescriptionError if the text is no URDF, is damaged, or declares a document type.
    """
    if len(text) > LARGEST:
        raise RobotDescriptionError(
            f"the robot description has {len(text)} characters; at most {LARGEST} are read"
        )
    reader = _Reader()
    parser = expat.ParserCreate()
    parser.StartElementHandler = reader.start
    parser.EndElementHandler = reader.end
    parser.StartDoctypeDeclHandler = _refuse_doctype
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise RobotDescriptionError(f"the robot description is not XML: {error}") from None
    if not reader.is_robot:
        raise RobotDescriptionError("the robot description is not a URDF: its root is not <robot>")
    return tuple(reader.joints)


def _refuse_doctype(*_: object) -> None:
    raise RobotDescriptionError(
        "the robot description declares a document type, which a URDF does not need and which "
        "could use all memory while it is read; remove the <!DOCTYPE ...>"
    )


class _Reader:
    """Collects the joints directly below the root; a transmission only refers to joints."""

    def __init__(self) -> None:
        self.joints: list[FrameJoint] = []
        self.is_robot = False
        self._path: list[str] = []
        self._joint: dict[str, str] = {}

    def start(self, name: str, attributes: dict[str, str]) -> None:
        self._path.append(name)
        if len(self._path) == 1:
            self.is_robot = name == "robot"
        elif self._path == ["robot", "joint"]:
            self._joint = {key: identifier(attributes.get(key, "")) for key in ("name", "type")}
        elif self._path[:2] == ["robot", "joint"] and len(self._path) == 3:
            if name in ("parent", "child"):
                self._joint[name] = identifier(attributes.get("link", ""))
            elif name == "origin" and "rpy" in attributes:
                self._joint["rpy"] = attributes["rpy"]

    def end(self, _: str) -> None:
        if self._path == ["robot", "joint"]:
            self.joints.append(_joint_of(self._joint))
        self._path.pop()


def _joint_of(read: dict[str, str]) -> FrameJoint:
    name, kind = read["name"], read["type"]
    parent, child = read.get("parent", ""), read.get("child", "")
    if kind not in KINDS:
        raise RobotDescriptionError(
            f"the joint {name!r} of the robot description has the type {kind!r}; URDF allows "
            f"{', '.join(KINDS)}"
        )
    if not (parent and child):
        raise RobotDescriptionError(
            f"the joint {name!r} of the robot description names no parent or no child"
        )
    rpy = _angles(name, read.get("rpy", "0 0 0"))
    return FrameJoint(name, kind, parent, child, rotation_from_rpy(*rpy))


def _angles(joint: str, text: str) -> tuple[float, float, float]:
    with contextlib.suppress(ValueError):
        roll, pitch, yaw = (float(word) for word in text.split(None, 3))
        if math.isfinite(roll + pitch + yaw):
            return roll, pitch, yaw
    raise RobotDescriptionError(
        f"the joint {joint!r} of the robot description has rpy={text[:60]!r}, which is not three "
        "numbers"
    )
