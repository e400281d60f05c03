"""One line of the report, and how a measured quantity becomes one."""

from __future__ import annotations

from dataclasses import dataclass

from magcal_ros.core.assessment.grading import Grade
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.knowledge import CLEAR, Belief


@dataclass(frozen=True)
class Finding:
    """One line of the report."""

    key: str  # identifier of the check or the fault, for programs
    name: str  # name of the check, for people
    grade: Grade
    """`EXCELLENT` if nothing is wrong, `GOOD` if the movement does not show it, `WARN` for a fault
    worth checking, `REFUSED` for a fault that makes headings wrong."""
    evidence: str  # the measured values
    remedy: str = ""  # the change to make; empty if nothing is wrong

    @property
    def is_wrong(self) -> bool:
        """Whether there is something to change."""
        return self.grade.rank >= Grade.WARN.rank


def ok_or_warning(key: str, name: str, evidence: str, remedy: str = "") -> Finding:
    """Return a finding: a warning if there is a remedy, else excellent."""
    return Finding(key, name, Grade.WARN if remedy else Grade.EXCELLENT, evidence, remedy)


def ok_or_severe(key: str, name: str, evidence: str, remedy: str) -> Finding:
    """Return a finding: of a fault that makes headings wrong if there is a remedy."""
    return Finding(key, name, Grade.REFUSED if remedy else Grade.EXCELLENT, evidence, remedy)


def undetermined(key: str, name: str, why: str) -> Finding:
    """Return a finding on a quantity that is not determined; `why` says what is missing."""
    return Finding(key, name, Grade.GOOD, f"not shown: {why}")


def is_vague(sigma: float, error: float) -> bool:
    """Return whether a quantity is too uncertain to show an error of this size."""
    return not sigma < 0.5 * error


def is_wrong(quantity: Belief, error: float) -> bool:
    """Return whether a quantity that should be zero is larger than an error, and significant."""
    return abs(quantity.value) > max(error, CLEAR * quantity.sigma)


def vector_in_words(vector: FloatArray) -> str:
    """Return the three numbers with two digits, in brackets, without a negative zero."""
    return f"({', '.join(f'{round(float(value), 2) + 0.0:.2f}' for value in vector)})"
