"""The unit of the field, by its strength without hard iron where the movement shows that."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from magcal_ros.core.doctor.explanations import Way
from magcal_ros.core.doctor.health import Finding
from magcal_ros.core.geometry.attitude import unit
from magcal_ros.core.knowledge import Belief, Knowledge
from magcal_ros.core.samples.alignment import FIELD, UP
from magcal_ros.core.samples.units import unit_by_strength

VAGUE = 0.1  # relative standard deviation of the strength beyond which it is not shown
WRONG_UNIT = "field_unit"  # key of the line


def is_vague(strength: Belief) -> bool:
    """Return whether the movement does not show this strength."""
    return not strength.sigma <= VAGUE * strength.value


def strength_of(way: Way) -> Belief:
    """Return the strength without hard iron as published, by one way."""
    size, vector, sigma = way.part.size, way.state[FIELD], way.sigma[FIELD]
    return Belief(float(np.linalg.norm(vector)) * size, float(np.linalg.norm(sigma)) * size)


def strength_of_level(way: Way, knowledge: Knowledge) -> Belief:
    """Return the same by the level field, which a level turn shows, and the known inclination."""
    dip = knowledge.reference.inclination
    vector, up = way.state[FIELD], unit(way.state[UP])
    level = vector - float(vector @ up) * up
    share = math.cos(dip.value)
    if dip.is_unknown or share <= 0.0 or not level.any():
        return Belief.unknown()
    strength = way.part.size * float(np.linalg.norm(level)) / share
    off = way.part.size * float(np.linalg.norm(way.sigma[FIELD] * unit(level))) / share
    return Belief(strength, math.hypot(off, strength * math.tan(dip.value) * dip.sigma))


def by_strength(lines: list[Finding], way: Way, knowledge: Knowledge) -> list[Finding]:
    """Return the lines with a wrong unit judged by the strength, where the movement shows it."""
    strength = strength_of(way)
    if is_vague(strength):
        strength = strength_of_level(way, knowledge)
    hint = "" if is_vague(strength) else unit_by_strength(strength.value, strength.sigma)
    if not (hint and has_wrong_unit(lines)):
        return lines
    size = f"{strength.value:.3g} ± {strength.sigma:.2g} T as published, without hard iron"
    return [
        replace(line, evidence=size, remedy=hint) if line.key == WRONG_UNIT else line
        for line in lines
    ]


def has_wrong_unit(lines: list[Finding]) -> bool:
    """Return whether a line says that the field is not in tesla."""
    return any(line.key == WRONG_UNIT and line.is_wrong for line in lines)
