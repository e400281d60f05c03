"""The page of a report: HTML without external files."""

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
        ("not shown" if f.grade is Grade.GOOD else _chip(f.grade), escape(f.name), escape(_said(f)))
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


CSS = """
:root { color-scheme: light; --ink: #1c1f23; --soft: #5a626b; --line: #d9dde1; --pale: #f4f6f8; }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 1080px; padding: 20px 16px 40px; background: #fff;
  color: var(--ink); font: 16px/1.5 system-ui, "Segoe UI", Roboto, Arial, sans-serif;
  overflow-wrap: anywhere; }
h1 { margin: 0; font-size: 1.7rem; line-height: 1.2; }
h2 { margin: 28px 0 10px; font-size: 1.15rem; }
h3 { margin: 0 0 4px; font-size: 1rem; }
p { margin: 0 0 8px; }
.meta { margin: 4px 0 16px; color: var(--soft); font-size: .9rem; }
.verdict { border: 1px solid var(--line); border-left: 8px solid; border-radius: 6px;
  padding: 12px 16px; background: var(--pale); }
.verdict p { margin: 8px 0 0; font-size: 1.05rem; }
.grades { display: flex; flex-wrap: wrap; gap: 8px; }
.grade { display: inline-block; border-radius: 4px; padding: 1px 9px; color: #fff;
  font-weight: 600; white-space: nowrap; }
.excellent { background: #00664b; } .good { background: #0072b2; }
.warn { background: #f0b323; color: #1c1f23; } .refused { background: #a3230d; }
.verdict.excellent, .verdict.good, .verdict.warn, .verdict.refused {
  background: var(--pale); color: inherit; }
.verdict.excellent { border-left-color: #00664b; } .verdict.good { border-left-color: #0072b2; }
.verdict.warn { border-left-color: #f0b323; } .verdict.refused { border-left-color: #a3230d; }
.key { display: grid; grid-template-columns: repeat(auto-fill, minmax(150px, 1fr)); gap: 8px;
  margin: 14px 0 0; }
.key div { border: 1px solid var(--line); border-radius: 6px; padding: 6px 10px; }
.key dt { color: var(--soft); font-size: .78rem; line-height: 1.3; }
.key dd { margin: 0; font-size: .95rem; font-weight: 600; font-variant-numeric: tabular-nums; }
.pictures { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 18px;
  margin-top: 20px; }
figure { margin: 0; border: 1px solid var(--line); border-radius: 6px; padding: 12px; }
figure svg { display: block; width: 100%; height: auto; stroke-linejoin: round;
  stroke-linecap: butt; }
figure svg text { font-family: system-ui, "Segoe UI", Roboto, Arial, sans-serif !important; }
figcaption { margin-top: 6px; color: var(--soft); font-size: .86rem; line-height: 1.4; }
.missing { margin: 12px 0; border: 1px dashed #a9b0b7; border-radius: 6px; padding: 28px 14px;
  background: var(--pale); text-align: center; }
.scroll { overflow-x: auto; }
table { width: 100%; border-collapse: collapse; font-size: .9rem; }
th, td { border-bottom: 1px solid var(--line); padding: 4px 10px 4px 0; text-align: left;
  vertical-align: top; }
th { color: var(--soft); font-weight: 600; }
td.value { text-align: right; padding-right: 0; font-variant-numeric: tabular-nums; }
.checks td:nth-child(-n+2), .checks th { padding-right: 14px; white-space: nowrap; }
.numbers, .input { table-layout: fixed; }
.numbers td:first-child { width: 66%; } .input td:first-child { width: 38%; }
.twelve td { white-space: nowrap; font-variant-numeric: tabular-nums; }
.columns { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 0 32px;
  align-items: start; }
ul { margin: 0; padding-left: 20px; }
code, pre { font: .82rem/1.45 ui-monospace, Menlo, Consolas, monospace; }
pre { margin: 0; border-radius: 6px; padding: 10px; background: var(--pale); overflow-x: auto;
  overflow-wrap: normal; }
@media screen and (max-width: 760px) {
  .pictures, .columns { grid-template-columns: minmax(0, 1fr); }
  .key { grid-template-columns: repeat(2, minmax(0, 1fr)); }
  .verdict p { font-size: 1rem; }
  .checks tr { display: block; border-bottom: 1px solid var(--line); padding: 6px 0; }
  .checks tr:first-child { display: none; }
  .checks td { display: inline-block; border: 0; padding-bottom: 0; }
  .checks td:last-child { display: block; }
}
@page { size: A4; margin: 10mm; }
@media print {
  * { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
  body { max-width: none; padding: 0; font-size: 8pt; line-height: 1.3; }
  h1 { font-size: 14pt; } h2 { margin: 7pt 0 3pt; font-size: 9.5pt; } h3 { font-size: 8.5pt; }
  .meta { margin: 1pt 0 4pt; font-size: 7.5pt; display: -webkit-box; overflow: hidden;
    -webkit-box-orient: vertical; -webkit-line-clamp: 2; }
  .verdict { padding: 4pt 8pt; } .verdict p { margin-top: 3pt; font-size: 8pt; }
  .key { grid-template-columns: repeat(6, minmax(0, 1fr)); gap: 3pt; margin-top: 4pt; }
  .key div { padding: 1pt 4pt; } .key dt { font-size: 6pt; } .key dd { font-size: 8pt; }
  .pictures { grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 4pt; margin-top: 5pt; }
  figure { padding: 4pt; break-inside: avoid; }
  figure svg { width: auto; max-width: 100%; height: 44mm; margin: 0 auto; }
  figcaption { margin-top: 1pt; font-size: 6.8pt; line-height: 1.2; }
  .missing { padding: 10pt; }
  h2 { break-after: avoid; }
  .columns { grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 0 14pt; }
  table { font-size: 6.5pt; line-height: 1.15; } th, td { padding: .6pt 6pt .6pt 0; }
  .grade { padding: 0 4pt; } .checks .grade { font-size: 6.4pt; }
  tr { break-inside: avoid; }
  code, pre { font-size: 6pt; line-height: 1.15; }
  pre { padding: 3pt; white-space: pre-wrap; }
  .scroll, pre { overflow: visible; }
  #sensors.fine, #sensors details { display: none; }
}
"""
