"""The markers of a turn for RViz."""

import math

import numpy as np
import pytest
from support import REFERENCE
from visualization_msgs.msg import Marker, MarkerArray

from magcal_ros.ros.sensor_frames import LATCHED


def drawn(array):
    return {m.ns: m for m in array.markers if m.action == Marker.ADD}


def as_array(points):
    return np.array([[p.x, p.y, p.z] for p in points])


@pytest.mark.nightly
def test_a_finished_turn_is_drawn_in_the_imus_frame_at_a_readable_scale(stage):
    actor = stage()
    assert actor.calibrate().success
    received = []
    actor.node.create_subscription(MarkerArray, "/calibrator/markers", received.append, LATCHED)
    actor.run(1.0)
    parts = drawn(received[-1])
    assert {"raw", "corrected", "circle", "axis"} <= set(parts)
    assert {marker.header.frame_id for marker in received[-1].markers} == {"imu_link"}
    level = actor.robot.strength * math.cos(actor.robot.inclination) / 50e-6
    corrected = as_array(parts["corrected"].points)
    assert np.allclose(np.hypot(corrected[:, 0], corrected[:, 1]).mean(), level, rtol=0.05)
    circle = as_array(parts["circle"].points)
    assert np.allclose(np.hypot(circle[:, 0], circle[:, 1]), level, rtol=0.03)
    assert np.linalg.norm(as_array(parts["raw"].points).mean(0) - corrected.mean(0)) > 0.1
    assert np.allclose(as_array(parts["axis"].points)[1], [0.0, 0.0, 1.0], atol=0.02)


@pytest.mark.nightly
def test_an_active_turn_shows_the_missing_arc(stage):
    actor = stage(parameters={**REFERENCE, "window.timeout_s": 30.0})
    received = []
    actor.node.create_subscription(MarkerArray, "/calibrator/markers", received.append, LATCHED)
    future = actor.call("calibrate")
    actor.run(math.radians(230.0) / 0.5 / actor.speed, 0.5)
    # Standing, until a preview has seen all of it.
    actor.run(2.5)
    parts = drawn(received[-1])
    assert "corrected" not in parts
    missing = as_array(parts["missing"].points)
    centre = as_array(parts["circle"].points).mean(axis=0)
    first, last = missing[0] - centre, missing[-1] - centre
    hole = math.degrees(math.acos(first @ last / np.linalg.norm(first) / np.linalg.norm(last)))
    assert abs(hole - 130.0) < 15.0
    actor.answer(actor.call("cancel"))
    assert not actor.answer(future).success
