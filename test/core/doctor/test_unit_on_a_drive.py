"""The gyro's unit is found in bends of a street, although no hypothesis fits the field well."""

import math
from dataclasses import replace

import numpy as np
import pytest
from long_form import first_of

from magcal_ros.core.doctor import examine
from magcal_ros.core.geometry import exp_rotations
from magcal_ros.core.samples import SensorLog

SECONDS, STEP, SPEED, PASSES = 100.0, 0.04, 8.0, 4.0
"""Duration and time between samples, the car's speed in m/s, and how long it passes a place."""


def log_of(seed, bent=3e-6):
    """A car in a street that bends the field by so many tesla per axis."""
    rng = np.random.default_rng([57, seed])
    time = np.arange(0.0, SECONDS, STEP)
    bends = np.cumsum(rng.uniform(4.0, 12.0, 30))
    angles = rng.choice([0.0, 0.0, 1.0, -1.0], 30) * rng.uniform(0.5, 1.7, 30)
    rate = 0.5 / 1.2 * np.cosh((time[:, None] - bends) / 1.2) ** -2.0 @ angles
    turned = exp_rotations(-np.outer(np.cumsum(rate) * STEP, [0.0, 0.0, 1.0]))
    place, kept = np.zeros((len(time), 3)), math.exp(-STEP / PASSES)
    for row, new in enumerate(rng.normal(0.0, bent * math.sqrt(1.0 - kept**2), (len(time), 3))):
        place[row] = kept * place[row - 1] + new
    field = np.einsum("nij,nj->ni", turned, np.array([0.0, 20e-6, -43e-6]) + place)
    field += np.array([15e-6, -8e-6, 10e-6]) + rng.normal(0.0, 0.3e-6, field.shape)
    force = np.column_stack([0.0 * rate, SPEED * rate, 0.0 * rate + 9.81])
    rates = np.outer(rate, [0.0, 0.0, 1.0]) + rng.normal(0.0, 2e-3, field.shape)
    return SensorLog(time, force + rng.normal(0.0, 0.05, field.shape), rates, time, field)


def units(log):
    return [f for f in examine(log).findings if f.key == "rate_unit" and f.is_wrong]


@pytest.mark.nightly
@pytest.mark.parametrize("seed", first_of(range(8)))
def test_degrees_for_radians_are_named(seed):
    log = log_of(seed)
    assert not units(log)
    (line,) = units(replace(log, rate=math.degrees(1.0) * log.rate))
    assert "57.3 times too large" in line.remedy
