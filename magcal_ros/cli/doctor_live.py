"""The guided half minute of `magcal doctor`: instructions, progress, and the examination."""

from __future__ import annotations

import argparse
import math
import select
import sys
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from magcal_ros.cli.common import reference_in_use
from magcal_ros.cli.live_view import interrupts_noted, joined
from magcal_ros.cli.recorded import mounting_from
from magcal_ros.core.doctor.blame import UserAnswers
from magcal_ros.core.doctor.guide import ASKED, Guide, GuideStepState
from magcal_ros.core.doctor.health import Finding, looked_at, not_shown, wrong
from magcal_ros.core.doctor.page import Page
from magcal_ros.core.errors import MagcalError
from magcal_ros.core.geometry.frame_tree import pose_in_words
from magcal_ros.core.geometry.rotations import rotation_from_rpy
from magcal_ros.core.knowledge import Knowledge, Mounting
from magcal_ros.core.samples.streams import FieldSample, ImuSample
from magcal_ros.core.samples.window import SensorLog

if TYPE_CHECKING:
    from rclpy.node import Node

    from magcal_ros.ros.preflight import Listener

SILENT_AFTER = 8.0
"""Seconds within which both sensors must have said something."""

DISCOVERY = 3.0
"""Seconds in which topics are looked for."""

MISLEADING = (
    "axes",
    "field_axes",
    "gyro_axes",
    "force_axes",
    "nothing_fits",
    "imu_axes",
    "gravity_sign",
)
"""Lines with which nothing can be said of the description."""

CROWD = (
    "only one node can be the sensor: stop the others, or give one of them a name of its own; two "
    "that take turns look like a field that jumps"
)


@dataclass(frozen=True, eq=False)
class Heard:
    """What the guided half minute brought."""

    log: SensorLog
    """All samples."""
    knowledge: Knowledge
    """What the user gave, and how the robot's description says the magnetometer sits."""
    answers: UserAnswers
    """What the person was seen to do."""
    more: tuple[Finding, ...]
    """What the graph shows beside the samples."""
    described: str
    """The described pose in words; empty where none was used."""

    def page_with(self, page: Page) -> Page:
        """Return the page with what the graph shows, and the description against the measured."""
        if not self.described:
            return page.with_more(self.more)
        told = f"magnetometer at {self.described}"
        if page.mount_rpy_deg is not None:
            radians = " ".join(f"{math.radians(angle):.4g}" for angle in page.mount_rpy_deg)
            line = wrong(
                "description",
                "description",
                f"{told}, measured otherwise",
                f'set rpy="{radians}" in the URDF joint between IMU and magnetometer',
            )
        elif any(f.key in MISLEADING and f.is_wrong for f in page.findings):
            line = not_shown("description", "description", f"{told}; correct the axes first")
        else:
            line = looked_at("description", "description", told)
        return page.with_more((*self.more, line))


def listen(options: argparse.Namespace) -> Heard:
    """Guide a person through the half minute and gather what the sensors say.

    Raises
    ------
    MagcalError
        If a sensor is not there or says nothing.
    """
    with joined("magcal_doctor", []) as node:
        from rclpy.executors import SingleThreadedExecutor

        from magcal_ros.ros.preflight import Listener

        topics = _topics(node, options)
        samples: list[ImuSample | FieldSample] = []
        guide = Guide(time.monotonic())

        def take(sample: ImuSample | FieldSample) -> None:
            samples.append(sample)
            guide.add(sample)

        listener = Listener(node, *topics, take)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        begin = time.monotonic()
        say(f"Listening to {topics[0]} and {topics[1]}. The Enter key skips a step.")
        asking = Asking()
        with interrupts_noted() as interrupted:
            while guide.current is not None and not interrupted.is_set():
                executor.spin_once(timeout_sec=0.02)
                now = time.monotonic()
                asking.count_down(guide, now)
                if asking.is_skipped():
                    before = guide.current
                    guide.skip(now)
                    if guide.current is not before:
                        asking.tick(guide)
                if guide.pass_time(now):
                    asking.tick(guide)
                if now - begin > SILENT_AFTER and not all(listener.heard):
                    raise MagcalError(_silence(listener))
        if interrupted.is_set():
            raise KeyboardInterrupt
        return gathered(options, listener, samples, guide)


def say(line: str) -> None:
    """Tell the person what to do; the page alone goes to standard output."""
    print(line, file=sys.stderr, flush=True)


def _topics(node: Node, options: argparse.Namespace) -> tuple[str, str]:
    from magcal_ros.ros.preflight import FIELD_TYPE, IMU_TYPE, sensor_topic

    deadline = time.monotonic() + DISCOVERY
    while True:
        try:
            return (
                sensor_topic(node, IMU_TYPE, options.imu, "--imu"),
                sensor_topic(node, FIELD_TYPE, options.mag, "--mag"),
            )
        except MagcalError:
            if time.monotonic() > deadline:
                raise
        time.sleep(0.1)


class Asking:
    """Says what is asked for and for how long yet, and hears the Enter key, where a person sits."""

    def __init__(self) -> None:
        self._rewrites = sys.stderr.isatty()
        self._keys = sys.stdin is not None and sys.stdin.isatty()
        self._shown = ""

    def count_down(self, guide: Guide, now: float) -> None:
        """Show what is asked for, and the seconds that are left."""
        if guide.current is None:
            return
        line = f"  [ ] {ASKED[guide.current]}"
        if self._rewrites:
            line += f" ({guide.left(now):.0f} s left)"
        if line == self._shown:
            return
        self._shown = line
        if self._rewrites:
            print(f"\r{line}\033[K", end="", file=sys.stderr, flush=True)
        else:
            say(line)

    def is_skipped(self) -> bool:
        """Return whether the Enter key was pressed."""
        if not self._keys or not select.select([sys.stdin], [], [], 0.0)[0]:
            return False
        # An end of the input is no key, and would be heard for ever.
        self._keys = bool(sys.stdin.readline())
        return self._keys

    def tick(self, guide: Guide) -> None:
        """Tell what was seen of what was asked for."""
        done = [
            s
            for s, state in guide.states.items()
            if state in (GuideStepState.SEEN, GuideStepState.MISSED)
        ]
        seen = guide.states[done[-1]] is GuideStepState.SEEN
        over = "\r\033[K" if self._rewrites else ""
        say(f"{over}  [{'x' if seen else '-'}] {ASKED[done[-1]]}{'' if seen else ': not seen'}")
        self._shown = ""


def _silence(listener: Listener) -> str:
    silent = [t for t, count in zip(listener.topics, listener.heard, strict=True) if not count]
    return (
        f"nothing arrives on {' and '.join(silent)}: is the driver running, is the clock paused? "
        "Choose other topics with --imu and --mag"
    )


def gathered(
    options: argparse.Namespace,
    listener: Listener,
    samples: list[ImuSample | FieldSample],
    guide: Guide,
) -> Heard:
    """Return what was heard, with what the graph and the user say beside it."""
    log = SensorLog.of(samples)
    newest = float(log.field_time[-1]) if len(log.field_time) else 0.0
    reference = reference_in_use(options, None, newest)
    mounting, described = mounting_from(options), ""
    pose = listener.described_pose
    if pose is not None:
        described = pose_in_words(pose)
        given = rotation_from_rpy(*(math.radians(angle) for angle in options.mount_rpy_deg))
        if np.array_equal(given, np.eye(3)):
            mounting = Mounting(mounting.gains, pose)
        else:
            described = ""
    more = [looked_at("reference", "reference", words, words) for words in reference.complaints]
    more += [wrong("publishers", "publishers", words, CROWD) for words in listener.crowded]
    answers = UserAnswers(guide.turned_left)
    return Heard(log, Knowledge(reference.field, mounting), answers, tuple(more), described)
