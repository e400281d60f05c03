"""Which axes the magnetometer has, compared with the IMU's."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import is_mirrored, likely_slip, rpy_from_rotation, spoken
from magcal_ros.core.knowledge import Belief, Knowledge
from magcal_ros.core.samples.alignment import FIELD, UP, Alignment
from magcal_ros.core.samples.window import Stretch


@dataclass(frozen=True)
class AxesTuning:
    """When axes are excluded, and when they are reported as wrong."""

    remains: float = 20.0  # chi-square, in independent samples, up to which an explanation remains
    likely: float = 9.0  # chi-square up to which candidates are ordered by what people do
    wrong: float = 40.0  # chi-square from which the axes as given are called wrong
    times: float = 2.0  # times the best's residual from which another fits plainly worse
    lift: float = math.radians(3.0)
    """Radians RMS of movement beside the turn from which less than that suffices."""
    worst_fit: float = 0.3
    """Residual over the changing field beyond which even the best explains nothing."""
    dip_sigma: float = math.radians(3.0)
    """Radians that a reference inclination is trusted to at best."""
    attitude_error: float = math.radians(0.5)  # radians that propagated attitudes are off at best
    least_dip: float = math.radians(10.0)  # radians of inclination from which its sign is used
    most_named: int = 3  # explanations that are written out for one sensor


TUNING = AxesTuning()
LIFT = "lift the nose by 20° while it turns"
DRIVE = "; on a straight drive a receiver's course shows its yaw, too"


@dataclass(frozen=True, eq=False)
class AxesFound:
    """What a movement shows of the magnetometer's axes."""

    candidates: FloatArray
    """What explains the samples, the likeliest first; rows are the magnetometer's axes, after the
    mounting that is known, in the body's. Shape (k, 3, 3)."""
    right: bool  # whether the axes as given are among them, or not excluded beyond doubt
    pose: FloatArray
    """The mounting that is known. Shape (3, 3)."""
    dip_known: bool  # whether a reference inclination separates a field from its opposite

    @property
    def meant(self) -> FloatArray:
        """The likeliest axes, those as given where they are not excluded."""
        return np.eye(3) if self.right else np.asarray(self.candidates[0])

    @property
    def mirrored(self) -> bool:
        """Whether the likeliest axes are such as no mounting makes."""
        return is_mirrored(self.meant)

    @property
    def mount_rpy_deg(self) -> tuple[int, int, int] | None:
        """What the parameter `mount_rpy_deg` should be; None if no mounting corrects the axes."""
        return None if self.mirrored else mount_of(self.meant, self.pose)

    @property
    def words(self) -> str:
        """What is wrong and the line to change, if gyro and accelerometer are right; else empty."""
        if self.right:
            return ""
        ways = named(self.candidates, self._say)
        words = f"the magnetometer's axes do not belong to the IMU's: {ways}"
        return f"{words}. To tell which, {self.movement}" if self.movement else words

    @property
    def movement(self) -> str:
        """The movement that separates the remaining candidates; empty if one is left."""
        if len(self.candidates) < 2:
            return ""
        first = self.candidates[0]
        is_opposite = len(self.candidates) == 2 and np.array_equal(first, -self.candidates[1])
        if is_opposite and not self.dip_known:
            return (
                "give the place or the field's inclination: only this separates axes from their "
                "opposites"
            )
        dip = "" if self.dip_known else ", and give the place or the field's inclination"
        level = all(np.array_equal(np.abs(first[2]), np.abs(c[2])) for c in self.candidates)
        return f"{LIFT}{dip}{DRIVE if level else ''}"

    def _say(self, axes: FloatArray) -> str:
        whole = np.rint(self.pose.T @ axes)
        if not np.array_equal(np.abs(whole).sum(axis=0), np.ones(3)):
            whole = axes
        if is_mirrored(axes):
            return f"{spoken(whole)} (mirrored: no mounting explains this; {likely_slip(whole)})"
        named = " (NED)" if np.array_equal(whole, np.diag([1.0, -1.0, -1.0])) else ""
        return f"{spoken(whole)}{named}: set `{parameter_line(mount_of(axes, self.pose))}`"


def named(candidates: FloatArray, say: Callable[[FloatArray], str]) -> str:
    """Say the likeliest of the candidates (k, 3, 3), and how many more there are."""
    left = len(candidates) - TUNING.most_named
    words = [say(axes) for axes in candidates[: TUNING.most_named]]
    return "; or ".join([*words, f"{left} more"] if left > 0 else words)


def mount_of(axes: FloatArray, pose: FloatArray) -> tuple[int, int, int]:
    """Return the mounting's roll, pitch and yaw in degrees of axes found on top of a known pose."""
    roll, pitch, yaw = (
        round(math.degrees(angle)) % 360 for angle in rpy_from_rotation(axes.T @ pose)
    )
    return _signed(roll), _signed(pitch), _signed(yaw)


def parameter_line(rpy_deg: tuple[int, int, int]) -> str:
    """Return the line for a parameter file."""
    return f"mount_rpy_deg: [{', '.join(f'{angle}.0' for angle in rpy_deg)}]"


def _signed(degrees: int) -> int:
    return degrees - 360 if degrees > 180 else degrees


def most_turned(stretch: Stretch) -> float:
    """Return how far apart the most distant attitudes are, roughly, radians."""
    return float(np.ptp(np.cumsum(stretch.turn + stretch.coning, axis=0), axis=0).max())


def dip_is_known(knowledge: Knowledge) -> bool:
    """Return whether the reference field separates axes from their opposites."""
    dip = knowledge.reference.inclination
    return not dip.is_unknown and abs(dip.value) > TUNING.least_dip


def inclination_misfit(found: Alignment, k: int, sign: float, dip: Belief) -> float:
    """Return the chi-square of a candidate's inclination against the reference.

    `sign` is -1 where the opposite of all axes of candidate `k` is meant. A reference inclination
    that is not known weighs nothing.
    """
    given_up = not np.isfinite(found.covariance[k]).all()
    if dip.is_unknown or abs(dip.value) < TUNING.least_dip or given_up:
        return 0.0
    state = found.parameters[k]
    up = state[UP] / np.linalg.norm(state[UP])
    field = sign * state[FIELD]
    size = float(np.linalg.norm(field))
    along = float(up @ field) / size
    level = math.sqrt(max(1.0 - along**2, 1e-6))
    slope = (up - along * field / size) / size / level
    variance = float(slope @ found.covariance[k][FIELD, FIELD] @ slope)
    # Drift of the gyro looks like a small tilt, which shows nothing of the field.
    variance += (TUNING.attitude_error / max(found.tilt_seen, 1e-6)) ** 2
    seen = -math.asin(max(-1.0, min(1.0, along)))
    allowed = TUNING.dip_sigma**2 + dip.sigma**2
    return (seen - dip.value) ** 2 / (allowed + variance)
