"""The page of a report, HTML without external files."""

from __future__ import annotations

import math
import platform
from collections.abc import Iterable, Sequence
from datetime import datetime
from html import escape
from importlib.resources import files

import numpy as np
import scipy

from magcal_ros import __version__
from magcal_ros.core.assessment.grading import Check, Grade, worst
from magcal_ros.core.assessment.verdict import Verdict
from magcal_ros.core.doctor.health import Finding
from magcal_ros.core.doctor.page import Page
from magcal_ros.core.knowledge import Belief, Knowledge
from magcal_ros.core.multi_turn.result import Several
from magcal_ros.report.gallery import Picture
from magcal_ros.report.numbers import Row, all_numbers, key_numbers, known_before, matrix_rows
from magcal_ros.report.turn import Subject, Turn

POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; form-action 'none'"
"""Even text that slipped through could load nothing and run nothing."""

SIGNS = {Grade.EXCELLENT: "✓✓", Grade.GOOD: "✓", Grade.WARN: "!", Grade.REFUSED: "✗"}
"""Grades differ in sign and word, not in colour alone."""


def render(subject: Subject, turn: Turn, pictures: Sequence[Picture]) -> str:
    """Return the whole page."""
    outcome = subject.outcome
    estimate, calibration = outcome.estimate, outcome.calibration
    by_hand = calibration is not None and calibration.evidence.accepted_by_user
    head = page_head(subject.title, subject.created, subject.source)
    parts = [head, _verdict(outcome.verdict, by_hand)]
    if estimate is not None:
        parts.append(_key(key_numbers(estimate, len(subject.window))))
    if outcome.several is not None:
        parts.append(_several(outcome.several))
    parts += [_pictures(pictures), '<div class="tables">']
    parts.append(_not_shown(outcome.verdict, turn.kind, estimate is not None))
    parts += [_checks(outcome.verdict.checks), _sensors(turn.sensors)]
    if estimate is not None:
        heads = ("", "A (±1σ), dimensionless", "", "", "h (±1σ), µT")
        twelve = table("twelve", matrix_rows(estimate), heads)
        title = "<h2>The correction: field in body axes = A (raw field − h)</h2>"
        parts.append(f'{title}<div class="scroll">{twelve}</div>')
        parts.append(f"<h2>All numbers</h2>{_columns(all_numbers(estimate), 'numbers')}")
    parts.append(f"<h2>Method, versions, input</h2>{_columns(_input(subject, turn), 'input')}")
    return "\n".join([*parts, _repeat(subject), "</div></body></html>\n"])


def page_head(title: str, created: datetime, source: str) -> str:
    """Return the beginning of a page, its headline included."""
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
    """Return a table of cells that are HTML already, under their heads if there are any."""
    head = "".join(f"<th>{words}</th>" for words in heads)
    lines = [f"<tr>{head}</tr>"] if heads else []
    lines += ["<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows]
    return f'<table class="{kind}">{"".join(lines)}</table>'


def _chip(grade: Grade, words: str = "") -> str:
    return f'<span class="grade {grade.value}">{SIGNS[grade]} {words}{grade.value}</span>'


def _verdict(verdict: Verdict, by_hand: bool) -> str:
    grade = worst([verdict.quality, verdict.confidence])
    note = "<p>A person put it in force against this verdict.</p>" if by_hand else ""
    return (
        f'<section class="verdict {grade.value}"><div class="grades">'
        f"{_chip(verdict.quality, 'quality ')}{_chip(verdict.confidence, 'confidence ')}</div>"
        f'<p id="summary">{escape(verdict.summary)}</p>{note}</section>'
    )


def _key(rows: Iterable[Row]) -> str:
    pairs = ((escape(row.words), escape(row.value)) for row in rows)
    cells = "".join(f"<div><dt>{words}</dt><dd>{value}</dd></div>" for words, value in pairs)
    return f'<dl class="key">{cells}</dl>'


def _several(several: Several) -> str:
    """Return what became of each turn, what is shown, and what the next should be."""
    rows = [
        (escape(fate.name), "joined" if fate.joined else "left out", escape(fate.words))
        for fate in several.fates
    ]
    return (
        '<section id="several"><h2>Turns put together</h2>'
        f"{table('checks', rows, ('turn', 'result', 'what it shows'))}"
        f"<p>Now shown: {escape(several.shown.in_words)}.</p>"
        f"<p>{escape(several.advice_in_words)}</p></section>"
    )


def _pictures(pictures: Sequence[Picture]) -> str:
    figures = [
        f'<figure id="{picture.name}"><h3>{escape(picture.title)}</h3>'
        f"{picture.svg or _missing(picture.missing)}"
        f"<figcaption>{escape(picture.caption)}</figcaption></figure>"
        for picture in pictures
    ]
    drawn = "\n".join(figures) or _missing("No picture: there are no samples.")
    return f'<section class="pictures">{drawn}</section>'


def _missing(why: str) -> str:
    return f'<p class="missing">{escape(why)}</p>'


def _not_shown(verdict: Verdict, kind: str, found: bool) -> str:
    title = f"<h2>What this {kind} could not show</h2>"
    if not found:
        return f"{title}<p>No calibration came of these samples; the reason stands above.</p>"
    lines = "".join(f"<li>{escape(item)}</li>" for item in verdict.not_shown)
    return f"{title}<ul>{lines}</ul>"


def _checks(checks: Sequence[Check]) -> str:
    ordered = sorted(checks, key=lambda check: (-check.grade.rank, check.aspect.value))
    rows = [(_chip(check.grade), check.aspect.value, escape(check.words)) for check in ordered]
    return f"<h2>What was checked</h2>{table('checks', rows, ('grade', 'aspect', 'what'))}"


def _sensors(page: Page) -> str:
    """Return what is wrong with the sensors, and folded away all that was looked at."""
    wrong = [finding for finding in page.findings if finding.is_wrong]
    rest = [finding for finding in page.findings if not finding.is_wrong]
    return (
        f'<section id="sensors" class="{"wrong" if wrong else "fine"}"><h2>The sensors</h2>'
        f"{_lines(wrong) if wrong else ''}"
        f"<details><summary>{'What else' if wrong else 'Nothing is wrong with them: what'} was "
        f"looked at</summary>{_lines(rest)}</details></section>"
    )


def _lines(findings: Sequence[Finding]) -> str:
    ordered = sorted(findings, key=lambda finding: -finding.grade.rank)
    rows = [
        ("not shown" if f.grade is Grade.GOOD else _chip(f.grade), escape(f.name), escape(_said(f)))
        for f in ordered
    ]
    return table("checks", rows, ("grade", "what", "evidence, and what to change"))


def _said(finding: Finding) -> str:
    evidence = finding.evidence.removeprefix("not shown: ")
    remedy = finding.remedy[:1].upper() + finding.remedy[1:]
    return f"{evidence}. {remedy}" if remedy else evidence


def _columns(rows: Sequence[Row], kind: str) -> str:
    """Return two tables side by side, where there is room."""
    cells = [(escape(row.words), escape(row.value)) for row in rows]
    half = (len(cells) + 1) // 2
    return f'<div class="columns">{table(kind, cells[:half])}{table(kind, cells[half:])}</div>'


def _input(subject: Subject, turn: Turn) -> list[Row]:
    estimate = subject.outcome.estimate
    seconds = float(turn.time[-1]) if len(turn.time) else 0.0
    rows = [
        Row("method", subject.answered_by),
        Row("why it stopped", estimate.message if estimate is not None else "refused"),
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
    several = subject.outcome.several
    newest = several is not None and len(several.joined) > 1
    joins = " alone; <code>magcal fit</code> joins several recordings"
    note, alone = (" of the newest turn", joins) if newest else ("", "")
    return (
        f"<h2>Repeat the fit</h2><p>Beside this page lies <code>samples.csv</code> with every "
        f"sample{note} in SI units; these lines fit it again{alone}.</p>"
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
