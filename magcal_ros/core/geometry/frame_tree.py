"""How the frames of a robot sit in one another, as far as they do not move."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from magcal_ros.core.errors import MagcalError
from magcal_ros.core.geometry.arrays import FloatArray, frozen_array

FIXED = "fixed"
"""The kind of joint that does not move, by its name in URDF."""


class FrameTrouble(MagcalError):
    """Frames whose pose in one another is not told; the text says what to do next."""


@dataclass(frozen=True, eq=False)
class FrameJoint:
    """One frame in another.

    Parameters
    ----------
    name : str
        What to call it.
    kind : str
        `FIXED`, or how it moves.
    parent, child : str
        Frames.
    pose : array_like, shape (3, 3)
        Takes vectors from the child's axes to the parent's.
    """

    name: str
    kind: str
    parent: str
    child: str
    pose: FloatArray = field(default_factory=lambda: np.eye(3))

    def __post_init__(self) -> None:
        object.__setattr__(self, "pose", frozen_array(self.pose, (3, 3), "pose of a joint"))


class FrameTree:
    """Frames joined to one another; the newest word about a frame counts.

    Parameters
    ----------
    joints : iterable of FrameJoint
        In any order.
    """

    def __init__(self, joints: Iterable[FrameJoint] = ()) -> None:
        self._above = {joint.child: joint for joint in joints}

    @property
    def frames(self) -> frozenset[str]:
        """Every frame that is named."""
        return frozenset(self._above) | {joint.parent for joint in self._above.values()}

    def with_joints(self, joints: Iterable[FrameJoint]) -> FrameTree:
        """Return the tree with more joints, or with other ones for the same frames."""
        return FrameTree([*self._above.values(), *joints])

    def pose(self, frame: str, parent: str) -> FloatArray:
        """Return how one frame sits in another, which need not be above it.

        Parameters
        ----------
        frame, parent : str
            Their names.

        Returns
        -------
        ndarray, shape (3, 3)
            Takes vectors from the axes of `frame` to those of `parent`.

        Raises
        ------
        FrameTrouble
            If one of them is missing, if nothing joins them, or if a joint between them moves.
        """
        for name in (frame, parent):
            if name not in self.frames:
                raise FrameTrouble(
                    f"the robot's description has no frame {name!r}; it has {_some(self.frames)}"
                )
        below, above = list(self._upwards(frame)), list(self._upwards(parent))
        if _root(frame, below) != _root(parent, above):
            raise FrameTrouble(
                f"nothing joins the frames {frame!r} and {parent!r} in the robot's description"
            )
        shared = {joint.child for joint in below} & {joint.child for joint in above}
        return np.asarray(_climbed(above, shared).T @ _climbed(below, shared))

    def _upwards(self, frame: str) -> Iterator[FrameJoint]:
        """Walk from a frame towards its root; a walk that comes back to where it was is refused."""
        seen = {frame}
        while (joint := self._above.get(frame)) is not None:
            yield joint
            frame = joint.parent
            if frame in seen:
                raise FrameTrouble(
                    f"the robot's description goes in a circle through the frame {frame!r}"
                )
            seen.add(frame)


def _root(frame: str, joints: list[FrameJoint]) -> str:
    return joints[-1].parent if joints else frame


def _climbed(joints: list[FrameJoint], shared: set[str]) -> FloatArray:
    """Return the pose of the first joint's child in the first frame that both walks reach."""
    pose: FloatArray = np.eye(3)
    for joint in joints:
        if joint.child in shared:
            break
        if joint.kind != FIXED:
            raise FrameTrouble(
                f"the joint {joint.name!r} between {joint.parent!r} and {joint.child!r} moves "
                f"({joint.kind}), so the sensors' pose is not told; give mount_rpy_deg by hand"
            )
        pose = joint.pose @ pose
    return pose


def _some(frames: frozenset[str], most: int = 12) -> str:
    """Return names for a person to compare a misspelt one with."""
    names = sorted(frames)
    if not names:
        return "none"
    rest = len(names) - most
    return ", ".join(names[:most]) + (f" and {rest} more" if rest > 0 else "")
