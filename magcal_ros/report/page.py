"""The one page of a report: HTML that needs nothing outside of itself."""

from __future__ import annotations

import math
import platform
from collections.abc import Iterable, Sequence
from datetime import datetime
from html import escape

import numpy as np
import scipy

from magcal_ros import __version__
from magcal_ros.core.assessment.grading import Check, Grade, worst
from magcal_ros.core.assessment.verdict import Verdict
from magcal_ros.core.doctor.finding import Finding
from magcal_ros.core.doctor.page import Page
from magcal_ros.core.knowledge import Belief, Knowledge
from magcal_ros.core.multi_turn.result import Several
from magcal_ros.report.figures.gallery import Picture
from magcal_ros.report.numbers import Row, all_numbers, key_numbers, known_before, matrix_rows
from magcal_ros.report.style import CSS
from magcal_ros.report.subject import Subject
from magcal_ros.report.turn import Turn

POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; form-action 'none'"
"""Even text that slipped through could load nothing and run nothing."""

SIGNS = {Grade.EXCELLENT: "✓✓", Grade.GOOD: "✓", Grade.WARN: "!", Grade.REFUSED: "✗"}
"""Grades differ in sign and word, not in colour alone."""


def render(subject: Subject, turn: Turn, pictures: Sequence[Picture]) -> str:
    """Return the whole page.

    Parameters
    ----------
    subject : Subject
        What it is about.
    turn : Turn
        Its samples, worked out.
    pictures : sequence of Picture
        Drawn or missing.
    """
    outcome = subject.outcome
    estimate, calibration = outcome.estimate, outcome.calibration
    by_hand = calibration is not None and calibration.evidence.accepted_by_user
    head = page_head(subject.title, subject.created, subject.source)
    parts = [head, _verdict(outcome.verdict, by_hand)]
    if estimate is not None:
        parts.append(_key(key_numbers(estimate, len(subject.window))))
    if outcome.several is not None:
        parts.append(_several(outcome.several))
    parts.append(_pictures(pictures))
    parts.append('<div class="tables">')
    parts.append(_not_shown(outcome.verdict, estimate is not None))
    parts.append(_checks(outcome.verdict.checks))
    parts.append(_sensors(turn.sensors))
    if estimate is not None:
        parts.append(_twelve(matrix_rows(estimate)))
        parts.append(f"<h2>All numbers</h2>{_table(all_numbers(estimate), 'numbers')}")
    parts.append(f"<h2>Method, versions, input</h2>{_table(_input(subject, turn), 'input')}")
    parts.append(_repeat(subject))
    parts.append("</div></body></html>\n")
    return "\n".join(parts)


def page_head(title: str, created: datetime, source: str) -> str:
    """Return the beginning of a page, its headline included."""
    words = escape(title)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{POLICY}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{words}</title>
<style>{CSS}</style>
</head>
<body>
<h1>{words}</h1>
<p class="meta">{created.isoformat(sep=" ", timespec="seconds")} · {escape(source)}</p>"""


def checks_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of cells that are HTML already, under their heads."""
    head = "".join(f"<th>{words}</th>" for words in heads)
    body = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<table class="checks"><tr>{head}</tr>{body}</table>'


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
    cells = "".join(
        f"<div><dt>{escape(row.words)}</dt><dd>{escape(row.value)}</dd></div>" for row in rows
    )
    return f'<dl class="key">{cells}</dl>'


def _several(several: Several) -> str:
    """Return what became of each turn, what is shown, and what the next should be."""
    rows = [
        (escape(fate.name), "joined" if fate.joined else "left out", escape(fate.words))
        for fate in several.fates
    ]
    return (
        '<section id="several"><h2>Turns put together</h2>'
        f"{checks_table(('turn', 'fate', 'what it shows'), rows)}"
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
    if not figures:
        figures = [_missing("No picture: there are no samples.")]
    return '<section class="pictures">' + "\n".join(figures) + "</section>"


def _missing(why: str) -> str:
    return f'<p class="missing">{escape(why)}</p>'


def _not_shown(verdict: Verdict, found: bool) -> str:
    title = "<h2>What this turn could not show</h2>"
    if not found:
        return f"{title}<p>No calibration came of these samples; the reason stands above.</p>"
    lines = "".join(f"<li>{escape(item)}</li>" for item in verdict.not_shown)
    return f"{title}<ul>{lines}</ul>"


def _checks(checks: Sequence[Check]) -> str:
    ordered = sorted(checks, key=lambda check: (-check.grade.rank, check.aspect.value))
    rows = [(_chip(check.grade), check.aspect.value, escape(check.words)) for check in ordered]
    return f"<h2>What was checked</h2>{checks_table(('grade', 'speaks for', 'what'), rows)}"


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
        (
            "not shown" if f.grade is Grade.GOOD else _chip(f.grade),
            escape(f.name),
            escape(_said(f)),
        )
        for f in ordered
    ]
    return checks_table(("grade", "what", "evidence, and what to change"), rows)


def _said(finding: Finding) -> str:
    evidence = finding.evidence.removeprefix("not shown: ")
    remedy = finding.remedy[:1].upper() + finding.remedy[1:]
    return f"{evidence}. {remedy}" if remedy else evidence


def _twelve(lines: Sequence[Sequence[str]]) -> str:
    rows = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in line) + "</tr>" for line in lines
    )
    return (
        "<h2>The correction: field in body axes = A (raw field − h)</h2>"
        '<div class="scroll"><table class="twelve"><tr><th></th><th colspan="3">A (±1σ), '
        f"dimensionless</th><th>h (±1σ), µT</th></tr>{rows}</table></div>"
    )


def _table(rows: Sequence[Row], kind: str) -> str:
    """Return two tables side by side, where there is room."""
    half = (len(rows) + 1) // 2
    tables = (
        f'<table class="{kind}">'
        + "".join(
            f'<tr><td>{escape(row.words)}</td><td class="value">{escape(row.value)}</td></tr>'
            for row in part
        )
        + "</table>"
        for part in (rows[:half], rows[half:])
    )
    return f'<div class="columns">{"".join(tables)}</div>'


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
    note = " of the newest turn" if newest else ""
    alone = " alone; <code>magcal fit</code> joins several recordings" if newest else ""
    return (
        f"<h2>Repeat the fit</h2><p>Beside this page lies <code>samples.csv</code> with every "
        f"sample{note} in SI units; these lines fit it again{alone}.</p>"
        f"<pre><code>{escape(recipe(subject.knowledge, subject.answered_by))}</code></pre>"
    )


def recipe(knowledge: Knowledge, method: str) -> str:
    """Return a program that reads `samples.csv` and prints the verdict again.

    Parameters
    ----------
    knowledge : Knowledge
        What the method was told; every number is given in full precision.
    method : str
        Its name.
    """
    reference, mounting, iron = knowledge.reference, knowledge.mounting, knowledge.soft_iron
    declination = None if reference.declination is None else float(reference.declination)
    return f"""\
from pathlib import Path
from magcal_ros.core.calibrate import calibrate
from magcal_ros.core.knowledge import Belief, Knowledge, Mounting, ReferenceField, SoftIron
from magcal_ros.files.samples import read_samples

knowledge = Knowledge(
    ReferenceField(
        {_belief(reference.strength)},
        {_belief(reference.inclination)},
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


def _belief(belief: Belief) -> str:
    if math.isinf(belief.sigma):
        return "Belief.unknown()"
    return f"Belief({float(belief.value)!r}, {float(belief.sigma)!r})"
