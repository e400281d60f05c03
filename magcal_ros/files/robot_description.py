"""The fixed and moving joints of a robot, from its description (URDF)."""

from __future__ import annotations

import contextlib
import math
from xml.etree.ElementTree import Element, TreeBuilder
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
    # Unlike ElementTree's own parser, expat ignores namespaces, as ROS does.
    parser, builder = expat.ParserCreate(), TreeBuilder()
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    parser.StartDoctypeDeclHandler = _refuse_doctype
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise RobotDescriptionError(f"the robot description is not XML: {error}") from None
    robot = builder.close()
    if robot.tag != "robot":
        raise RobotDescriptionError("the robot description is not a URDF: its root is not <robot>")
    # A transmission also has a <joint>, which only refers to one.
    return tuple(_joint_of(element) for element in robot if element.tag == "joint")


def _refuse_doctype(*_: object) -> None:
    raise RobotDescriptionError(
        "the robot description declares a document type, which a URDF does not need and which "
        "could use all memory while it is read; remove the <!DOCTYPE ...>"
    )


def _joint_of(joint: Element) -> FrameJoint:
    parts = {part.tag: part.attrib for part in joint}
    name, kind = (identifier(joint.get(key, "")) for key in ("name", "type"))
    parent, child = (identifier(parts.get(k, {}).get("link", "")) for k in ("parent", "child"))
    if kind not in KINDS:
        raise RobotDescriptionError(
            f"the joint {name!r} of the robot description has the type {kind!r}; URDF allows "
            f"{', '.join(KINDS)}"
        )
    if not (parent and child):
        raise RobotDescriptionError(
            f"the joint {name!r} of the robot description names no parent or no child"
        )
    rpy = _angles(name, parts.get("origin", {}).get("rpy", "0 0 0"))
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
