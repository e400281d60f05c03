"""Which calibrator nodes are running, and which of them is meant."""

from __future__ import annotations

import argparse
import re
import time
from typing import Any

from magcal_ros.core.errors import MagcalError, Misuse
from magcal_ros.files.plain import plain

PATIENCE = 5.0
"""Seconds within which a running node is discovered."""

SETTLE = 1.0
"""Seconds after the first one in which another may be discovered."""

LONGEST_NAME = 255
"""Characters of a full name that the middleware takes."""

NAME = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(?:/[A-Za-z_][A-Za-z0-9_]*)*")
SIGNS = ("calibrate", "finish", "accept")
"""Services, all Trigger, that together make a calibrator."""

TRIGGER = "std_srvs/srv/Trigger"


def node_name(text: str) -> str:
    """Return the full name of a node as typed on the command line, with its first slash."""
    if not NAME.fullmatch(text) or len(text) > LONGEST_NAME:
        raise argparse.ArgumentTypeError(
            f"{plain(text, 60)!r} is no name of a node: letters, digits and _, as in "
            "/robot1/calibrator"
        )
    return "/" + text.lstrip("/")


def find_calibrator(node: Any, wanted: str | None) -> str:
    """Return the full name of the calibrator that is meant.

    Parameters
    ----------
    node : rclpy.node.Node
        Looks around.
    wanted : str or None
        Full name; None for the only one there is.

    Raises
    ------
    Misuse
        If there are several and none is named.
    MagcalError
        If it is not there; the text lists those that are.
    """
    begin = first_seen = time.monotonic()
    seen: list[str] = []
    while True:
        now = time.monotonic()
        found = calibrators(node)
        first_seen = first_seen if seen else now
        seen = found
        if wanted in seen or (not wanted and seen and now - first_seen >= SETTLE):
            break
        if now - begin >= PATIENCE:
            break
        time.sleep(0.1)
    if wanted is not None and wanted in seen:
        return wanted
    listed = ", ".join(map(plain, seen))
    if wanted is not None:
        others = f"calibrators that are seen: {listed}" if seen else "no calibrator is seen"
        raise MagcalError(
            f"the node {wanted} is not there; {others}. Start it with "
            "`ros2 run magcal_ros calibrator`, or name another with --node"
        )
    if len(seen) == 1:
        return seen[0]
    if seen:
        raise Misuse(f"{len(seen)} calibrators are seen: {listed}; choose one with --node")
    raise MagcalError(
        "no calibrator is seen: start it with `ros2 run magcal_ros calibrator`. If it runs, look "
        "at ROS_DOMAIN_ID and at the discovery range on both sides"
    )


def calibrators(node: Any) -> list[str]:
    """Return the full names of the calibrators that are seen now."""
    found: dict[str, set[str]] = {}
    for service, types in node.get_service_names_and_types():
        owner, _, name = service.rpartition("/")
        if name in SIGNS and TRIGGER in types:
            found.setdefault(owner, set()).add(name)
    return sorted(owner for owner, names in found.items() if len(names) == len(SIGNS))
