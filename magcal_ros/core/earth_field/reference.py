"""The reference field: numbers given by hand, and the model at a place."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from magcal_ros.core.assessment.verdict import NO_REFERENCE
from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.figure import Figure
from magcal_ros.core.earth_field.wmm import (
    EARTH_RADIUS,
    VALIDITY,
    ModelField,
    NoModel,
    Place,
    model_field,
)
from magcal_ros.core.geometry.attitude import wrap_angle
from magcal_ros.core.knowledge import (
    CLEAR,
    DECLINATION_SIGMA_DEG,
    INCLINATION_SIGMA_DEG,
    STRENGTH_SIGMA_UT,
    Belief,
    ReferenceField,
    knowledge_of,
)
from magcal_ros.core.samples.streams import PositionSample


@dataclass(frozen=True)
class PositionTuning:
    """When the robot counts as moved to another place."""

    moved: float = 10_000.0
    """Metres after which the field is computed again: it changes by 0.1° or 0.1 µT at most."""
    confirmed: int = 3  # consecutive fixes that must agree on a new place: one may be an outlier
    far: float = 50_000.0
    """Metres from the given position, or from the first fix, beyond which a warning is given."""


TUNING = PositionTuning()


NO_FIX = "say that there is no fix"
NOT_FINITE = "are not finite"
OFF_EARTH = "lie outside of -90 to 90°, -180 to 180°, and -1 to 850 km of altitude"
NOWHERE = "lie at 0° N 0° E, where receivers without a fix are"


@dataclass(frozen=True)
class Fix:
    """One message of a receiver."""

    has_fix: bool  # by the status of the message
    latitude_deg: float
    longitude_deg: float
    altitude: float
    """Degrees and metres; the altitude may be NaN."""
    stamp: float  # seconds


def place_of(fix: Fix) -> Place | str:
    """Return the place of a fix, or why it has none."""
    spot = (fix.latitude_deg, fix.longitude_deg)
    low, high = VALIDITY.altitudes
    # A missing altitude does little harm: a hundred metres change the strength by 0.005%.
    altitude = fix.altitude if math.isfinite(fix.altitude) else 0.0
    if not fix.has_fix:
        return NO_FIX
    if not all(math.isfinite(value) for value in spot):
        return NOT_FINITE
    if abs(spot[0]) > 90.0 or abs(spot[1]) > 180.0 or not low <= altitude <= high:
        return OFF_EARTH
    if spot == (0.0, 0.0):
        return NOWHERE
    return Place(*spot, altitude)


class Fixes:
    """The position by a receiver's fixes.

    `place` is None before the first good fix; `stamp` (s) is the stamp of the newest good fix, zero
    before the first.
    """

    def __init__(self) -> None:
        self.place: Place | None = None
        self.stamp = 0.0
        self._first: Place | None = None
        self._candidates: list[Place] = []
        self._faults: set[str] = set()

    def add(self, fix: Fix) -> bool:
        """Add a fix; return whether the place has changed."""
        place = place_of(fix)
        if isinstance(place, str):
            self._faults.add(place)
            return False
        self.stamp = fix.stamp
        if self.place is not None:
            is_here = self.place.distance(place) <= TUNING.moved
            near = [c for c in self._candidates if c.distance(place) <= TUNING.moved]
            self._candidates = [] if is_here else [*near, place]
            if len(self._candidates) < TUNING.confirmed:
                return False
        self._first = self._first or place
        self.place, self._candidates = place, []
        return True

    def complaints(self, given: Place | None) -> list[str]:
        """Return the warnings on the fixes; empty if there are none."""
        place, first = self.place, self._first
        if place is None or first is None:
            return [
                f"gps/fix: no position yet, its messages {each}" for each in sorted(self._faults)
            ]
        away = (given or first).distance(place)
        if away <= TUNING.far:
            return []
        if given is None:
            return [
                f"gps/fix has moved by {away / 1000.0:.0f} km, from {first.words} to "
                f"{place.words}: the reference field was computed again"
            ]
        return [
            f"gps/fix says {place.words}, {away / 1000.0:.0f} km from the given position "
            f"{given.words}, which is used: correct reference.latitude_deg and "
            "reference.longitude_deg, or leave them out"
        ]


class LocalPlane:
    """The plane that touches the Earth at the first good fix, its `origin` (equirectangular).

    The error of its scale is 0.4% at most.
    """

    def __init__(self) -> None:
        self.origin: Place | None = None

    def position(self, fix: Fix) -> PositionSample | None:
        """Return a fix in the plane, metres; None if it has no position."""
        place = place_of(fix)
        if isinstance(place, str):
            return None
        origin = self.origin = self.origin or place
        north = math.radians(place.latitude_deg - origin.latitude_deg)
        east = math.radians(math.remainder(place.longitude_deg - origin.longitude_deg, 360.0))
        shrink = math.cos(math.radians(origin.latitude_deg))
        return PositionSample(fix.stamp, EARTH_RADIUS * east * shrink, EARTH_RADIUS * north)


class ReferenceUnit(NamedTuple):
    """How a number is shown: suffix of its key, factor from SI, and symbol."""

    suffix: str
    scale: float
    sign: str


UNITS = {
    "strength": ReferenceUnit("ut", 1e6, " µT"),
    "inclination": ReferenceUnit("deg", 180.0 / math.pi, "°"),
    "declination": ReferenceUnit("deg", 180.0 / math.pi, "°"),
}


class LocalField(NamedTuple):
    """Local deviation from the Earth's main field by crust, buildings and iron (1 σ)."""

    strength: float = STRENGTH_SIGMA_UT * 1e-6  # tesla
    inclination: float = math.radians(INCLINATION_SIGMA_DEG)
    declination: float = math.radians(DECLINATION_SIGMA_DEG)
    """Radians."""


@dataclass(frozen=True)
class GivenReference:
    """The Earth's field and the place as given by the user."""

    field: ReferenceField
    local: LocalField
    place: Place | None
    """None unless latitude and longitude are given."""
    half_place: bool  # whether only one of latitude and longitude is given

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> GivenReference:
        """Build from the values of the parameters `reference.*`; NaN means not given."""
        sigmas = ("strength_sigma_ut", "inclination_sigma_deg", "declination_sigma_deg")
        names = ("strength_ut", "inclination_deg", "declination_deg", *sigmas)
        known = knowledge_of(**{name: values[name] for name in names})
        strength, *angles = (values[name] for name in sigmas)
        local = LocalField(strength * 1e-6, *map(math.radians, angles))
        spot = values["latitude_deg"], values["longitude_deg"]
        unset = [math.isnan(angle) for angle in spot]
        place = None if any(unset) else Place(*spot, values["altitude_m"])
        return cls(known.reference, local, place, unset[0] != unset[1])


@dataclass(frozen=True)
class Reference:
    """The reference field in use."""

    field: ReferenceField
    source: str
    """Source of the numbers, in words."""
    complaints: tuple[str, ...] = ()

    @property
    def is_known(self) -> bool:
        """Whether any of its numbers is known."""
        return not all(belief.is_unknown for _, belief in _beliefs(self.field))

    @property
    def north(self) -> str:
        """The zero of a yaw: "true" or "magnetic" north."""
        return "magnetic" if self.field.declination is None else "true"

    @property
    def facts(self) -> Mapping[str, Any]:
        """Numbers, source and complaints for JSON, in µT and degrees; None if unknown."""
        facts: dict[str, Any] = {"source": self.source}
        for name, belief in _beliefs(self.field):
            suffix, scale, _ = UNITS[name]
            known = not belief.is_unknown
            facts[f"{name}_{suffix}"] = round(belief.value * scale, 3) if known else None
            facts[f"{name}_sigma_{suffix}"] = round(belief.sigma * scale, 3) if known else None
        return {**facts, "complaints": list(self.complaints)}

    @property
    def words(self) -> str:
        """The numbers and their source, in one line."""
        numbers = [
            f"{name} {belief.value * UNITS[name].scale:.2f} ± "
            f"{belief.sigma * UNITS[name].scale:.2f}{UNITS[name].sign}"
            for name, belief in _beliefs(self.field)
            if not belief.is_unknown
        ]
        return f"{', '.join(numbers)} ({self.source})" if numbers else self.source


def resolve(
    given: ReferenceField, local: LocalField, place: Place | None, year: float | None
) -> Reference:
    """Return the reference field: given numbers, and the others from the model.

    The variances of local deviation and model are added. `place` and `year` (decimal) are None if
    unknown. A missing model is a complaint, not an exception.
    """
    missing = [name for name, belief in _beliefs(given) if belief.is_unknown]
    source = "unknown" if len(missing) == len(UNITS) else "given"
    if place is None or year is None:
        return Reference(given, source)
    try:
        model = model_field(place, year)
    except NoModel as error:
        return Reference(given, source, (str(error),) if missing else ())
    spot = f"{model.model} at {place.words}, {year:.1f}"
    pairs = zip((model.strength, model.inclination, model.declination), local, strict=True)
    here = [Belief(each.value, math.hypot(each.sigma, sigma)) for each, sigma in pairs]
    strength, inclination, north = (
        modelled if own.is_unknown else own
        for (_, own), modelled in zip(_beliefs(given), here, strict=True)
    )
    field = replace(given, strength=strength, inclination=inclination)
    if model.level >= VALIDITY.blackout:
        field = replace(field, declination=north.value, declination_sigma=north.sigma)
    doubts = [*_contradictions(given, here, spot), *_doubts(model, field)]
    if source == "unknown":
        source = spot
    elif missing:
        known = " and ".join(name for name, _ in _beliefs(given) if name not in missing)
        source = f"{known} given, the rest from the {spot}"
    return Reference(field, source, tuple(doubts))


def _beliefs(field: ReferenceField) -> Iterator[tuple[str, Belief]]:
    """Yield name and belief of each of the three numbers."""
    beliefs = (field.strength, field.inclination, field.declination_belief)
    return zip(UNITS, beliefs, strict=True)


def _contradictions(given: ReferenceField, here: Sequence[Belief], spot: str) -> Iterator[str]:
    """Yield a warning for each number given by hand that contradicts the model here."""
    for (name, by_hand), theirs in zip(_beliefs(given), here, strict=True):
        unit = UNITS[name]
        # The strength in tesla is far below pi.
        off = float(wrap_angle(by_hand.value - theirs.value))
        if not by_hand.is_unknown and abs(off) > CLEAR * theirs.sigma:
            yield (
                f"the {name} is given as {by_hand.value * unit.scale:.1f}"
                f"{unit.sign}, but it is {theirs.value * unit.scale:.1f}{unit.sign} by the {spot}: "
                "the given number is used; check it"
            )


def _doubts(model: ModelField, field: ReferenceField) -> tuple[str, ...]:
    found = []
    level = f"the level field is only {model.level * 1e6:.1f} µT this near to the magnetic pole"
    if model.level < VALIDITY.blackout:
        words = ", and no true north is published unless the declination is given by hand"
        more = words if field.declination is None else ""
        found.append(f"{level}: a compass is of no use here{more}")
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
    """Return the warning that a calibration was made in another field; empty if it was not.

    The references are compared, not the estimated fields, which contain the disturbance by steel at
    the place of the turn. The warning is empty for a calibration without a reference. For an old
    file, which does not store the reference, the estimated field is used.
    """
    if NO_REFERENCE in calibration.evidence.not_shown or not reference.is_complete:
        return ""
    strength, dip = reference.strength, reference.inclination
    evidence = calibration.evidence
    size = evidence.figure(Figure.REFERENCE_STRENGTH, calibration.strength)
    angle = evidence.figure(Figure.REFERENCE_INCLINATION, calibration.inclination)
    is_same = (
        abs(size - strength.value) <= CLEAR * strength.sigma
        and abs(angle - dip.value) <= CLEAR * dip.sigma
    )
    if is_same or strength.is_exact or dip.is_exact:
        return ""
    return (
        f"the calibration was made in a field of {size * 1e6:.1f} µT, inclination "
        f"{math.degrees(angle):.1f}°, but here it is {strength.value * 1e6:.1f} "
        f"µT, inclination {math.degrees(dip.value):.1f}°: if it was made elsewhere, calibrate "
        "again here"
    )
