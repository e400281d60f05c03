"""Vectors of three plain floats, for the path of every message: faster than arrays."""

from __future__ import annotations

import math
from typing import TypeAlias

Triple: TypeAlias = tuple[float, float, float]


def dot(a: Triple, b: Triple) -> float:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Triple, b: Triple) -> Triple:
    """Return a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def length(a: Triple) -> float:
    """Return the Euclidean length."""
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


def unit_triple(a: Triple) -> Triple:
    """Return the vector scaled to length one; ZeroDivisionError for a zero vector."""
    size = length(a)
    return (a[0] / size, a[1] / size, a[2] / size)


def plus(a: Triple, b: Triple) -> Triple:
    """Return a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def minus(a: Triple, b: Triple) -> Triple:
    """Return a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def scaled(a: Triple, factor: float) -> Triple:
    """Return factor a."""
    return (factor * a[0], factor * a[1], factor * a[2])


def distance(a: Triple, b: Triple) -> float:
    """Return the length of a - b."""
    return length(minus(a, b))


def interpolate(a: Triple, b: Triple, share: float) -> Triple:
    """Return a + share (b - a)."""
    return (
        a[0] + share * (b[0] - a[0]),
        a[1] + share * (b[1] - a[1]),
        a[2] + share * (b[2] - a[2]),
    )


def propagated(a: Triple, turn: Triple) -> Triple:
    """Return a direction fixed in the world, in body axes after the body turned.

    `a` is in the body axes before, `turn` the rotation vector of the body in radians: Rodrigues'
    formula for exp(-[turn]x) a.
    """
    p, q, r = turn
    x, y, z = a
    square = p * p + q * q + r * r
    if square < 1e-4:
        sine, versine = 1.0 - square / 6.0, 0.5 - square / 24.0
    else:
        angle = math.sqrt(square)
        sine, versine = math.sin(angle) / angle, (1.0 - math.cos(angle)) / square
    cx, cy, cz = y * r - z * q, z * p - x * r, x * q - y * p
    return (
        x + sine * cx + versine * (cy * r - cz * q),
        y + sine * cy + versine * (cz * p - cx * r),
        z + sine * cz + versine * (cx * q - cy * p),
    )
