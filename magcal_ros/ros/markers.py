"""The turn in RViz and Foxglove: samples, circle, missing arc and axis, one metre for 50 µT."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

import numpy as np
from geometry_msgs.msg import Point
from rclpy.node import Node
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from magcal_ros.core.calibration.estimate import Estimate
from magcal_ros.core.errors import Refusal
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.geometry.circle3d import Circle, fit_circle_in_space
from magcal_ros.core.samples.window import Window
from magcal_ros.core.session.turn_events import TurnState
from magcal_ros.ros.control import Control
from magcal_ros.ros.outputs import LATCHED

METRES_PER_TESLA = 1.0 / 50e-6
MOST_POINTS = 400
SMALLEST_GAP = np.radians(12.0)
POINT_SIZE = 0.02
LINE_WIDTH = 0.01

RAW = (0.90, 0.38, 0.0)
CORRECTED = (0.0, 0.45, 0.70)
CIRCLE = (0.35, 0.70, 0.90)
MISSING = (0.80, 0.10, 0.10)
AXIS = (0.3, 0.3, 0.3)


class TurnMarkers:
    """Publishes the drawing of a turn, once for each window of it."""

    def __init__(self, node: Node) -> None:
        self._out = node.create_publisher(MarkerArray, "~/markers", LATCHED)
        self._drawn: Window | None = None

    def draw(self, control: Control, to_body: FloatArray, frame: str) -> None:
        """Draw the window of the moment; a turn under way has a new one with each preview."""
        window = control.turn.last_window
        if window is None or window is self._drawn:
            return
        idle, outcome = control.state is TurnState.IDLE, control.turn.last_outcome
        if not idle and not self._out.get_subscription_count():
            return
        if idle or control.state is TurnState.COLLECTING:
            estimate = outcome.estimate if idle and outcome is not None else None
            self._out.publish(turn_markers(window, to_body, estimate, frame))
            self._drawn = window


def turn_markers(
    window: Window, to_body: FloatArray, estimate: Estimate | None, frame: str
) -> MarkerArray:
    """Draw a turn under way (without an estimate), or a fitted one.

    `to_body` (3, 3) turns the magnetometer's axes to nominal body axes; all is in the IMU's frame.

    Returns
    -------
    MarkerArray
        Replaces what was drawn before.
    """
    every = max(1, len(window) // MOST_POINTS)
    raw = window.field @ to_body.T
    up = unit(window.specific_force.mean(axis=0))
    drawn = [_marker("raw", Marker.POINTS, RAW, raw[::every], POINT_SIZE, POINT_SIZE)]
    shown = raw
    if estimate is not None:
        shown = estimate.correction.apply(window.field)
        points = shown[::every]
        drawn.append(_marker("corrected", Marker.POINTS, CORRECTED, points, POINT_SIZE, POINT_SIZE))
        up = estimate.axis
    # A robot that has not turned yet draws no circle.
    with contextlib.suppress(Refusal):
        drawn += _circle(fit_circle_in_space(shown, up), shown)
    ends = np.stack([np.zeros(3), up]) / METRES_PER_TESLA
    drawn.append(_marker("axis", Marker.ARROW, AXIS, ends, 0.02, 0.05))
    array = MarkerArray(markers=[Marker(action=Marker.DELETEALL), *drawn])
    for marker in array.markers:
        marker.header.frame_id = frame
    return array


def _circle(circle: Circle, points: FloatArray) -> list[Marker]:
    around = np.linspace(0.0, 2.0 * np.pi, 73)
    drawn = [_marker("circle", Marker.LINE_STRIP, CIRCLE, circle.at(around), LINE_WIDTH)]
    phases = np.sort(circle.phase(points))
    gaps = np.diff(np.append(phases, phases[0] + 2.0 * np.pi))
    widest = int(np.argmax(gaps))
    if gaps[widest] > SMALLEST_GAP:
        hole = phases[widest] + np.linspace(0.0, gaps[widest], 37)
        width = 3.0 * LINE_WIDTH
        drawn.append(_marker("missing", Marker.LINE_STRIP, MISSING, circle.at(hole), width))
    return drawn


def _marker(
    name: str,
    kind: int,
    colour: Sequence[float],
    field: FloatArray,
    width: float,
    height: float = 0.0,
) -> Marker:
    """Draw points of the field; what width and height are of depends on the kind."""
    marker = Marker(ns=name, type=kind, action=Marker.ADD)
    marker.pose.orientation.w = 1.0
    marker.scale.x, marker.scale.y = width, height
    red, green, blue = colour
    marker.color = ColorRGBA(r=red, g=green, b=blue, a=1.0)
    marker.points = [Point(x=x, y=y, z=z) for x, y, z in (field * METRES_PER_TESLA).tolist()]
    return marker
