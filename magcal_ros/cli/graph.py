"""Joining the ROS graph from a command, with a plain word when that is not possible."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from typing import TYPE_CHECKING, TypeAlias

from magcal_ros.core.errors import MagcalError

if TYPE_CHECKING:
    from rclpy.node import Node

    Joined: TypeAlias = Node


class NoRos(MagcalError):
    """rclpy cannot be imported."""


@contextlib.contextmanager
def joined(name: str, ros_arguments: list[str] | None = None) -> Iterator[Joined]:
    """Yield a node of this name, and leave the graph afterwards.

    Raises
    ------
    NoRos
        If there is no rclpy.
    """
    try:
        import rclpy
        from rclpy.signals import SignalHandlerOptions
    except ImportError as error:
        raise NoRos(
            "this command needs ROS: source your ROS installation, "
            f"or install the extra: pip install 'magcal_ros[ros]' ({error})"
        ) from error
    # With rclpy's own handler the context is gone before Ctrl-C can cancel anything.
    rclpy.init(args=ros_arguments, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(name)
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def keep_traffic_here() -> None:
    """Keep DDS on this machine, in a domain of its own, unless the user chose otherwise."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(100 + os.getpid() % 100))
