"""The page of a report, HTML without external files, and the numbers on it."""

from __future__ import annotations

import math
import platform
from collections.abc import Iterable, Sequence
from datetime import datetime
from html import escape
from importlib.resources import files
from typing import NamedTuple

import numpy as np
import scipy

from magcal_ros import __version__
from magcal_ros.core.assessment.bounds import DRIVE_BOUNDS, HEADING_BOUNDS, TURN_BOUNDS
from magcal_ros.core.assessment.grading import DEGREES, SCALES, Grade, worst
from magcal_ros.core.assessment.verdict import Verdict
from magcal_ros.core.calibration.calibration import Estimate
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.calibration.heading_sigma import (
    CHECKED_TILT,
    calibration_sigma,
    every_figure,
)
from magcal_ros.core.doctor.finding import Finding
from magcal_ros.core.doctor.sensor_report import SensorReport
from magcal_ros.core.knowledge import Belief, Knowledge
from magcal_ros.core.multi_turn.result import MultiTurnReport
from magcal_ros.report.gallery import Picture, missing
from magcal_ros.report.turn import MICRO, Subject, Turn

POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; form-action 'none'"
"""Content security policy: even unescaped text could not load or run anything."""

GRADE_SIGNS = {Grade.EXCELLENT: "✓✓", Grade.GOOD: "✓", Grade.WARN: "!", Grade.REFUSED: "✗"}
"""Signs of the grades, which do not differ in colour alone."""


def render(subject: Subject, turn: Turn, pictures: Sequence[Picture]) -> str:
    """Return the whole page."""
    outcome = subject.outcome
    estimate, calibration = outcome.estimate, outcome.calibration
    by_hand = calibration is not None and calibration.evidence.accepted_by_user
    head = page_head(subject.title, subject.created, subject.source)
    parts = [head, _verdict(outcome.verdict, by_hand)]
    if estimate is not None:
        parts.append(_key(key_numbers(estimate, len(subject.window))))
    if outcome.multi_turn is not None:
        parts.append(_multi_turn(outcome.multi_turn))
    parts += [_pictures(pictures), '<div class="tables">']
    parts.append(_not_shown(outcome.verdict, turn.kind, estimate is not None))
    checks = sorted(outcome.verdict.checks, key=lambda each: (-each.grade.rank, each.aspect.value))
    rows = [(_chip(each.grade), each.aspect.value, escape(each.words)) for each in checks]
    parts.append("<h2>Checks</h2>" + table("checks", rows, ("grade", "aspect", "what")))
    parts.append(_sensors(turn.sensors))
    if estimate is not None:
        heads = ("", "A (±1σ), dimensionless", "", "", "h (±1σ), µT")
        twelve = table("twelve", matrix_rows(estimate), heads)
        title = "<h2>The correction: field in body axes = A (raw field − h)</h2>"
        parts.append(f'{title}<div class="scroll">{twelve}</div>')
        parts.append(f"<h2>All numbers</h2>{_columns(all_numbers(estimate), 'numbers')}")
    parts.append(f"<h2>Method, versions, input</h2>{_columns(_input(subject, turn), 'input')}")
    return "\n".join([*parts, _repeat(subject), "</div></body></html>\n"])


def page_head(title: str, created: datetime, source: str) -> str:
    """Return the beginning of a page up to its headline."""
    words = escape(title)
    style = files("magcal_ros.report").joinpath("page.css").read_text(encoding="utf-8")
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{POLICY}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{words}</title>
<style>
{style}</style>
</head>
<body>
<h1>{words}</h1>
<p class="meta">{created.isoformat(sep=" ", timespec="seconds")} · {escape(source)}</p>"""


def table(kind: str, rows: Iterable[Sequence[str]], heads: Sequence[str] = ()) -> str:
    """Return an HTML table; cells and heads are HTML."""
    head = "".join(f"<th>{words}</th>" for words in heads)
    lines = [f"<tr>{head}</tr>"] if heads else []
    lines += ["<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows]
    return f'<table class="{kind}">{"".join(lines)}</table>'


def _chip(grade: Grade, words: str = "") -> str:
    return f'<span class="grade {grade.value}">{GRADE_SIGNS[grade]} {words}{grade.value}</span>'


def _verdict(verdict: Verdict, by_hand: bool) -> str:
    grade = worst([verdict.quality, verdict.confidence])
    note = "<p>The user put it in force against this verdict.</p>" if by_hand else ""
    return (
        f'<section class="verdict {grade.value}"><div class="grades">'
        f"{_chip(verdict.quality, 'quality ')}{_chip(verdict.confidence, 'confidence ')}</div>"
        f'<p id="summary">{escape(verdict.summary)}</p>{note}</section>'
    )


def _key(rows: Iterable[Row]) -> str:
    pairs = ((escape(row.words), escape(row.value)) for row in rows)
    cells = "".join(f"<div><dt>{words}</dt><dd>{value}</dd></div>" for words, value in pairs)
    return f'<dl class="key">{cells}</dl>'


def _multi_turn(multi_turn: MultiTurnReport) -> str:
    """Return the section on several turns: results, determined quantities, and the next turn."""
    rows = [
        (escape(fate.name), "joined" if fate.joined else "left out", escape(fate.words))
        for fate in multi_turn.turns
    ]
    return (
        '<section id="several"><h2>Joined turns</h2>'
        f"{table('checks', rows, ('turn', 'result', 'information'))}"
        f"<p>Determined by all turns: {escape(multi_turn.shown.in_words)}.</p>"
        f"<p>{escape(multi_turn.advice_in_words)}</p></section>"
    )


def _pictures(pictures: Sequence[Picture]) -> str:
    figures = [
        f'<figure id="{picture.name}"><h3>{escape(picture.title)}</h3>'
        f"{picture.drawing}<figcaption>{escape(picture.caption)}</figcaption></figure>"
        for picture in pictures
    ]
    drawn = "\n".join(figures) or missing("No picture: there are no samples.")
    return f'<section class="pictures">{drawn}</section>'


def _not_shown(verdict: Verdict, kind: str, found: bool) -> str:
    title = f"<h2>Not determined by this {kind}</h2>"
    if not found:
        return f"{title}<p>These samples gave no calibration; the reason is given above.</p>"
    lines = "".join(f"<li>{escape(item)}</li>" for item in verdict.not_shown)
    return f"{title}<ul>{lines}</ul>"


def _sensors(page: SensorReport) -> str:
    """Return the faults of the sensors, and a folded list of the other checks."""
    wrong = [finding for finding in page.findings if finding.is_wrong]
    rest = [finding for finding in page.findings if not finding.is_wrong]
    return (
        f'<section id="sensors" class="{"wrong" if wrong else "fine"}"><h2>The sensors</h2>'
        f"{_lines(wrong) if wrong else ''}"
        f"<details><summary>{'Other checks' if wrong else 'No faults were found: all checks'}"
        f"</summary>{_lines(rest)}</details></section>"
    )


def _lines(findings: Sequence[Finding]) -> str:
    ordered = sorted(findings, key=lambda finding: -finding.grade.rank)
    rows = [
        ("not shown" if f.grade is Grade.GOOD else _chip(f.grade), escape(f.name), escape(_said(f)))
        for f in ordered
    ]
    return table("checks", rows, ("grade", "what", "evidence and remedy"))


def _said(finding: Finding) -> str:
    evidence = finding.evidence.removeprefix("not shown: ")
    remedy = finding.remedy[:1].upper() + finding.remedy[1:]
    return f"{evidence}. {remedy}" if remedy else evidence


def _columns(rows: Sequence[Row], kind: str) -> str:
    """Return two tables, side by side if the page is wide enough."""
    cells = [(escape(row.words), escape(row.value)) for row in rows]
    half = (len(cells) + 1) // 2
    return f'<div class="columns">{table(kind, cells[:half])}{table(kind, cells[half:])}</div>'


def _input(subject: Subject, turn: Turn) -> list[Row]:
    estimate = subject.outcome.estimate
    seconds = float(turn.time[-1]) if len(turn.time) else 0.0
    rows = [
        Row("method", subject.answered_by),
        Row("end of the optimisation", estimate.message if estimate is not None else "refused"),
        Row("source", subject.source),
        Row("frame of the field", subject.magnetometer_frame or "not given"),
        Row("frame of the IMU", subject.imu_frame or "not given"),
        Row("samples", f"{len(subject.window)} over {seconds:.1f} s"),
        Row("gyro", "yes" if subject.window.angular_rate is not None else "no"),
    ]
    if subject.vehicle:
        rows.append(Row("in the vehicle", subject.vehicle))
    versions = (
        f"magcal_ros {__version__}, Python {platform.python_version()}, "
        f"numpy {np.__version__}, scipy {scipy.__version__}"
    )
    return [*rows, *known_before(subject.knowledge), Row("versions", versions)]


def _repeat(subject: Subject) -> str:
    multi_turn = subject.outcome.multi_turn
    newest = multi_turn is not None and len(multi_turn.joined) > 1
    joins = " alone; <code>magcal fit</code> joins several recordings"
    note, alone = (" of the newest turn", joins) if newest else ("", "")
    return (
        "<h2>Repeat the fit</h2><p>The folder of this page also contains <code>samples.csv</code> "
        f"with all samples{note} in SI units; these lines repeat the fit{alone}.</p>"
        f"<pre><code>{escape(recipe(subject.knowledge, subject.answered_by))}</code></pre>"
    )


def recipe(knowledge: Knowledge, method: str) -> str:
    """Return a program that reads `samples.csv` and prints the verdict again."""
    reference, mounting, iron = knowledge.reference, knowledge.mounting, knowledge.soft_iron
    declination = None if reference.declination is None else float(reference.declination)
    return f"""\
from pathlib import Path
from magcal_ros.core.calibrate import calibrate
from magcal_ros.core.knowledge import Belief, Knowledge, Mounting, ReferenceField, SoftIron
from magcal_ros.files.recording import read_samples

knowledge = Knowledge(
    ReferenceField(
        {_as_code(reference.strength)},
        {_as_code(reference.inclination)},
        {declination!r}, {float(reference.declination_sigma)!r},
    ),
    Mounting(
        {mounting.gains.tolist()!r},
        {mounting.pose.tolist()!r},
    ),
    SoftIron({float(iron.sigma_diagonal)!r}, {float(iron.sigma_cross)!r}, {bool(iron.always)!r}),
)
outcome = calibrate(read_samples(Path("samples.csv")), knowledge, {method!r})
print(outcome.verdict.summary)
"""


def _as_code(belief: Belief) -> str:
    if math.isinf(belief.sigma):
        return "Belief.unknown()"
    return f"Belief({float(belief.value)!r}, {float(belief.sigma)!r})"


class Row(NamedTuple):
    """One line of a table: description, and value with unit."""

    words: str
    value: str


FIGURES: dict[Figure, tuple[str, str]] = {
    b.figure: (b.words.removesuffix(":").removesuffix(" by"), b.unit)
    for b in (*HEADING_BOUNDS, *DRIVE_BOUNDS, *TURN_BOUNDS)
} | {
    Figure.HEADING_SIGMA_TILTED: ("predicted heading error at 10° of tilt (1σ)", "°"),
    Figure.LOCAL_SIGMA: ("heading error by local magnetic disturbances (1σ)", "°"),
    Figure.DRIVING_TIME: ("length of the drive", " s"),
    Figure.METRES: ("distance driven", " m"),
    Figure.STREET: ("disturbance that changes with the place (1σ per axis)", " µT"),
    Figure.LOCAL_FIELD: ("total disturbance along the drive (1σ per axis)", " µT"),
    Figure.AXIAL_IRON: ("hard iron along the turn's axis, by the reference field", " µT"),
    Figure.STEADY_ACCELERATION: ("tilt by a steady acceleration, subtracted", "°"),
    Figure.POSSIBLE_ACCELERATION: ("heading error by an unmeasured acceleration (1σ)", "°"),
    Figure.CIRCLE_RADIUS: ("radius of the field's circle", " µT"),
    Figure.RADIUS_RATIO: ("circle radius over the reference's", ""),
    Figure.ELLIPSE_RATIO: ("ellipse in the turn's plane, longer axis over shorter", ""),
    Figure.AXIS_TILT: ("turn's axis off the vertical", "°"),
    Figure.AXIAL_FIELD: ("field along the turn's axis, positive downwards", " µT"),
    Figure.AXIAL_HARD_IRON: ("hard iron along the turn's axis, positive downwards", " µT"),
    Figure.ACCELEROMETER_SPREAD: ("accelerometer's spread over six times its noise", ""),
    Figure.FIELD_SPREAD: ("field's spread over six times its noise", ""),
    Figure.RIVAL_ROLL: ("second solution, installation roll", "°"),
    Figure.RIVAL_PITCH: ("second solution, installation pitch", "°"),
    Figure.RIVAL_ANGLE: ("second solution, installation angle", "°"),
    Figure.WOBBLE: ("wobble of the turn's axis (1σ per axis)", "°"),
    Figure.SOFT_IRON: ("soft iron was fitted (1 yes, 0 no)", ""),
    Figure.GYRO_CARRIED: ("the turn by the gyro explains the samples (1 yes, 0 no)", ""),
    Figure.NOT_CONVERGED: ("the optimisation has not converged (1 yes, 0 no)", ""),
    Figure.GYRO_SCALE: ("scale error of the gyro about up, corrected", "%"),
    Figure.ITERATIONS: ("steps of the optimisation", ""),
    Figure.ON_THE_SPOT: ("probability that the robot turned on the spot", ""),
    Figure.TURNS: ("turns that were joined", ""),
    Figure.TURN_MISFIT: ("largest difference of a turn from the others, over that of noise", ""),
    **{
        Figure(f"{sensor}_range_{axis}"): (f"{sensor}'s range along {axis}, de-rotated", unit)
        for sensor, unit in (("accelerometer", " g"), ("field", " µT"))
        for axis in "xyz"
    },
}
"""Description and unit of each figure."""


def key_numbers(estimate: Estimate, samples: int) -> list[Row]:
    """Return the most important numbers for the user."""
    figures = every_figure(estimate)
    sigma = np.sqrt(np.maximum(np.diag(estimate.covariance)[9:], 0.0))
    iron, sigma = estimate.correction.hard_iron * MICRO, sigma * MICRO
    level, tilted = figures[Figure.HEADING_SIGMA], figures[Figure.HEADING_SIGMA_TILTED]
    where = (" on level ground (1σ)", " at 10° of tilt (1σ)")
    errors = [("heading error", level, tilted)]
    if Figure.LOCAL_SIGMA in figures:
        own, own_tilted = (calibration_sigma(estimate, tilt) for tilt in (0.0, CHECKED_TILT))
        errors = [
            ("heading error by the calibration,", own, own_tilted),
            ("heading error along the drive,", level, tilted),
        ]
    rows = [
        Row(words + place, f"±{sigma * DEGREES:.2f}°")
        for words, *sigmas in errors
        for place, sigma in zip(where, sigmas, strict=True)
    ]
    rows += [
        Row(f"hard iron {name} (±1σ)", f"{value:.2f} ± {spread:.2f} µT")
        for name, value, spread in zip("xyz", iron, sigma, strict=True)
    ]
    found = estimate.installation
    if found is not None:
        rows.append(Row("installation roll", f"{found.roll * DEGREES:.2f}°"))
        rows.append(Row("installation pitch", f"{found.pitch * DEGREES:.2f}°"))
        if (off := figures.get(Figure.INSTALLATION_YAW_SIGMA)) is not None:
            words = f"{found.yaw * DEGREES:.2f} ± {off * DEGREES:.2f}°"
            rows.append(Row("installation yaw (±1σ)", words))
    inliers = int(np.count_nonzero(estimate.inliers))
    driven = figures.get(Figure.HEADINGS_DRIVEN)
    seen = Row("measured arc", f"{estimate.arc * DEGREES:.0f}°")
    return [
        *rows,
        seen if driven is None else Row("headings driven", f"{driven:.0f} of 12"),
        Row("samples used (repeats and rests not counted)", f"{inliers} of {samples}"),
        Row("strength of the corrected field", f"{estimate.strength * MICRO:.2f} µT"),
        Row("inclination, positive downwards", f"{estimate.inclination * DEGREES:.2f}°"),
    ]


def all_numbers(estimate: Estimate) -> list[Row]:
    """Return all further numbers of an estimate."""
    axis = ", ".join(f"{value:.4f}" for value in estimate.axis)
    rows = [
        Row("turn's axis in body axes", f"({axis})"),
        Row("noise of one field sample (1σ)", f"{estimate.noise_field * MICRO:.3g} µT"),
        Row("noise of one tilt (1σ)", f"{estimate.noise_up * DEGREES:.3g}°"),
    ]
    figures = every_figure(estimate).items()
    return rows + [figure_row(name, value) for name, value in figures]


def figure_row(name: Figure, value: float) -> Row:
    """Return the line of a figure; an unknown figure is shown with its key, in SI units."""
    if name not in FIGURES:
        return Row(str(name).replace("_", " "), f"{value:.6g} (SI)")
    words, unit = FIGURES[name]
    return Row(words, f"{value * SCALES.get(unit, 1.0):.4g}{unit}")


def matrix_rows(estimate: Estimate) -> list[list[str]]:
    """Return the twelve numbers with their sigmas: three of A and one of h per line."""
    sigma = np.sqrt(np.maximum(np.diag(estimate.covariance), 0.0))
    a, h = estimate.correction.matrix, estimate.correction.hard_iron * MICRO
    spread, iron = sigma[:9].reshape(3, 3), sigma[9:] * MICRO
    return [
        [
            "xyz"[i],
            *(f"{a[i, j]:.6f} ± {spread[i, j]:.6f}" for j in range(3)),
            f"{h[i]:.4f} ± {iron[i]:.4f}",
        ]
        for i in range(3)
    ]


def known_before(knowledge: Knowledge) -> list[Row]:
    """Return the prior knowledge."""
    reference, mounting, iron = knowledge.reference, knowledge.mounting, knowledge.soft_iron
    pose = "; ".join(" ".join(f"{value:.4g}" for value in row) for row in mounting.pose)
    spread = f"±{iron.sigma_diagonal * 100:g}% on, ±{iron.sigma_cross * 100:g}% off the diagonal"
    return [
        Row("reference strength", _belief(reference.strength, MICRO, " µT")),
        Row("reference inclination", _belief(reference.inclination, DEGREES, "°")),
        Row("declination, positive east", _belief(reference.declination_belief, DEGREES, "°")),
        Row("known soft-iron gains x, y, z", ", ".join(f"{gain:g}" for gain in mounting.gains)),
        Row("nominal mounting, rows of the pose", pose),
        Row("soft iron beyond the gains (1σ)", spread),
    ]


def _belief(belief: Belief, scale: float, unit: str) -> str:
    if belief.is_unknown:
        return "not known"
    value = f"{belief.value * scale:.2f}"
    return f"{value}{unit}" if belief.is_exact else f"{value} ± {belief.sigma * scale:.2f}{unit}"
