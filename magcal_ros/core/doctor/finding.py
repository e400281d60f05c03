"""One line of the page: what was looked at, how good it is, the numbers, what to change."""

from __future__ import annotations

from dataclasses import dataclass

from magcal_ros.core.assessment.grading import Grade


@dataclass(frozen=True)
class Finding:
    """One line of the page."""

    key: str
    """For programs: what is wrong, or was looked at."""
    name: str
    """What was looked at, for people."""
    grade: Grade
    """`EXCELLENT` where nothing is wrong, `GOOD` where the movement did not show it, `WARN` where
    something is worth a look, `REFUSED` where a heading would be wrong."""
    evidence: str
    """The numbers."""
    remedy: str = ""
    """What to change; empty where nothing is wrong."""

    @property
    def is_wrong(self) -> bool:
        """Whether there is something to change."""
        return self.grade.rank >= Grade.WARN.rank


def looked_at(key: str, name: str, evidence: str, remedy: str = "") -> Finding:
    """Return a line that is worth a look where there is a remedy, and good where there is none."""
    return Finding(key, name, Grade.WARN if remedy else Grade.EXCELLENT, evidence, remedy)


def wrong(key: str, name: str, evidence: str, remedy: str) -> Finding:
    """Return a line of what would make a heading wrong."""
    return Finding(key, name, Grade.REFUSED, evidence, remedy)


def not_shown(key: str, name: str, why: str) -> Finding:
    """Return a line of what the movement did not show; `why` says which one would."""
    return Finding(key, name, Grade.GOOD, f"not shown: {why}")
