"""The page on a drive: route, decisions of self-calibration, and disturbances of the field."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from datetime import datetime, timezone
from html import escape
from pathlib import Path

import numpy as np

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.heading_sigma import known_sigma, predicted_heading_sigma
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.self_calibration.drive_replay import DrivePath, DriveReplay
from magcal_ros.core.self_calibration.jobs import DecisionKind, difference
from magcal_ros.core.up.filter import FILTER
from magcal_ros.files.disk import FileError, write_atomically
from magcal_ros.files.recording import REMEDY
from magcal_ros.report.gallery import missing
from magcal_ros.report.page import page_head, table
from magcal_ros.report.write import PAGE

STEPS_DEG = (2.0, 5.0, 10.0, 20.0)
"""Upper limits of the colours, degrees; the last colour is for larger values."""
COLOURS = ("#0072B2", "#56B4E9", "#E69F00", "#D55E00", "#7a0019")
"""From a trusted to an untrusted compass; colour-blind people can distinguish them."""
WIDTH, MARGIN, BELOW = 1000.0, 30.0, 30.0
LABEL = (60.0, 24.0)
"""Width and height of a name on the map."""
HALO = 'paint-order="stroke" stroke="#fff" stroke-width="5"'
"""Outline of a name, so that it can be read on top of the route."""
TALLEST = "75vh"  # height of the map, so that map and legend fit on a screen
RULES = (
    "A calibration that is estimated while driving is first put on probation: only samples from "
    "later driving can prove that it is better than the one in force. If no calibration is in "
    "force, a second calibration that agrees is enough. A much more certain calibration that "
    "agrees with the one in force replaces it at once, as does hard iron that the samples since "
    "its change prove. A calibration that was put in force is still compared with the previous "
    "one. Headings are counted in twelve sectors of 30°. ± is one standard deviation of the "
    "heading by the calibration alone; along the drive, local magnetic disturbances such as "
    "streets and cars add to it."
)
VERBS = {
    DecisionKind.NOTICED: "noticed",
    DecisionKind.PROBATION: "put on probation",
    DecisionKind.DROPPED: "dropped",
    DecisionKind.PROPOSED: "proposed",
    DecisionKind.APPLIED: "put in force",
    DecisionKind.REFINED: "refined",
    DecisionKind.ROLLED_BACK: "taken back",
    DecisionKind.CONFIRMED: "confirmed",
}


def write_drive_page(folder: Path, replay: DriveReplay, source: str) -> Path:
    """Write `report.html` on a drive into a folder; returns it. A report is never overwritten."""
    page = folder / PAGE
    if page.exists():
        raise FileError(f"{page} exists already and is not overwritten; choose another folder")
    write_atomically(page, render_drive(replay, source), REMEDY)
    return page


def render_drive(replay: DriveReplay, source: str) -> str:
    """Return the whole page, which needs no other files."""
    summary = f'<p id="summary">{escape(summary_of(replay))}</p>'
    title = "The compass on a drive"
    return "\n".join(
        [
            page_head(title, datetime.now(timezone.utc), source),
            f'<section class="verdict good">{summary}</section>',
            _before_and_after(replay),
            _decisions(replay),
            _map(replay.path),
            "</body></html>\n",
        ]
    )


def summary_of(replay: DriveReplay) -> str:
    """Return the result of a drive in two or three sentences."""
    count = Counter(made.kind for _, made in replay.decisions)
    changed = count[DecisionKind.APPLIED] + count[DecisionKind.REFINED]
    back = count[DecisionKind.ROLLED_BACK]
    drove = f"{_duration(replay.seconds)} recorded, {_duration(replay.moved)} of movement"
    if changed:
        several = f"{changed} calibrations from driving were put in force"
        result = several if changed > 1 else "one calibration from driving was put in force"
        result += f", and {back} taken back" if back else ""
    elif replay.fault:
        result = (
            "no calibration was in force, and none was found; the sensors may be the cause: "
            f"{replay.fault}"
        )
    elif replay.first_calibration is None:
        result = "no calibration was in force, and the drive was not sufficient for one"
        result += (
            " (a second calibration that agrees with the first was still missing)"
            if count[DecisionKind.PROBATION]
            else " (that takes some minutes of driving, over half of all headings)"
        )
    else:
        result = "the calibration in force was kept: no other was proved better"
    words = f"{drove}: {result}." + ("" if replay.fault else f" At the end: {replay.state}.")
    if replay.last_calibration is not None:
        # Decisions and grades are on the sigma by the calibration; `magcal fit` prints both.
        heading = math.degrees(predicted_heading_sigma(replay.last_calibration))
        own = math.degrees(known_sigma(replay.last_calibration))
        words += (
            f" In force then: heading ±{own:.1f}° by the calibration (1σ); along the drive, with "
            f"local magnetic disturbances, ±{heading:.1f}°."
        )
    return words


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90.0 else f"{seconds / 60.0:.1f} min"


def _before_and_after(replay: DriveReplay) -> str:
    title = "<h2>Calibration before and after</h2>"
    first, last = replay.first_calibration, replay.last_calibration
    course = f'<p id="course">After: {escape(replay.course)}.</p>' if replay.course else ""
    if first is None and last is None:
        return f"{title}<p>None.</p>{course}"
    rows = ("before", *_cells(first)), ("after", *_cells(last))
    heads = ("", "made by", "heading (1σ)", "along the drive", "hard iron, µT", "why")
    apart = ""
    if first is not None and last is not None and first.correction is not last.correction:
        swing = math.degrees(difference(first, last))
        apart = f"<p>Headings of the two differ by {swing:.1f}° (RMS over all headings).</p>"
    return f'{title}<div class="scroll">{table("checks", rows, heads)}</div>{apart}{course}'


def _cells(calibration: Calibration | None) -> tuple[str, ...]:
    if calibration is None:
        return "none", "", "", "", ""
    x, y, z = (1e6 * float(value) for value in calibration.correction.hard_iron)
    evidence = calibration.evidence
    why = evidence.reasons[0] if evidence.method == "smoother" and evidence.reasons else ""
    return (
        "driving" if evidence.method == "smoother" else escape(evidence.method),
        f"±{math.degrees(known_sigma(calibration)):.1f}°",
        f"±{math.degrees(predicted_heading_sigma(calibration)):.1f}°",
        f'<span class="whole">{x:.1f}, {y:.1f}, {z:.1f}</span>',
        escape(why or evidence.summary),
    )


def _decisions(replay: DriveReplay) -> str:
    if not replay.decisions:
        return "<h2>Decisions</h2><p>None.</p>"
    rows = [
        (_duration(seconds), VERBS[made.kind], escape(made.words))
        for seconds, made in replay.decisions
    ]
    shown = table("checks", rows, ("after", "decision", "why"))
    return f"<h2>Decisions</h2><p>{RULES}</p>{shown}"


def _map(path: DrivePath | None) -> str:
    title = "<h2>Where the compass can be trusted</h2>"
    if path is None:
        return title + missing("No map: there was no calibration on this drive.")
    low, high = path.place.min(axis=0), path.place.max(axis=0)
    span = float(max(np.max(high - low), 1.0))
    scale = (WIDTH - 2.0 * MARGIN) / span
    # The scale bar is below the map, so that no name overlaps it.
    height = max(float(high[1] - low[1]) * scale + 2.0 * MARGIN, 60.0) + BELOW
    x = 0.5 * WIDTH + (path.place[:, 0] - 0.5 * (low[0] + high[0])) * scale
    y = MARGIN + (high[1] - path.place[:, 1]) * scale
    kinds = np.searchsorted(STEPS_DEG, np.degrees(path.error))
    dots = "".join(
        f'<circle cx="{a:.1f}" cy="{b:.1f}" r="4" fill="{COLOURS[kind]}"/>'
        for a, b, kind in zip(x, y, kinds, strict=True)
    )
    bounds = ["0", *(f"{step:g}" for step in STEPS_DEG)]
    names = [f"{a} to {b}°" for a, b in itertools.pairwise(bounds)]
    names.append(f"more than {bounds[-1]}°")
    legend = " &nbsp; ".join(
        f'<span style="color:{colour}">●</span> {name}: '
        f"{100.0 * float(np.mean(kinds == kind)):.0f}%"
        for kind, (colour, name) in enumerate(zip(COLOURS, names, strict=True))
    )
    trusted = 100.0 * float(np.mean(kinds <= 1))
    return (
        f"{title}<p>{_how(path)} The colour is the possible heading error by streets, cars and "
        "steel nearby. It is computed from the difference between the field and the calibrated "
        f"field. At {trusted:.0f}% of the points it was less than {STEPS_DEG[1]:g}°.</p>"
        f"<p>{legend}</p>"
        f'<figure id="map"><svg viewBox="0 0 {WIDTH:.0f} {height:.0f}" role="img" '
        f'style="max-height:{TALLEST}">'
        f"<title>The route of the drive, coloured by the disturbance of the field</title>"
        f"{dots}{_ends(x, y)}"
        f"{_bar(span, scale, height)}</svg></figure>"
    )


def _ends(x: FloatArray, y: FloatArray) -> str:
    """Return the names of start and end; one common name if the two would overlap."""
    if abs(x[0] - x[-1]) < LABEL[0] and abs(y[0] - y[-1]) < LABEL[1]:
        return _named("", x[0], y[0]) + _named("start and end", x[-1], y[-1])
    return _named("start", x[0], y[0]) + _named("end", x[-1], y[-1])


def _named(name: str, x: float, y: float) -> str:
    side, shift = ("end", -10.0) if x > 0.5 * WIDTH else ("start", 10.0)
    return (
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="7" fill="none" stroke="#1c1f23" stroke-width="2"/>'
        f'<text x="{x + shift:.1f}" y="{y + 6.0:.1f}" text-anchor="{side}" font-size="18" '
        f"{HALO}>{name}</text>"
    )


def _how(path: DrivePath) -> str:
    if path.is_measured:
        return "North is up; the positions are from the receiver."
    guess = "" if path.has_speed else f" and an assumed speed of {FILTER.usual_speed:g} m/s"
    return (
        f"North is up. Without fixes, the positions are computed from the compass{guess}, so only "
        "the shape is right."
    )


def _bar(span: float, scale: float, height: float) -> str:
    metres = 10.0 ** math.floor(math.log10(0.4 * span))
    end = MARGIN + metres * scale
    return (
        f'<line x1="{MARGIN}" y1="{height - 8:.1f}" x2="{end:.1f}" y2="{height - 8:.1f}" '
        f'stroke="#1c1f23" stroke-width="3"/><text x="{MARGIN}" y="{height - 14:.1f}" '
        f'font-size="16">{metres:g} m</text>'
    )
