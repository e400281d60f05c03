"""The third coordinate of the centre: how much of the reference field lies along the axis."""

from __future__ import annotations

import math
from dataclasses import dataclass

from magcal_ros.core.errors import Reason, Refusal
from magcal_ros.core.knowledge import ReferenceField
from magcal_ros.core.methods.design_tip.axis import TurnAxis
from magcal_ros.core.methods.design_tip.installation import Candidate

RADIUS_SLACK = 1.05
"""A radius up to this many times the strength is taken for a field across the axis."""


@dataclass(frozen=True)
class BelievedField:
    """The reference field after the turn."""

    strength: float
    inclination: float
    """Tesla, radians."""
    axial: float
    """Its part along the axis, downwards, tesla."""
    basis: str
    """What it rests on, for people."""
    axial_unknown: bool = False
    """Whether the hard iron along the axis is an assumption."""


def believe(reference: ReferenceField, candidate: Candidate, axis: TurnAxis) -> BelievedField:
    """Find the axial part from what is known of the reference field.

    Gravity times field is the strength times the sine of the inclination, in the world as in
    the body: c k + d = B sin(i), where c is the axis's cosine from the vertical, k the field
    along it and d the product across it. Besides, k² + radius² = B². The design tip takes k from
    the reference at a start that faces north on level ground; this needs neither.

    Parameters
    ----------
    reference : ReferenceField
        Strength and inclination, each known or not.
    candidate : Candidate
        An installation and the circle that goes with it.
    axis : TurnAxis
        The turn's axis.

    Raises
    ------
    Refusal
        If the circle contradicts the only number known.
    """
    strength, inclination = reference.strength, reference.inclination
    if reference.is_complete:
        axial = _axial(strength.value, inclination.value, candidate, axis)
        basis = "strength and inclination as given"
        return BelievedField(strength.value, inclination.value, axial, basis)
    if not inclination.is_unknown:
        return _from_inclination(inclination.value, candidate, axis)
    if not strength.is_unknown:
        return _from_strength(strength.value, candidate, axis)
    return _with_axial(
        candidate.circle.height,
        candidate,
        axis,
        "neither strength nor inclination is known: no hard iron along the axis is assumed",
        axial_unknown=True,
    )


def _axial(strength: float, inclination: float, candidate: Candidate, axis: TurnAxis) -> float:
    vertical = strength * math.sin(inclination)
    return (vertical - candidate.gravity_dot_field) / axis.axial_gravity


def _from_inclination(inclination: float, candidate: Candidate, axis: TurnAxis) -> BelievedField:
    sine, cosine = math.sin(inclination), axis.axial_gravity
    across, radius = candidate.gravity_dot_field, candidate.circle.radius
    # (B sin(i) - d)² + c² radius² = c² B², a quadratic in B.
    root = across**2 + radius**2 * (cosine**2 - sine**2)
    if root < 0.0:
        raise _contradiction("inclination")
    denominators = [sine * across + sign * cosine * math.sqrt(root) for sign in (1.0, -1.0)]
    constant = across**2 + cosine**2 * radius**2
    # The product of the roots is constant/(s² - c²): this form stays finite where s = c.
    strengths = [constant / value for value in denominators if value > 0.0]
    if not strengths:
        raise _contradiction("inclination")
    fields = [
        BelievedField(
            strength,
            inclination,
            _axial(strength, inclination, candidate, axis),
            "inclination as given, strength from the circle's radius",
        )
        for strength in strengths
    ]
    return min(fields, key=lambda field: abs(candidate.circle.height - field.axial))


def _from_strength(strength: float, candidate: Candidate, axis: TurnAxis) -> BelievedField:
    radius = candidate.circle.radius
    if radius > RADIUS_SLACK * strength:
        raise _contradiction("strength")
    size = math.sqrt(max(strength**2 - radius**2, 0.0))
    axial = math.copysign(size, candidate.circle.height)
    basis = "strength as given, inclination from the circle's radius and the smaller hard iron"
    return _with_axial(axial, candidate, axis, basis)


def _with_axial(
    axial: float, candidate: Candidate, axis: TurnAxis, basis: str, *, axial_unknown: bool = False
) -> BelievedField:
    strength = math.hypot(candidate.circle.radius, axial)
    vertical = axis.axial_gravity * axial + candidate.gravity_dot_field
    inclination = math.asin(max(-1.0, min(1.0, vertical / strength)))
    return BelievedField(strength, inclination, axial, basis, axial_unknown)


def _contradiction(known: str) -> Refusal:
    return Refusal(
        Reason.NO_SOLUTION,
        f"The circle's radius contradicts the {known} of the reference field. Check the "
        "reference, the field's unit (tesla) and the soft-iron gains.",
    )
