"""The lines of Python that repeat a fit from its `samples.csv`."""

from __future__ import annotations

import math

from magcal_ros.core.knowledge import Belief, Knowledge


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
