"""The doctor's page as text, as JSON, and as a parameter file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from magcal_ros.cli.common import Exit, bullets
from magcal_ros.core.assessment.grading import Grade
from magcal_ros.core.doctor.page import Page
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.files.atomic import write_atomically
from magcal_ros.files.plain import plain

MARKS = {Grade.EXCELLENT: "ok", Grade.GOOD: "-", Grade.WARN: "look", Grade.REFUSED: "wrong"}


def page_in_words(page: Page) -> str:
    """Return the page for a terminal: a line for each finding, then what to do."""
    lines = [f"  {MARKS[f.grade]:<6}{f.name:<27}{plain(f.evidence, 300)}" for f in page.findings]
    worst_first = sorted(page.findings, key=lambda finding: -finding.grade.rank)
    # One cause may show in several lines.
    remedies = {f.remedy: f.name for f in reversed(worst_first) if f.remedy}
    todo = [f"{name}: {plain(words, 1000)}" for words, name in reversed(remedies.items())]
    return "\n".join(lines) + bullets("\nWhat to do:", todo).rstrip("\n")


def page_as_facts(page: Page, written: str | None, status: Exit) -> dict[str, Any]:
    """Return the page for programs."""
    return {
        "findings": [
            {
                "key": f.key,
                "name": f.name,
                "grade": f.grade.value,
                "evidence": f.evidence,
                "remedy": f.remedy,
            }
            for f in page.findings
        ],
        "mount_rpy_deg": page.mount_rpy_deg,
        "written": written,
        "exit": int(status),
    }


def write_parameters(path: Path | None, page: Page, gains: FloatArray | None) -> str | None:
    """Leave what parameters can mend, and the gains that were given; returns the path.

    Nothing is written where no mounting alone mends the axes: what a driver does wrong is mended
    there, and never here.
    """
    if path is None or not page.parameters:
        return None
    lines = [page.parameters]
    if gains is not None:
        lines.append(f"soft_iron_gains: [{', '.join(f'{float(gain)!r}' for gain in gains)}]")
    text = "\n".join(["/**:", "  ros__parameters:", *(f"    {line}" for line in lines)])
    write_atomically(path, text + "\n", "Choose a writable folder, or mend its permissions.")
    return str(path)
