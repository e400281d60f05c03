"""Iron added to a recorded city drive is reported; skipped without the recordings."""

import math

import numpy as np
import pytest
from recorded_truth import in_force, read_drive

from magcal_ros.core.samples import FieldSample
from magcal_ros.core.self_calibration import DecisionKind, Mode, SelfCalibration, replay_drive

CAME, TOLD_WITHIN = 120.0, 60.0
LOOK = 1.0
"""Seconds for the look that falls on the end of that minute."""


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("size", "way", "lasts"),
    [
        *((10e-6, 0.125 * math.pi * sixteenth, math.inf) for sixteenth in range(16)),
        (27e-6, 0.0, 50.0),
        (0.0, 0.0, 0.0),
    ],
)
def test_iron_on_a_city_drive_is_reported_within_a_minute(recording, size, way, lasts):
    drive = read_drive(recording("car_drive_neu2022_rahul"), None)
    initial, _ = next(in_force(drive))
    iron = size * np.array([math.cos(way), math.sin(way), 0.0])
    first = drive.everything.time[0]
    replay = replay_drive(
        drive.knowledge,
        initial,
        (
            each._replace(field=tuple(np.add(each.field, iron).tolist()))
            if isinstance(each, FieldSample) and CAME < each.stamp - first < CAME + lasts
            else each
            for each in drive.recording.samples()
            if each.stamp - first < CAME + TOLD_WITHIN + LOOK
        ),
        (),
    )
    reported = [at for at, made in replay.decisions if made.kind is DecisionKind.NOTICED]
    assert bool(reported) == bool(size)
    assert all(at > CAME for at in reported)


class FollowedWatch(SelfCalibration):
    """Makes no decision, and keeps whether the calibration in force was stale."""

    def __init__(self):
        super().__init__(Mode.PROPOSE)
        self.states = []

    def note(self, findings):
        super().note(findings)
        self.states.append(self.watch.is_stale)
        return []


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["car_drive_neu2022_rahul", "car_neu2023_ampomah"])
@pytest.mark.parametrize("share", [0.0, 0.4])
def test_a_calibration_holds_on_a_recorded_drive_until_iron_is_added(recording, name, share):
    drive = read_drive(recording(name), None)
    initial, _ = next(in_force(drive))
    level = initial.strength * math.cos(initial.inclination)
    iron, middle = (
        share * level * np.array([0.54, 0.84, 0.0]),
        np.mean(drive.everything.time[[0, -1]]),
    )
    samples = (
        each._replace(field=tuple(np.add(each.field, iron).tolist()))
        if isinstance(each, FieldSample) and each.stamp > middle
        else each
        for each in drive.recording.samples()
    )
    machine = FollowedWatch()
    replay_drive(drive.knowledge, initial, samples, (), machine)
    assert machine.watch.findings
    assert machine.states[-1] == bool(share)
    assert any(machine.states) == bool(share)
