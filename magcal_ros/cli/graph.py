"""Joining the ROS graph from a command, with a clear error where that is not possible."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING

from magcal_ros.core.errors import MagcalError, Misuse
from magcal_ros.files.plain import plain

if TYPE_CHECKING:
    from rclpy.node import Node

LONGEST_ERROR = 500


class NoRos(MagcalError):
    """rclpy cannot be imported."""


@contextlib.contextmanager
def joined(name: str, ros_arguments: list[str] | None = None) -> Iterator[Node]:
    """Yield a node of this name, and leave the graph afterwards.

    Raises
    ------
    NoRos
        If there is no rclpy.
    Misuse
        If ROS refuses the arguments or the environment.
    """
    try:
        import rclpy
        from rclpy.signals import SignalHandlerOptions
    except ImportError as error:
        raise NoRos(
            "this command needs ROS: source its setup file, or work in the environment that "
            f"`make demo` sets up in a checkout ({error})"
        ) from error
    # With rclpy's own handler the context is gone before Ctrl-C can cancel anything.
    try:
        rclpy.init(args=ros_arguments, signal_handler_options=SignalHandlerOptions.NO)
        node = rclpy.create_node(name)
    except Exception as error:  # rclpy has several roots: arguments, names, the environment
        rclpy.try_shutdown()
        words = plain(" ".join(str(error).split()), LONGEST_ERROR)
        raise Misuse(
            f"ROS does not start: {words}. Look at --ros-args and at ROS_DOMAIN_ID and the other "
            "ROS_ and RMW_ variables"
        ) from error
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def keep_traffic_here() -> None:
    """Keep DDS on this machine, in a domain of its own, unless the user chose otherwise."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if os.environ.get("ROS_DISTRO") == "humble":
        # It does not know the range; newer ones know both, and warn.
        os.environ.setdefault("ROS_LOCALHOST_ONLY", "1")
    os.environ.setdefault("ROS_DOMAIN_ID", str(100 + os.getpid() % 100))


@contextlib.contextmanager
def interrupts_noted() -> Iterator[threading.Event]:
    """Note Ctrl-C instead of raising it wherever the program stands, which may be inside rclpy."""
    noted = threading.Event()
    before = signal.signal(signal.SIGINT, lambda *_: noted.set())
    try:
        yield noted
    finally:
        signal.signal(signal.SIGINT, before)
