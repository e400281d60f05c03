"""The guided half minute: the steps asked of the user, and their detection in the samples.

A state machine without a clock: its inputs are samples and times, its output is the current step.
The sensors may be faulty: any working one can show that a step is done, and no unit, sign or axis
is assumed to be right.
"""

from __future__ import annotations

import math
from enum import Enum

import numpy as np

from magcal_ros.core.doctor.doctor_tuning import AXES, GUIDE, HEALTH
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import angle_between, unit
from magcal_ros.core.samples.rest import USUAL_LEVEL
from magcal_ros.core.samples.streams import FieldSample, ImuSample


class GuideStep(str, Enum):
    """The steps, in order."""

    STAND = "stand"
    TURN = "turn"
    LIFT = "lift"


ASKED = {
    GuideStep.STAND: "stand still",
    GuideStep.TURN: "turn left, a full circle or at least a quarter, and stop",
    GuideStep.LIFT: "lift the nose by 20°, or drive over a kerb, and stop",
}
"""The steps in words for the user."""

BLOCKS = 4
"""Averages in the shortest rest."""
ANGLE = 2.0 * AXES.least_turn
SWING = 2.0 * USUAL_LEVEL * math.sin(0.5 * ANGLE)
"""Turn by the gyro that is enough, radians, and the field's change by it, over the field's size."""


class Guide:
    """Asks for one step after the other, and detects when each is done.

    `now` is in seconds, on a monotonic clock. `ended` holds each step that has ended: True if it
    was done, False if it was given up.
    """

    def __init__(self, now: float) -> None:
        self.ended: dict[GuideStep, bool] = {}
        self._since = self._block_began = now
        self._imu: list[tuple[float, ...]] = []
        self._field: list[tuple[float, ...]] = []
        self._blocks: list[FloatArray] = []
        """Means of force, rate and field over a short time, NaN without samples. Shape (3, 3)."""
        self._seconds: list[float] = []  # duration of each block
        self._step_start = 0  # index of the current step's first block
        self._resting: FloatArray | None = None

    @property
    def current(self) -> GuideStep | None:
        """The current step; None at the end."""
        return next((step for step in GuideStep if step not in self.ended), None)

    @property
    def turned_left(self) -> bool | None:
        """True if the turn to the left was done, None if it was not detected."""
        return self.ended.get(GuideStep.TURN) or None

    def add(self, sample: ImuSample | FieldSample) -> None:
        """Take a sample."""
        if isinstance(sample, ImuSample):
            self._imu.append((*sample.force, *sample.rate))
        else:
            self._field.append(sample.field)

    def left(self, now: float) -> float:
        """Return the seconds until the current step is given up."""
        return max(GUIDE.patience - (now - self._since), 0.0)

    def skip(self, now: float) -> bool:
        """Give up the current step; return whether this is possible: the first step is needed."""
        step = self.current
        if step is None or step is GuideStep.STAND:
            return False
        self._end(step, False, now)
        return True

    def pass_time(self, now: float) -> bool:
        """Advance the time to `now`; return whether a step was done or given up."""
        step = self.current
        if step is None or now - self._block_began < GUIDE.rest / BLOCKS:
            return False
        self._close_block(now)
        is_detected = self._is_detected(step)
        if is_detected or now - self._since > GUIDE.patience:
            self._end(step, is_detected, now)
            return True
        return False

    def _close_block(self, now: float) -> None:
        block = np.full((3, 3), np.nan)
        if self._imu:
            block[:2] = np.mean(self._imu, axis=0).reshape(2, 3)
        if self._field:
            block[2] = np.mean(self._field, axis=0)
        self._blocks.append(block)
        self._seconds.append(now - self._block_began)
        self._imu, self._field = [], []
        self._block_began = now

    def _is_detected(self, step: GuideStep) -> bool:
        if self._resting is None:
            return self._stands(GUIDE.stand)
        resting, bias, first = self._resting
        force, rate, field = np.swapaxes(self._blocks[self._step_start :], 0, 1)
        if step is GuideStep.LIFT:
            lifted = any(angle_between(each, resting) > GUIDE.lift for each in force)
            return lifted and self._stands(GUIDE.rest)
        # About the vertical at rest, whichever axis of the sensor this is.
        turns = ((rate - bias) @ unit(resting)) * self._seconds[self._step_start :]
        angle = np.abs(np.cumsum(np.where(np.isfinite(turns), turns, 0.0)))
        swing = np.linalg.norm(field - first, axis=1) / max(float(np.linalg.norm(first)), 1e-12)
        if not (((angle > ANGLE) | (swing > SWING)).any() and self._stands(GUIDE.rest)):
            return False
        # In a short time, a slow turn changes the field less than `still` allows: the sensor that
        # measured the turn, in any unit, shows its end.
        moved = rate - bias if angle[-1] > ANGLE else np.diff(field, axis=0)
        pace = np.linalg.norm(moved, axis=1)
        return bool(np.nanmax(pace[-BLOCKS:]) < HEALTH.moving * np.nanmax(pace))

    def _stands(self, seconds: float) -> bool:
        """Return whether gravity and field have not changed during the last `seconds`."""
        count = round(BLOCKS * seconds / GUIDE.rest)
        if len(self._blocks) < count:
            return False
        last = np.array(self._blocks[-count:])
        force, _, field = last.mean(axis=0)
        away = np.linalg.norm(last[:, 2] - field, axis=1)
        leans = [angle_between(each, force) for each in last[:, 0]]
        return bool((away < GUIDE.still * np.linalg.norm(field)).all() and max(leans) < GUIDE.still)

    def _end(self, step: GuideStep, is_detected: bool, now: float) -> None:
        self.ended[step] = is_detected
        if self._blocks:
            self._resting = np.nan_to_num(np.mean(self._blocks[-4:], axis=0))
        self._since, self._step_start = now, len(self._blocks)
