"""The guided half minute of `magcal doctor`: it asks, watches, ticks, and looks at what came."""

from __future__ import annotations

import argparse
import math
import sys
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from magcal_ros.cli.graph import interrupts_noted, joined
from magcal_ros.cli.recorded import mounting_from
from magcal_ros.cli.reference import reference_in_use
from magcal_ros.core.doctor.finding import Finding, looked_at, not_shown, wrong
from magcal_ros.core.doctor.guide import ASKED, Guide, GuideStep, GuideStepState
from magcal_ros.core.doctor.page import Page
from magcal_ros.core.doctor.upright import Told
from magcal_ros.core.errors import MagcalError
from magcal_ros.core.geometry.rotations import rotation_from_rpy
from magcal_ros.core.geometry.sensor_poses import pose_in_words
from magcal_ros.core.knowledge import Knowledge, Mounting
from magcal_ros.core.samples.sensor_log import SensorLog
from magcal_ros.core.samples.streams import FieldSample, ImuSample

if TYPE_CHECKING:
    from rclpy.node import Node

    from magcal_ros.ros.listener import Listener

SILENT_AFTER = 8.0
"""Seconds within which both sensors must have said something."""

DISCOVERY = 3.0
"""Seconds in which topics are looked for."""

MISLEADING = ("field_axes", "gyro_axes", "force_axes", "nothing_fits", "imu_axes", "gravity_sign")
"""Lines with which nothing can be said of the description."""

CROWD = (
    "only one node can be the sensor: stop the others, or give one of them a name of its own; two "
    "that take turns look like a field that jumps"
)


@dataclass(frozen=True, eq=False)
class Heard:
    """What the guided half minute brought.

    Parameters
    ----------
    log : SensorLog
        All samples.
    knowledge : Knowledge
        What the user gave, and how the robot's description says the magnetometer sits.
    told : Told
        What the person was seen to do.
    more : tuple of Finding
        What the graph shows beside the samples.
    described : str
        The described pose in words; empty where none was used.
    """

    log: SensorLog
    knowledge: Knowledge
    told: Told
    more: tuple[Finding, ...]
    described: str

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
            line = not_shown("description", "description", f"{told}; mend the axes first")
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

        from magcal_ros.ros.listener import Listener

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
        say(f"Listening to {topics[0]} and {topics[1]}.\n  [ ] {ASKED[GuideStep.STAND]}")
        with interrupts_noted() as interrupted:
            while guide.current is not None and not interrupted.is_set():
                executor.spin_once(timeout_sec=0.02)
                now = time.monotonic()
                if guide.pass_time(now):
                    _tick(guide)
                if now - begin > SILENT_AFTER and not all(listener.heard):
                    raise MagcalError(_silence(listener))
        if interrupted.is_set():
            raise KeyboardInterrupt
        return gathered(options, listener, samples, guide)


def say(line: str) -> None:
    """Tell the person what to do; the page alone goes to standard output."""
    print(line, file=sys.stderr, flush=True)


def _topics(node: Node, options: argparse.Namespace) -> tuple[str, str]:
    from magcal_ros.ros.listener import sensor_topic
    from magcal_ros.ros.preflight import FIELD_TYPE, IMU_TYPE

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


def _tick(guide: Guide) -> None:
    """Tell what was seen, and what is asked for next."""
    done = [
        s
        for s, state in guide.states.items()
        if state in (GuideStepState.SEEN, GuideStepState.MISSED)
    ]
    seen = guide.states[done[-1]] is GuideStepState.SEEN
    say(f"  [{'x' if seen else '-'}] {ASKED[done[-1]]}{'' if seen else ': not seen'}")
    if guide.current is not None:
        say(f"  [ ] {ASKED[guide.current]}")


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
    told = Told(guide.turned_left)
    return Heard(log, Knowledge(reference.field, mounting), told, tuple(more), described)
