"""The field of a spherical harmonic model at a place and a date (WMM2025 Technical Report, 1.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

MODEL_RADIUS = 6371.2
"""Kilometres: the sphere to which the coefficients belong."""

SEMI_MAJOR = 6378.137
FLATTENING = 1.0 / 298.257223563
"""WGS 84, kilometres."""

ECCENTRICITY_SQUARED = FLATTENING * (2.0 - FLATTENING)


class Term(NamedTuple):
    """One degree and order: g and h in nT at the epoch, and their change in nT a year."""

    degree: int
    order: int
    g: float
    h: float
    g_rate: float
    h_rate: float


@dataclass(frozen=True)
class Harmonics:
    """A model of the main field.

    Parameters
    ----------
    epoch : float
        Decimal year for which g and h hold.
    terms : tuple of Term
        Schmidt semi-normalised.
    """

    epoch: float
    terms: tuple[Term, ...]

    @classmethod
    def parse(cls, text: str) -> Harmonics:
        """Read a .COF file: a line with the epoch, a line a term, and rows of nines."""
        head, *lines = text.splitlines()
        rows = [line.split() for line in lines if not line.startswith("9999")]
        terms = (Term(int(n), int(m), *map(float, numbers)) for n, m, *numbers in rows)
        return cls(float(head.split()[0]), tuple(terms))

    def field(
        self, latitude: float, longitude: float, altitude_km: float, year: float
    ) -> tuple[float, float, float]:
        """Return the field north, east and down, tesla.

        Parameters
        ----------
        latitude, longitude : float
            Geodetic, radians.
        altitude_km : float
            Kilometres above the ellipsoid.
        year : float
            Decimal year.
        """
        sin_lat, cos_lat = math.sin(latitude), math.cos(latitude)
        normal = SEMI_MAJOR / math.sqrt(1.0 - ECCENTRICITY_SQUARED * sin_lat**2)
        outward = (normal + altitude_km) * cos_lat
        upward = (normal * (1.0 - ECCENTRICITY_SQUARED) + altitude_km) * sin_lat
        radius = math.hypot(outward, upward)
        sine, cosine = upward / radius, outward / radius
        north, east, down = self._on_sphere(sine, cosine, longitude, radius, year - self.epoch)
        # The vertical of the sphere leans towards the pole from that of the ellipsoid.
        sin_lean = sine * cos_lat - cosine * sin_lat
        cos_lean = cosine * cos_lat + sine * sin_lat
        return (
            (north * cos_lean - down * sin_lean) * 1e-9,
            east * 1e-9,
            (north * sin_lean + down * cos_lean) * 1e-9,
        )

    def _on_sphere(
        self, sine: float, cosine: float, longitude: float, radius: float, years: float
    ) -> tuple[float, float, float]:
        """Return the field along the sphere's north, east and down, nT."""
        highest = max(term.degree for term in self.terms)
        legendre = _legendre(highest, sine, cosine)
        north = east = down = 0.0
        for n, m, g0, h0, g_rate, h_rate in self.terms:
            g, h = g0 + years * g_rate, h0 + years * h_rate
            cos_m, sin_m = math.cos(m * longitude), math.sin(m * longitude)
            size = (MODEL_RADIUS / radius) ** (n + 2)
            over_cosine, value, slope = legendre[n][m]
            along = size * (g * cos_m + h * sin_m)
            north -= along * slope
            east += size * m * (g * sin_m - h * cos_m) * over_cosine
            down -= (n + 1) * along * value
        return north, east, down


def _legendre(highest: int, sine: float, cosine: float) -> list[list[tuple[float, float, float]]]:
    """Return Schmidt's semi-normalised functions of the latitude by degree and order.

    Each comes as P/cos (for orders above zero, finite at the poles), P, and dP by the latitude;
    all three obey the same recursion, so that nothing is divided by the cosine.
    """
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
