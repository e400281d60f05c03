"""`magcal calibrate`: a calibration turn of a running node, controlled from the terminal."""

from __future__ import annotations

import argparse
import re
import time
from typing import Any

from magcal_ros.cli import live_view
from magcal_ros.cli.common import Exit, command, tell
from magcal_ros.core.errors import MagcalError, UsageError
from magcal_ros.files.disk import printable

PATIENCE = 5.0  # longest wait for a node, its service or its status with discovery, seconds
SETTLE = 1.0  # seconds to wait for further calibrators after the first
LONGEST_NAME = 255  # characters of a full name that the middleware accepts

NAME = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(?:/[A-Za-z_][A-Za-z0-9_]*)*")
CALIBRATOR_SERVICES = ("calibrate", "finish", "accept")
"""Services of type Trigger by which a calibrator is recognised."""


def node_name(text: str) -> str:
    """Return a node's name from the command line with a leading slash."""
    if not NAME.fullmatch(text) or len(text) > LONGEST_NAME:
        raise argparse.ArgumentTypeError(
            f"{printable(text, 60)!r} is not the name of a node: use letters, digits and _, as in "
            "/robot1/calibrator"
        )
    return "/" + text.lstrip("/")


def find_calibrator(node: Any, wanted: str | None) -> str:
    """Return the full name of the wanted calibrator, or of the only one.

    Raises UsageError if there are several and `wanted` is None, MagcalError if none is found.
    """
    found, deadline = calibrators(node), time.monotonic() + PATIENCE
    while not (found if wanted is None else wanted in found) and time.monotonic() < deadline:
        time.sleep(0.1)
        found = calibrators(node)
    if wanted in found:
        return wanted
    if wanted is None and found:
        time.sleep(SETTLE)
        found = calibrators(node)
    listed = ", ".join(map(printable, found))
    if wanted is not None:
        others = f"calibrators found: {listed}" if found else "no calibrator was found"
        raise MagcalError(
            f"the node {wanted} was not found; {others}. Start it with `ros2 run magcal_ros "
            "calibrator`, or name another with --node"
        )
    if len(found) == 1:
        return found[0]
    if found:
        raise UsageError(f"{len(found)} calibrators were found: {listed}; choose one with --node")
    raise MagcalError(
        "no calibrator was found: start it with `ros2 run magcal_ros calibrator`. If it runs, "
        "check that ROS_DOMAIN_ID and the discovery range are the same on both sides"
    )


def calibrators(node: Any) -> list[str]:
    """Return the full names of the discovered calibrators."""
    found: dict[str, set[str]] = {}
    for service, types in node.get_service_names_and_types():
        owner, _, name = service.rpartition("/")
        if name in CALIBRATOR_SERVICES and "std_srvs/srv/Trigger" in types:
            found.setdefault(owner, set()).add(name)
    return sorted(owner for owner, names in found.items() if len(names) == len(CALIBRATOR_SERVICES))


LONGEST_ANSWER = 5000  # characters of the node's answer that are printed

SILENT_AFTER = 6.0
"""Seconds without status and diagnostics after which a node counts as ended; they are published
every second."""

CANCEL_WITHIN = 1.0  # longest wait for the answer of ~/cancel, seconds
STATUS_DELAY = 0.5  # longest delay of the status after the answer, seconds


def add_calibrate(commands: Any) -> None:
    """Add the command's arguments."""
    parser = command(commands, "calibrate", run, "calibrate a running node, with a live view")
    parser.add_argument(
        "--node",
        type=node_name,
        help="full name of the node (default: the only calibrator that is found)",
    )
    parser.add_argument(
        "--skip-preflight", action="store_true", help="do not check the sensors first"
    )


def run(options: argparse.Namespace) -> int:
    """Check the sensors, call ~/calibrate of a running calibrator node and show the turn.

    Ctrl-C cancels the turn.
    """
    with live_view.joined("magcal_calibrate", []) as node:
        from magcal_ros.ros.preflight import inspect

        calibrator = find_calibrator(node, options.node)

        if not options.skip_preflight:
            findings = inspect(node, calibrator)
            tell("\n".join(findings.lines))
            if not findings.ready:
                return Exit.TOO_LITTLE_DATA
        turn = _Turn(node, calibrator)
        answer = turn.run(live_view.best_view())
        message = turn.in_full(answer.message)
    tell(f"\n{message}")
    return Exit.GOOD if answer.success else Exit.REFUSED


class _Turn:
    """Calls ~/calibrate and follows ~/status until the service answers."""

    def __init__(self, node: Any, calibrator: str) -> None:
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from std_msgs.msg import String
        from std_srvs.srv import Trigger

        from magcal_ros.ros.sensor_frames import LATCHED

        self._calibrator = calibrator
        self._status: dict[str, Any] = {}
        self._received_at: float | None = None
        self._executor = rclpy.executors.SingleThreadedExecutor()
        self._executor.add_node(node)
        node.create_subscription(String, f"{calibrator}/status", self._on_status, LATCHED)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self._clients = {
            name: node.create_client(Trigger, f"{calibrator}/{name}")
            for name in ("calibrate", "cancel")
        }
        self._request = Trigger.Request()

    def run(self, view: live_view.ProgressLines) -> Any:
        self._warn_if_it_moves()
        if not self._clients["calibrate"].wait_for_service(timeout_sec=PATIENCE):
            raise MagcalError(
                f"{self._calibrator}/calibrate does not answer: is the node running? "
                "Start it with `ros2 run magcal_ros calibrator`, or name it with --node"
            )
        future = self._clients["calibrate"].call_async(self._request)
        with live_view.interrupts_noted() as interrupted:
            with view:
                while not future.done() and not interrupted.is_set():
                    self._executor.spin_once(timeout_sec=0.1)
                    if (progress := live_view.progress_of(self._status)) is not None:
                        view.show(progress)
                    self._require_life()
            if future.done():
                return future.result()
            print("\ncancelling", flush=True)
            if self._clients["cancel"].service_is_ready():
                cancelled = self._clients["cancel"].call_async(self._request)
                self._executor.spin_until_future_complete(cancelled, timeout_sec=CANCEL_WITHIN)
        raise KeyboardInterrupt

    def in_full(self, answer: str) -> str:
        """Return the node's answer with all reasons, which the status has a little later."""
        short = printable(answer, LONGEST_ANSWER)
        deadline = time.monotonic() + STATUS_DELAY
        while True:
            message = live_view.with_all_reasons(short, self._status)
            if message != short or time.monotonic() > deadline:
                return message
            self._executor.spin_once(timeout_sec=0.1)

    def _warn_if_it_moves(self) -> None:
        deadline = time.monotonic() + PATIENCE
        while not self._status and time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=0.1)
        if not self._status:
            unknown = "if the parameter rotate.enabled is true, which is not known"
            print(f"The robot will turn itself {unknown}: keep clear.", flush=True)
        elif self._status.get("turns_itself") is True:
            print("The robot will turn itself, once each way: keep clear.", flush=True)

    def _require_life(self) -> None:
        """Raise MagcalError if the node has ended, which the middleware reports late or never."""
        if self._received_at is not None and time.monotonic() - self._received_at > SILENT_AFTER:
            raise MagcalError(
                f"{self._calibrator} has been silent for {SILENT_AFTER:.0f} s: the node has ended "
                "or hangs, and the turn is lost. Start the node again, and calibrate again"
            )

    def _on_status(self, message: Any) -> None:
        self._received_at = time.monotonic()
        self._status = live_view.status_of(message.data)

    def _on_diagnostics(self, message: Any) -> None:
        begin = f"{self._calibrator.lstrip('/')}: "
        if any(status.name.startswith(begin) for status in message.status):
            self._received_at = time.monotonic()
