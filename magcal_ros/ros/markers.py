"""The turn in RViz and Foxglove: samples, circle, missing arc and axis, one metre for 50 µT."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

import numpy as np
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from magcal_ros.core.calibration.estimate import Estimate
from magcal_ros.core.errors import Refusal
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.geometry.circle3d import Circle, fit_circle_in_space
from magcal_ros.core.samples.window import Window

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


def turn_markers(
    window: Window, to_body: FloatArray, estimate: Estimate | None, frame: str
) -> MarkerArray:
    """Draw a turn under way, or a fitted one.

    Parameters
    ----------
    window : Window
        The samples.
    to_body : ndarray, shape (3, 3)
        From the magnetometer's axes to nominal body axes.
    estimate : Estimate or None
        What was found; None while the turn is under way.
    frame : str
        The IMU's frame, in which everything is drawn.

    Returns
    -------
    MarkerArray
        Replaces what was drawn before.
    """
    every = max(1, len(window) // MOST_POINTS)
    raw = window.field @ to_body.T
    up = unit(window.specific_force.mean(axis=0))
    drawn = [_points("raw", raw[::every], RAW)]
    shown = raw
    if estimate is not None:
        shown = estimate.correction.apply(window.field)
        drawn.append(_points("corrected", shown[::every], CORRECTED))
        up = estimate.axis
    # A robot that has not turned yet draws no circle.
    with contextlib.suppress(Refusal):
        drawn += _circle(fit_circle_in_space(shown, up), shown)
    drawn.append(_arrow("axis", up, AXIS))
    array = MarkerArray(markers=[Marker(action=Marker.DELETEALL), *drawn])
    for marker in array.markers:
        marker.header.frame_id = frame
    return array


def _circle(circle: Circle, points: FloatArray) -> list[Marker]:
    around = np.linspace(0.0, 2.0 * np.pi, 73)
    drawn = [_line("circle", circle.at(around), CIRCLE)]
    phases = np.sort(circle.phase(points))
    gaps = np.diff(np.append(phases, phases[0] + 2.0 * np.pi))
    widest = int(np.argmax(gaps))
    if gaps[widest] > SMALLEST_GAP:
        hole = phases[widest] + np.linspace(0.0, gaps[widest], 37)
        drawn.append(_line("missing", circle.at(hole), MISSING, 3.0 * LINE_WIDTH))
    return drawn


def _points(name: str, field: FloatArray, colour: Sequence[float]) -> Marker:
    marker = _marker(name, Marker.POINTS, colour)
    marker.scale.x = marker.scale.y = POINT_SIZE
    marker.points = _scaled(field)
    return marker


def _line(
    name: str, field: FloatArray, colour: Sequence[float], width: float = LINE_WIDTH
) -> Marker:
    marker = _marker(name, Marker.LINE_STRIP, colour)
    marker.scale.x = width
    marker.points = _scaled(field)
    return marker


def _arrow(name: str, direction: FloatArray, colour: Sequence[float]) -> Marker:
    marker = _marker(name, Marker.ARROW, colour)
    marker.scale.x, marker.scale.y = 0.02, 0.05
    marker.points = _scaled(np.stack([np.zeros(3), direction]) / METRES_PER_TESLA)
    return marker


def _marker(name: str, kind: int, colour: Sequence[float]) -> Marker:
    marker = Marker(ns=name, type=kind, action=Marker.ADD)
    marker.pose.orientation.w = 1.0
    red, green, blue = colour
    marker.color = ColorRGBA(r=red, g=green, b=blue, a=1.0)
    return marker


def _scaled(field: FloatArray) -> list[Point]:
    return [Point(x=x, y=y, z=z) for x, y, z in (field * METRES_PER_TESLA).tolist()]
