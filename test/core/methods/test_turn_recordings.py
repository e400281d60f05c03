"""Recorded turns with an independent truth; skipped without the recordings."""

import functools
import math
from pathlib import Path

import numpy as np
import pytest

from magcal_ros.core import Belief, Correction, Knowledge, ReferenceField, Window
from magcal_ros.core.geometry import wrap_angle, yaw_from_up_and_field
from magcal_ros.core.methods.smoother import fit
from magcal_ros.core.up import propagated_up

RECORDINGS = Path(__file__).resolve().parents[4] / "shared" / "recordings"


@functools.cache
def recording(name):
    folder = RECORDINGS / name
    if not folder.is_dir():
        pytest.skip(f"recording {name} is not at hand")
    imu, mag, truth = (
        np.genfromtxt(folder / f"{part}.csv", delimiter=",", skip_header=1)
        for part in ("imu", "mag", "truth")
    )
    return imu, mag, truth


def window(imu, mag, first=-math.inf, last=math.inf, added=0.0):
    rows = (mag[:, 0] >= first) & (mag[:, 0] <= last)
    time = mag[rows, 0]
    motion = np.column_stack([np.interp(time, imu[:, 0], imu[:, c]) for c in range(1, 7)])
    return Window(time, mag[rows, 1:4] + added, motion[:, :3], motion[:, 3:])


@functools.cache
def whole_turn():
    """The hand-held recording with iron added, and its up at each sample."""
    imu, mag, _ = recording("broad05")
    whole = window(imu, mag, added=TestHandHeldTurn.added)
    return whole, propagated_up(whole)


class TestHandHeldTurn:
    """A turn by hand that wobbles to 20 degrees, with motion-capture truth."""

    added = np.array([20e-6, -15e-6, 12e-6])
    bias = np.array([-0.14e-6, 0.20e-6, 0.39e-6])
    knowledge = Knowledge(
        ReferenceField(Belief(44.3e-6, 1.3e-6), Belief(math.radians(69.6), math.radians(1.0)))
    )

    def heading_rms(self, correction):
        truth = recording("broad05")[2]
        whole, up = whole_turn()
        w, x, y, z = (np.interp(whole.time, truth[:, 0], truth[:, c]) for c in (2, 3, 4, 5))
        yaw = np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))
        tilt = np.arccos(np.clip(1 - 2 * (x * x + y * y), -1, 1))
        scored = (tilt < math.radians(45)) & ((whole.time < 48.0) | (whole.time > 62.0))
        found = yaw_from_up_and_field(up, correction.apply(whole.field))
        return math.sqrt(np.mean(wrap_angle(found - yaw)[scored] ** 2))

    @pytest.mark.nightly
    def test_hard_iron(self, correction):
        error = correction.hard_iron - self.bias - self.added
        assert np.linalg.norm(error) < 2e-6

    @pytest.mark.nightly
    def test_heading_on_the_rest_of_the_recording(self, correction):
        best = self.heading_rms(Correction(np.eye(3), self.bias + self.added))
        assert self.heading_rms(correction) < best


@pytest.fixture(scope="module")
def correction():
    imu, mag, _ = recording("broad05")
    turn = window(imu, mag, 48.0, 62.0, TestHandHeldTurn.added)
    return fit(turn, TestHandHeldTurn.knowledge).correction


@pytest.mark.nightly
def test_a_car_in_circles_agrees_with_its_gps_course():
    imu, mag, truth = recording("car_circles_neu2025_kiran")
    whole = window(imu, mag)
    reference = ReferenceField(
        Belief(51.5e-6, 1.5e-6), Belief(math.radians(66.5), math.radians(1.0))
    )
    estimate = fit(whole, Knowledge(reference))
    yaw = yaw_from_up_and_field(propagated_up(whole), estimate.correction.apply(whole.field))
    moving = truth[truth[:, 2] > 2.0]
    errors = []
    for lag in np.arange(-2.0, 2.01, 0.05):
        time = moving[:, 0] + lag
        inside = (time > whole.time[0]) & (time < whole.time[-1])
        gap = np.interp(time[inside], whole.time, np.unwrap(yaw)) - moving[inside, 1]
        gap = wrap_angle(gap - np.angle(np.mean(np.exp(1j * gap))))
        errors.append(float(np.std(gap)))
    assert min(errors) < math.radians(2.8)
