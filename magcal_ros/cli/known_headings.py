"""`magcal fit` where headings are known, in place of a turn."""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from magcal_ros.cli.common import number
from magcal_ros.cli.recorded import opened
from magcal_ros.core.calibrate import Outcome
from magcal_ros.core.errors import Misuse
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.streams import HeadingSample, Pair
from magcal_ros.core.session.external_heading import ExternalHeading
from magcal_ros.core.session.recorded import Reading
from magcal_ros.core.session.recorded_headings import (
    fit_at_headings,
    fit_heading_topic,
    standing_pairs,
)
from magcal_ros.files.repaired_readings import RepairedReadings


@dataclass(frozen=True, eq=False)
class HeardAtHeadings:
    """What a recording says at known headings: of a robot that stands, or on the way."""

    pairs: tuple[Pair, ...]
    readings: tuple[Reading, ...] = ()
    headings: tuple[HeadingSample, ...] = ()


def add_heading_options(parser: Any) -> None:
    """Add what is known of headings."""
    known = parser.add_argument_group("known headings, in place of a turn")
    known.add_argument(
        "--heading-deg",
        type=number(-360.0, 360.0),
        nargs="+",
        metavar="YAW",
        help="heading of the IMU's x at which the robot stands in each recording: ENU, 0 to the "
        "east, 90 to the north, counted to the left",
    )
    known.add_argument(
        "--sigma-deg",
        type=number(0.01, 45.0),
        default=2.0,
        metavar="SIGMA",
        help="how well it is known (default 2)",
    )
    known.add_argument(
        "--heading-topic",
        default="",
        metavar="TOPIC",
        help="topic of a bag with headings that somebody else measured, as two antennas do",
    )
    known.add_argument(
        "--north",
        choices=("true", "magnetic"),
        help="which north these headings are to; must be given with them",
    )


def check_heading_options(options: argparse.Namespace) -> None:
    """Refuse options that do not fit together.

    Raises
    ------
    Misuse
    """
    angles, topic = options.heading_deg or (), options.heading_topic
    if not (angles or topic):
        if options.north:
            raise Misuse("--north says what headings are to: give --heading-deg or --heading-topic")
        return
    if options.north is None:
        raise Misuse("say which north the headings are to: --north true or --north magnetic")
    if angles and topic:
        raise Misuse("give --heading-deg or --heading-topic, not both")
    if angles and len(angles) != len(options.recordings):
        raise Misuse(
            f"{len(angles)} headings for {len(options.recordings)} recordings: give one "
            "--heading-deg for each, in their order, after the recordings"
        )
    if topic and len(options.recordings) > 1:
        raise Misuse("--heading-topic takes one recording")
    if options.compare:
        raise Misuse("--compare is about turns: known headings have one method")


def heard_at_headings(options: argparse.Namespace, path: Path) -> HeardAtHeadings | None:
    """Return what a recording says at known headings; None where none are given."""
    if not (options.heading_deg or options.heading_topic):
        return None
    with opened(options, path) as source:
        readings = RepairedReadings(source)
        if options.heading_deg:
            return HeardAtHeadings(standing_pairs(readings))
        return HeardAtHeadings((), tuple(readings), tuple(source.headings(options.heading_topic)))


def fit_known(
    heard: tuple[HeardAtHeadings | None, ...], knowledge: Knowledge, options: argparse.Namespace
) -> Outcome | None:
    """Return what known headings come to; None where none are given."""
    known, is_true = [each for each in heard if each is not None], options.north == "true"
    if not known:
        return None
    if options.heading_topic:
        return fit_heading_topic(known[0].readings, known[0].headings, is_true, knowledge)
    sigma = math.radians(options.sigma_deg)
    told = [ExternalHeading(math.radians(yaw), sigma, is_true) for yaw in options.heading_deg]
    outcome, words = fit_at_headings([each.pairs for each in known], told, knowledge)
    return replace(outcome, verdict=replace(outcome.verdict, summary=words))
