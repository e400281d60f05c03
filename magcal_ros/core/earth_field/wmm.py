"""The Earth's field at a place and a date, from the World Magnetic Model."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files

import numpy as np

from magcal_ros.core.errors import MagcalError
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.knowledge import Belief

EARTH_RADIUS = 6_371_200.0  # metres: the sphere to which the coefficients belong

SEMI_MAJOR = 6378.137
FLATTENING = 1.0 / 298.257223563
"""WGS 84, kilometres."""


@dataclass(frozen=True, eq=False)
class Harmonics:
    """A model of the main field."""

    epoch: float  # decimal year for which g and h are valid
    terms: FloatArray
    """Degree, order, g and h in nT (Schmidt), and their change in nT per year. Shape (k, 6)."""

    @classmethod
    def parse(cls, text: str) -> Harmonics:
        """Parse a .COF file: a line with the epoch, a line for each term, and rows of nines."""
        head, *lines = text.splitlines()
        rows = [line.split() for line in lines if not line.startswith("9999")]
        return cls(float(head.split()[0]), np.array(rows, dtype=np.float64))

    def field(
        self, latitude: float, longitude: float, altitude_km: float, year: float
    ) -> tuple[float, float, float]:
        """Return the field north, east and down, tesla, at geodetic radians and a decimal year."""
        sin_lat, cos_lat = math.sin(latitude), math.cos(latitude)
        polar = (1.0 - FLATTENING) ** 2
        normal = SEMI_MAJOR / math.sqrt(cos_lat**2 + polar * sin_lat**2)
        outward = (normal + altitude_km) * cos_lat
        upward = (polar * normal + altitude_km) * sin_lat
        radius = math.hypot(outward, upward)
        sine, cosine = upward / radius, outward / radius
        n, m = self.terms[:, :2].T
        g, h = (self.terms[:, 2:4] + (year - self.epoch) * self.terms[:, 4:]).T
        table = np.array(_legendre(int(n.max()), sine, cosine))
        over_cosine, value, slope = table[n.astype(int), m.astype(int)].T
        cos_m, sin_m = np.cos(m * longitude), np.sin(m * longitude)
        size = (0.001 * EARTH_RADIUS / radius) ** (n + 2)
        along = size * (g * cos_m + h * sin_m)
        # Along the sphere's north, east and down, nT.
        north, down = -float(along @ slope), -float(((n + 1) * along) @ value)
        east = float((size * m * (g * sin_m - h * cos_m) * over_cosine).sum())
        # The vertical of the sphere is tilted towards the pole from that of the ellipsoid.
        sin_lean = sine * cos_lat - cosine * sin_lat
        cos_lean = cosine * cos_lat + sine * sin_lat
        return (
            (north * cos_lean - down * sin_lean) * 1e-9,
            east * 1e-9,
            (north * sin_lean + down * cos_lean) * 1e-9,
        )


def _legendre(highest: int, sine: float, cosine: float) -> list[list[tuple[float, float, float]]]:
    """Return Schmidt's semi-normalised functions by degree and order: P/cos, P, dP by latitude."""
    # All three obey the same recursion, so that nothing is divided by the cosine.
    table = [[(0.0, 0.0, 0.0)] * (highest + 2) for _ in range(highest + 1)]
    table[0][0] = (0.0, 1.0, 0.0)
    for m in range(highest + 1):
        if m:
            scale = math.sqrt((2.0 * m - 1.0) / (2.0 * m)) if m > 1 else 1.0
            _, value, slope = table[m - 1][m - 1]
            # P/cos of order m is P of order m - 1, scaled.
            diagonal = (scale * value, scale * cosine * value)
            table[m][m] = (*diagonal, scale * (cosine * slope - sine * value))
        for n in range(m + 1, highest + 1):
            one, two = table[n - 1][m], table[n - 2][m] if n - 2 >= m else (0.0, 0.0, 0.0)
            up, back = 2.0 * n - 1.0, math.sqrt((n - 1.0) ** 2 - m**2)
            whole = math.sqrt(n * n - m * m)
            table[n][m] = (
                (up * sine * one[0] - back * two[0]) / whole,
                (up * sine * one[1] - back * two[1]) / whole,
                (up * (sine * one[2] + cosine * one[1]) - back * two[2]) / whole,
            )
    return table


@dataclass(frozen=True)
class Validity:
    """Where and for how long a model is valid."""

    altitudes: tuple[float, float] = (-1000.0, 850_000.0)
    """Metres between which the model is valid (WMM2025 Technical Report)."""
    first_year: float = 2015.0
    """Start of the oldest included model; a clock that was never set is earlier."""
    life: float = 5.0  # years for which a model is made
    most_years_late: float = 5.0
    """Years after the end of a model during which it is still used, with larger sigmas."""
    drift_strength: float = 30e-9
    """Growth of a component's error after the model's life, tesla per year. Extrapolated for five
    to ten years, WMM2010, 2015 and 2020 differ from their successors by 24 to 28 nT and 0.03 to
    0.05° per year (RMS over the globe)."""
    drift_inclination: float = math.radians(0.05)  # the same in radians per year
    blackout: float = 2000e-9
    """Tesla of level field below which a compass is of no use (WMM2025 report, blackout zone)."""
    caution: float = 6000e-9
    """Tesla of level field below which a compass is unreliable (caution zone)."""


VALIDITY = Validity()


@dataclass(frozen=True)
class ModelErrors:
    """The published error model (1 σ) of a World Magnetic Model."""

    strength_nt: float
    inclination_deg: float
    """The same everywhere."""
    declination_deg: float
    declination_nt_deg: float
    """√(declination_deg² + (declination_nt_deg / level field in nT)²)."""


ERRORS = {
    2015: ModelErrors(152.0, 0.22, 0.23, 5430.0),
    2020: ModelErrors(148.0, 0.21, 0.26, 5625.0),
    2025: ModelErrors(138.0, 0.20, 0.26, 5417.0),
}
"""By the year in which a model begins: the included models (their Technical Reports)."""


class NoModel(MagcalError):
    """There is no World Magnetic Model for a date; the text says what to do."""


@dataclass(frozen=True)
class Place:
    """A place on Earth (WGS 84)."""

    latitude_deg: float
    longitude_deg: float
    """Degrees, positive north and east."""
    altitude: float = 0.0
    """Metres above the ellipsoid or the sea; the difference does not matter here."""

    def __post_init__(self) -> None:
        low, high = VALIDITY.altitudes
        on_earth = abs(self.latitude_deg) <= 90.0 and abs(self.longitude_deg) <= 180.0
        if not (on_earth and low <= self.altitude <= high):
            raise ValueError(f"there is no field model for {self.words}, {self.altitude:g} m")

    @property
    def words(self) -> str:
        """The place in degrees, as 48.10°N 11.60°E."""
        north, east = self.latitude_deg, self.longitude_deg
        return (
            f"{abs(north):.2f}°{'N' if north >= 0.0 else 'S'} "
            f"{abs(east):.2f}°{'E' if east >= 0.0 else 'W'}"
        )

    def distance(self, other: Place) -> float:
        """Return the distance to another place along the ground, metres (haversine)."""
        a, b = math.radians(self.latitude_deg), math.radians(other.latitude_deg)
        east = math.radians(other.longitude_deg - self.longitude_deg)
        share = math.sin((b - a) / 2.0) ** 2 + math.cos(a) * math.cos(b) * math.sin(east / 2.0) ** 2
        return 2.0 * EARTH_RADIUS * math.asin(math.sqrt(min(share, 1.0)))


@dataclass(frozen=True)
class ModelField:
    """The field of the model, with its uncertainty."""

    strength: Belief
    inclination: Belief
    declination: Belief
    """Tesla and radians, signs as in `ReferenceField`. The sigmas are those of the published error
    model, which is valid outdoors anywhere on Earth."""
    model: str  # name of the model
    years_late: float = 0.0  # years from the end of the model's life to the date; zero inside it

    @property
    def level(self) -> float:
        """Horizontal part, tesla."""
        return self.strength.value * math.cos(self.inclination.value)


def decimal_year(stamp: float) -> float:
    """Return seconds since 1970 (UTC) as a year with its fraction."""
    moment = np.datetime64(math.floor(stamp), "s")
    year = moment.astype("datetime64[Y]")
    begin, end = year.astype("datetime64[s]"), (year + 1).astype("datetime64[s]")
    return 1970.0 + int(year.astype(int)) + float((moment - begin) / (end - begin))


def year_of(stamps: Iterable[float], clock: float) -> float:
    """Return the earliest plausible date of stamps as a decimal year; without one, that of a clock.

    All are in seconds since 1970. Stamps since the start of a simulation or a machine are ignored.
    """
    years = [decimal_year(stamp) for stamp in stamps if math.isfinite(stamp)]
    return min((year for year in years if year >= VALIDITY.first_year), default=decimal_year(clock))


def model_field(place: Place, year: float) -> ModelField:
    """Return the field of the World Magnetic Model for a place and a decimal year.

    After the newest model's life its sigmas grow each year. Raises `NoModel` some years later.
    """
    base = max((first for first in ERRORS if first <= year), default=0)
    late = max(year - (base + VALIDITY.life), 0.0)
    if not base or not late <= VALIDITY.most_years_late:
        raise NoModel(
            f"there is no World Magnetic Model for the year {year:.1f}: set the clock, or bring "
            "magcal_ros up to date"
        )
    angles = math.radians(place.latitude_deg), math.radians(place.longitude_deg)
    north, east, down = _load(base).field(*angles, place.altitude / 1000.0, year)
    level = math.hypot(north, east)
    errors = ERRORS[base]
    by_place = errors.declination_nt_deg * 1e-9 / max(level, 1e-9)
    by_drift = late * VALIDITY.drift_strength / max(level, 1e-9)
    declination = math.radians(math.hypot(errors.declination_deg, by_place))
    inclination = math.radians(errors.inclination_deg)
    return ModelField(
        Belief(
            math.hypot(level, down),
            math.hypot(errors.strength_nt * 1e-9, late * VALIDITY.drift_strength),
        ),
        Belief(math.atan2(down, level), math.hypot(inclination, late * VALIDITY.drift_inclination)),
        Belief(math.atan2(east, north), min(math.hypot(declination, by_drift), math.pi)),
        f"World Magnetic Model {base}",
        late,
    )


@lru_cache(maxsize=len(ERRORS))
def _load(base: int) -> Harmonics:
    # As published by NOAA and BGS (public domain); for 2015 the second edition, WMM2015v2.
    coefficients = files("magcal_ros.core.earth_field") / "coefficients" / f"WMM{base}.COF"
    return Harmonics.parse(coefficients.read_text(encoding="ascii"))
