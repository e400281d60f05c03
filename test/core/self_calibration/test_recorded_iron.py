"""Iron added to a recorded city drive is reported; skipped without the recordings."""

import math

import numpy as np
import pytest
from recorded_truth import in_force, read_drive

from magcal_ros.core.samples import FieldSample
from magcal_ros.core.self_calibration import DecisionKind, replay_drive

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
