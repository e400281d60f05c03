"""The fixed and moving joints of a robot, from its description (URDF)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from xml.parsers import expat

from magcal_ros.core.errors import MagcalError
from magcal_ros.core.geometry.frame_tree import FrameJoint
from magcal_ros.core.geometry.rotations import rotation_from_rpy
from magcal_ros.files.default_paths import known_as

LARGEST = 4_000_000
"""Bytes. The largest humanoid's description has a quarter of that."""

KINDS = ("fixed", "revolute", "continuous", "prismatic", "floating", "planar")


class DescriptionTrouble(MagcalError):
    """A robot description that cannot be read; the text says where and why."""


def joints_of(text: str) -> tuple[FrameJoint, ...]:
    """Return the joints of a URDF in their order; whatever else it holds is skipped.

    A DescriptionTrouble if it is no URDF, is damaged, or declares entities, which no URDF needs.
    """
    if len(text) > LARGEST:
        raise DescriptionTrouble(
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
        raise DescriptionTrouble(f"the robot description is no XML: {error}") from None
    if not reader.is_robot:
        raise DescriptionTrouble("the robot description is no URDF: its root is not <robot>")
    return tuple(reader.joints)


def _refuse_doctype(*_: object) -> None:
    raise DescriptionTrouble(
        "the robot description declares a document type, which a URDF has no need of and which "
        "could blow up while it is read; take the <!DOCTYPE ...> out"
    )


@dataclass(frozen=True)
class _Draft:
    """A joint of which not everything has been read."""

    name: str
    kind: str
    parent: str = ""
    child: str = ""
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def finished(self) -> FrameJoint:
        if self.kind not in KINDS:
            raise DescriptionTrouble(
                f"the joint {self.name!r} of the robot description has the type {self.kind!r}; "
                f"URDF knows {', '.join(KINDS)}"
            )
        if not (self.parent and self.child):
            raise DescriptionTrouble(
                f"the joint {self.name!r} of the robot description names no parent or no child"
            )
        return FrameJoint(
            self.name, self.kind, self.parent, self.child, rotation_from_rpy(*self.rpy)
        )


class _Reader:
    """Gathers joints that stand right below the root; those of a transmission are others."""

    def __init__(self) -> None:
        self.joints: list[FrameJoint] = []
        self.is_robot = False
        self._path: list[str] = []
        self._draft: _Draft | None = None

    def start(self, name: str, attributes: dict[str, str]) -> None:
        self._path.append(name)
        if len(self._path) == 1:
            self.is_robot = name == "robot"
        elif self._path == ["robot", "joint"]:
            name, kind = attributes.get("name", ""), attributes.get("type", "")
            self._draft = _Draft(known_as(name), known_as(kind))
        elif self._draft is not None and len(self._path) == 3:
            self._draft = _with(self._draft, name, attributes)

    def end(self, _: str) -> None:
        if self._draft is not None and len(self._path) == 2:
            self.joints.append(self._draft.finished)
            self._draft = None
        self._path.pop()


def _with(draft: _Draft, name: str, attributes: dict[str, str]) -> _Draft:
    if name == "parent":
        return replace(draft, parent=known_as(attributes.get("link", "")))
    if name == "child":
        return replace(draft, child=known_as(attributes.get("link", "")))
    if name == "origin" and "rpy" in attributes:
        return replace(draft, rpy=_angles(draft.name, attributes["rpy"]))
    return draft


def _angles(joint: str, text: str) -> tuple[float, float, float]:
    try:
        roll, pitch, yaw = (float(word) for word in text.split(None, 3))
    except ValueError:
        pass
    else:
        if all(math.isfinite(angle) for angle in (roll, pitch, yaw)):
            return roll, pitch, yaw
    raise DescriptionTrouble(
        f"the joint {joint!r} of the robot description has rpy={text[:60]!r}, which is not three "
        "numbers"
    )
