"""The reference field in use: what was given by hand, and for the rest the model."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from magcal_ros.core.assessment.verdict import NO_REFERENCE
from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.earth_field.wmm import (
    VALIDITY,
    ModelField,
    NoModel,
    Place,
    model_field,
)
from magcal_ros.core.geometry.attitude import wrap_angle
from magcal_ros.core.knowledge import (
    DECLINATION_SIGMA_DEG,
    INCLINATION_SIGMA_DEG,
    STRENGTH_SIGMA_UT,
    Belief,
    ReferenceField,
)

DOUBTFUL = 3.0
"""Sigmas by which what is given, or calibrated, may differ from the model before it is said."""


class Unit(NamedTuple):
    """How a number is shown: the end of its key, the factor from SI, and the sign behind it."""

    suffix: str
    scale: float
    sign: str


UNITS = {
    "strength": Unit("ut", 1e6, " µT"),
    "inclination": Unit("deg", 180.0 / math.pi, "°"),
    "declination": Unit("deg", 180.0 / math.pi, "°"),
}


@dataclass(frozen=True)
class Local:
    """What crust, buildings and iron near by add to the Earth's field (1 σ)."""

    strength: float = STRENGTH_SIGMA_UT * 1e-6
    """Tesla."""
    inclination: float = math.radians(INCLINATION_SIGMA_DEG)
    declination: float = math.radians(DECLINATION_SIGMA_DEG)
    """Radians."""


@dataclass(frozen=True)
class Reference:
    """The reference field in use."""

    field: ReferenceField
    """The numbers."""
    source: str
    """Where they come from, in words."""
    complaints: tuple[str, ...] = ()
    """What the user should know about it."""

    @property
    def north(self) -> str:
        """Which north a yaw can be counted from: true or magnetic."""
        return "magnetic" if self.field.declination is None else "true"

    @property
    def facts(self) -> Mapping[str, Any]:
        """Everything in people's units, with stable keys; None for what is not known."""
        facts: dict[str, Any] = {"source": self.source}
        for name, belief in _beliefs(self.field):
            suffix, scale, _ = UNITS[name]
            known = not belief.is_unknown
            facts[f"{name}_{suffix}"] = round(belief.value * scale, 3) if known else None
            facts[f"{name}_sigma_{suffix}"] = round(belief.sigma * scale, 3) if known else None
        return {**facts, "complaints": list(self.complaints)}

    @property
    def words(self) -> str:
        """The numbers and where they come from, in one line."""
        numbers = [
            f"{name} {belief.value * UNITS[name].scale:.2f} ± "
            f"{belief.sigma * UNITS[name].scale:.2f}{UNITS[name].sign}"
            for name, belief in _beliefs(self.field)
            if not belief.is_unknown
        ]
        return f"{', '.join(numbers)} ({self.source})" if numbers else self.source


def resolve(
    given: ReferenceField, local: Local, place: Place | None, year: float | None
) -> Reference:
    """Take what was given by hand, number by number, and the rest from the model.

    Parameters
    ----------
    given : ReferenceField
        By hand; each number that is known wins over the model.
    local : Local
        Adds to the model's own uncertainty, in quadrature.
    place : Place or None
        Where the robot is; None if not known.
    year : float or None
        Decimal year; None if not known.

    Returns
    -------
    Reference
        Never raises: what the model cannot give is a complaint.
    """
    lacking = [name for name, belief in _beliefs(given) if belief.is_unknown]
    source = "unknown" if len(lacking) == len(UNITS) else "given"
    if place is None or year is None:
        return Reference(given, source)
    try:
        model = model_field(place, year)
    except NoModel as error:
        return Reference(given, source, (str(error),) if lacking else ())
    spot = f"{model.model} at {place.words}, {year:.1f}"
    field = _filled(given, local, model)
    doubts = [*_contradictions(given, local, model, spot), *_doubts(model, field)]
    if source == "unknown":
        source = spot
    elif lacking:
        known = " and ".join(name for name, _ in _beliefs(given) if name not in lacking)
        source = f"{known} given, the rest from the {spot}"
    return Reference(field, source, tuple(doubts))


def _beliefs(field: ReferenceField) -> Iterator[tuple[str, Belief]]:
    """Yield name and belief of each of the three numbers."""
    beliefs = (field.strength, field.inclination, field.declination_belief)
    return zip(UNITS, beliefs, strict=True)


def _filled(given: ReferenceField, local: Local, model: ModelField) -> ReferenceField:
    field = given
    if given.strength.is_unknown:
        field = replace(field, strength=_widened(model.strength, local.strength))
    if given.inclination.is_unknown:
        field = replace(field, inclination=_widened(model.inclination, local.inclination))
    if given.declination is None and model.level >= VALIDITY.blackout:
        declination = _widened(model.declination, local.declination)
        field = replace(field, declination=declination.value, declination_sigma=declination.sigma)
    return field


def _widened(belief: Belief, sigma: float) -> Belief:
    return Belief(belief.value, math.hypot(belief.sigma, sigma))


def _contradictions(
    given: ReferenceField, local: Local, model: ModelField, spot: str
) -> Iterator[str]:
    """Say which number given by hand the model does not believe: a wrong sign is easily given."""
    by_model = (model.strength, model.inclination, model.declination)
    around = (local.strength, local.inclination, local.declination)
    for (name, by_hand), theirs, sigma in zip(_beliefs(given), by_model, around, strict=True):
        unit = UNITS[name]
        off = by_hand.value - theirs.value
        if name == "declination":
            off = float(wrap_angle(off))
        if not by_hand.is_unknown and abs(off) > DOUBTFUL * math.hypot(theirs.sigma, sigma):
            yield (
                f"the {name} is given as {by_hand.value * unit.scale:.1f}"
                f"{unit.sign}, but the {spot} says {theirs.value * unit.scale:.1f}{unit.sign}: "
                "what is given is used; check it"
            )


def _doubts(model: ModelField, field: ReferenceField) -> tuple[str, ...]:
    found = []
    level = f"the level field is only {model.level * 1e6:.1f} µT this near to the magnetic pole"
    if model.level < VALIDITY.blackout:
        words = "no true north is published unless the declination is given by hand"
        found.append(
            f"{level}: a compass is of no use here"
            + (f", and {words}" if field.declination is None else "")
        )
    elif model.level < VALIDITY.caution:
        sigma = math.degrees(model.declination.sigma)
        found.append(f"{level}: the declination is uncertain by {sigma:.1f}° (1σ) or more")
    if model.years_late > 0.0:
        found.append(
            f"the date lies {model.years_late:.1f} years after the life of the {model.model}: its "
            "uncertainty has grown; check the clock, or bring magcal_ros up to date"
        )
    return tuple(found)


def made_elsewhere(calibration: Calibration, reference: ReferenceField) -> str:
    """Say that a calibration was made in another field than the reference; empty if not.

    Parameters
    ----------
    calibration : Calibration
        Its strength and dip are those of the place where it was made. One that was made without a
        reference says nothing about them.
    reference : ReferenceField
        Of the place where the robot is.
    """
    if NO_REFERENCE in calibration.evidence.not_shown or not reference.is_complete:
        return ""
    strength, dip = reference.strength, reference.inclination
    is_same = (
        abs(calibration.strength - strength.value) <= DOUBTFUL * strength.sigma
        and abs(calibration.inclination - dip.value) <= DOUBTFUL * dip.sigma
    )
    if is_same or strength.is_exact or dip.is_exact:
        return ""
    return (
        f"the calibration was made in a field of {calibration.strength * 1e6:.1f} µT, dip "
        f"{math.degrees(calibration.inclination):.1f}°, and here it is {strength.value * 1e6:.1f} "
        f"µT, dip {math.degrees(dip.value):.1f}°: made elsewhere? Calibrate again here"
    )
