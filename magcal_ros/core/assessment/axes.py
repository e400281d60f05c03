"""Which axes the magnetometer has, compared with the IMU's."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magcal_ros.core.errors import Reason
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import (
    is_mirrored,
    likely_slip,
    rank_of,
    rpy_from_rotation,
    signed_permutations,
    spoken,
)
from magcal_ros.core.knowledge import Belief, Knowledge
from magcal_ros.core.samples.alignment import Alignment, align
from magcal_ros.core.samples.alignment_fit import FIELD, UP
from magcal_ros.core.samples.alignment_fit import TUNING as FIT
from magcal_ros.core.samples.window import Stretch, Window, stretch_of


@dataclass(frozen=True)
class AxesTuning:
    """When axes are excluded, and when they are reported as wrong."""

    remains: float = 25.0
    """Misfit, in independent samples' chi-square, up to which a candidate remains."""
    likely: float = 9.0
    """Misfit up to which candidates are ordered by what people do."""
    wrong: float = 50.0
    """Misfit of the axes as given from which they are called wrong."""
    times: float = 2.0
    """So many times the best's residual they must leave, too."""
    lift: float = math.radians(3.0)
    """Radians RMS of movement beside the turn from which less than that is asked for."""
    times_lifted: float = 1.25
    """So many times the best's residual, then: on a long drive the gyro's drift looks like
    movement, and a linear acceleration like another inclination; neither is part of it."""
    worst_fit: float = 0.3
    """Residual over the changing field beyond which even the best explains nothing."""
    least_turn: float = math.radians(60.0)
    """Radians between the first and some later attitude."""
    fewest: int = 20
    """Samples."""
    dip_sigma: float = math.radians(3.0)
    """Radians that a reference inclination is trusted to at best."""
    attitude_error: float = math.radians(0.5)
    """Radians that propagated attitudes are off at best."""
    vaguest_dip: float = math.radians(15.0)
    """Radians of uncertainty beyond which the seen inclination says nothing."""
    least_dip: float = math.radians(10.0)
    """Radians of inclination from which its sign says something."""
    most_named: int = 3
    """Candidates that are written out."""


TUNING = AxesTuning()
AS_THEY_SHOULD_BE: FloatArray = np.eye(3)
MISLED_BY_AXES = (
    Reason.AMBIGUOUS,
    Reason.AXES_DISAGREE,
    Reason.AXIS_ALONG_FIELD,
    Reason.AXIS_HORIZONTAL,
    Reason.FIELD_NOT_ON_A_PLANE,
    Reason.FIELD_TOO_STEEP,
    Reason.NO_SOLUTION,
)
"""Refusals that wrong axes can cause."""


GYRO_IS_WRONG = (
    "the gyro contradicts gravity: the axes of both sensors belong together, so an axis of the "
    "gyro has the wrong sign or another one's place in the driver; REP-103 requires turns to the "
    "left, nose down and right side down to be positive"
)
IF_THE_GYRO_IS_RIGHT = (
    "This assumes that gyro and accelerometer are right: check first that the axes of both sensors "
    "belong together, because a mirrored gyro looks the same"
)
LIFT = "lift the nose by 20° while it turns"
DRIVE = "; on a straight drive a receiver's course shows its yaw, too"


@dataclass(frozen=True, eq=False)
class AxesFound:
    """What a movement shows of the magnetometer's axes."""

    candidates: FloatArray
    """What explains the samples, the likeliest first; rows are the magnetometer's axes, after the
    mounting that is known, in the body's. Empty if nothing does. Shape (k, 3, 3)."""
    right: bool
    """Whether the axes as given are among them, or not excluded beyond doubt."""
    pose: FloatArray
    """The mounting that is known. Shape (3, 3)."""
    dip_known: bool
    """Whether a reference inclination told a field from its opposite."""

    @property
    def meant(self) -> FloatArray | None:
        """The likeliest axes, those as given where they are not excluded; None if none fit."""
        if self.right:
            return AS_THEY_SHOULD_BE
        return self.candidates[0] if len(self.candidates) else None

    @property
    def mirrored(self) -> bool:
        """Whether the likeliest axes are such as no mounting makes."""
        return self.meant is not None and is_mirrored(self.meant)

    @property
    def mount_rpy_deg(self) -> tuple[int, int, int] | None:
        """What the parameter `mount_rpy_deg` should be; None if no mounting corrects the axes."""
        if self.meant is None or self.mirrored:
            return None
        return mount_of(self.meant, self.pose)

    @property
    def words(self) -> str:
        """What is wrong and the line to change; empty if nothing is."""
        if self.right or self.meant is None:
            return self.said
        return f"{self.said}. {IF_THE_GYRO_IS_RIGHT}"

    @property
    def said(self) -> str:
        """The same, if gyro and accelerometer are known to be right."""
        if self.right:
            return ""
        if self.meant is None:
            return (
                "no mounting and no swapped or mirrored axes of the magnetometer make gyro and "
                "field agree: check the gyro's unit, axes and stamps, and turn away from "
                "iron"
            )
        words = f"the magnetometer's axes do not belong to the IMU's: {self._say(self.meant)}"
        others = self.candidates[1 : TUNING.most_named]
        if len(self.candidates) > 1:
            words += "; or " + "; or ".join(self._say(axes) for axes in others)
            left = len(self.candidates) - 1 - len(others)
            words += f"; or {left} more" if left else ""
            words += f". To tell which, {self.movement}"
        return words

    @property
    def movement(self) -> str:
        """The movement that separates the remaining candidates; empty if one is left."""
        if len(self.candidates) < 2:
            return ""
        first = self.candidates[0]
        if all(np.array_equal(np.abs(first), np.abs(c)) for c in self.candidates) and (
            len(self.candidates) == 2
            and np.array_equal(first, -self.candidates[1])
            and not self.dip_known
        ):
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


def find_axes(window: Window, knowledge: Knowledge = Knowledge()) -> AxesFound | None:
    """Compare all 48 possible orientations of the axes.

    Parameters
    ----------
    window : Window
        A turn, at best with a lift of the nose; accelerometer and gyro must be right.
    knowledge : Knowledge, optional
        Its mounting is taken off first. Its inclination only tells apart what the gyro cannot: a
        field and its opposite.

    Returns
    -------
    AxesFound or None
        None where there is no gyro or too little movement to say anything.
    """
    if window.angular_rate is None or len(window) < TUNING.fewest:
        return None
    stretch = stretch_of(
        Window(
            window.time,
            window.field @ knowledge.mounting.to_body.T,
            window.specific_force,
            window.angular_rate,
        )
    )
    if stretch is None or most_turned(stretch) < TUNING.least_turn:
        return None
    # Axes and their opposites explain the same turn, with the opposite field and hard iron.
    every = signed_permutations()
    proper = np.array([axes for axes in every if not is_mirrored(axes)])
    found = align(stretch, proper, FIT.after_rest(window.bias_sigma))
    dip = knowledge.reference.inclination
    by_inclination = np.array(
        [[inclination_misfit(found, k, s, dip) for k in range(24)] for s in (1.0, -1.0)]
    )
    axes = np.concatenate([proper, -proper])
    misfit = np.concatenate([found.misfit, found.misfit]) + by_inclination.ravel()
    misfit -= misfit.min()
    rms = np.concatenate([found.rms, found.rms])
    return _decide(axes, misfit, rms, found.tilt_spread > TUNING.lift, knowledge)


def _decide(
    axes: FloatArray,
    misfit: FloatArray,
    rms: FloatArray,
    lifted: bool,
    knowledge: Knowledge,
) -> AxesFound:
    given = int(np.argmax([np.array_equal(each, AS_THEY_SHOULD_BE) for each in axes]))
    best = int(np.argmin(misfit))
    dip_known, pose = dip_is_known(knowledge), knowledge.mounting.pose
    if rms[best] > TUNING.worst_fit:
        return AxesFound(np.zeros((0, 3, 3)), False, pose, dip_known)
    times = TUNING.times_lifted if lifted else TUNING.times
    upside_down = misfit[given] - misfit[_opposite(given)] > TUNING.wrong
    plainly = rms[given] > times * rms[best] or (lifted and upside_down)
    wrong = misfit[given] > TUNING.wrong and plainly
    remaining = [k for k in range(len(axes)) if misfit[k] < TUNING.remains]
    remaining = [k for k in remaining if not (wrong and k == given)]
    remaining.sort(key=lambda k: (misfit[k] > TUNING.likely, rank_of(axes[k])))
    return AxesFound(axes[remaining], not wrong, pose, dip_known)


def most_turned(stretch: Stretch) -> float:
    """Return how far apart the most distant attitudes are, roughly, radians."""
    return float(np.ptp(np.cumsum(stretch.turn + stretch.coning, axis=0), axis=0).max())


def dip_is_known(knowledge: Knowledge) -> bool:
    """Return whether the reference field separates axes from their opposites."""
    dip = knowledge.reference.inclination
    return not dip.is_unknown and abs(dip.value) > TUNING.least_dip


def _opposite(k: int) -> int:
    """Return the index of the opposite of candidate k: the same place in the other half."""
    return (k + 24) % 48


def inclination_misfit(found: Alignment, k: int, sign: float, dip: Belief) -> float:
    """Return the chi-square of a candidate's inclination against the reference.

    Parameters
    ----------
    found : Alignment
        The fit.
    k : int
        Which of its candidates.
    sign : float
        -1 where the opposite of all its axes is meant.
    dip : Belief
        The reference inclination; one that is not known weighs nothing.
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
    if variance > TUNING.vaguest_dip**2:
        return 0.0
    allowed = TUNING.dip_sigma**2 + dip.sigma**2
    return (seen - dip.value) ** 2 / (allowed + variance)
