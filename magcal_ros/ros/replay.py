"""Plays a recorded drive on the two sensor topics."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from magcal_ros.core.samples.streams import FieldSample, ImuSample
from magcal_ros.files.recording import Recording
from magcal_ros.files.sources import FIRST_STAMP
from magcal_ros.ros.sensor_source import SensorSource, set_time


def replay(
    node: Node,
    source: SensorSource,
    recording: Recording,
    rate: float,
    between: Callable[[float], None],
    clock: bool = False,
) -> int:
    """Publish a recording under its own stamps, in its own time or faster.

    Parameters
    ----------
    node : rclpy.node.Node
        Publishes the clock.
    source : SensorSource
        Publishes the samples.
    recording : Recording
        What was recorded.
    rate : float
        How many times faster than it was recorded.
    between : callable
        Called with the seconds to wait before the next sample; may spin or sleep.
    clock : bool
        Whether to publish /clock for nodes that run on simulated time.

    Returns
    -------
    int
        Number of samples published.
    """
    clock_out = node.create_publisher(Clock, "/clock", 10) if clock else None
    shift = max(0.0, FIRST_STAMP - float(min(recording.imu[0, 0], recording.field[0, 0])))
    started: float | None = None
    count = 0
    for sample in recording.samples():
        moved = _moved(sample, shift)
        if started is None:
            started = time.monotonic() - moved.stamp / rate
        between(max(0.0, started + moved.stamp / rate - time.monotonic()))
        if clock_out is not None:
            clock_out.publish(_clock(moved.stamp))
        source.publish(moved)
        count += 1
    return count


def _moved(sample: ImuSample | FieldSample, shift: float) -> ImuSample | FieldSample:
    return sample._replace(stamp=sample.stamp + shift) if shift else sample


def _clock(stamp: float) -> Clock:
    message = Clock()
    set_time(message.clock, stamp)
    return message
