import numpy as np
import pytest
from magcal_ros.core.assessment.health import field_findings, imu_findings, stamps_finding

from magcal_ros.core.assessment.grading import Grade

COUNT = 600


@pytest.fixture
def field():
    angle = np.linspace(0.0, 7.0, COUNT)
    noise = np.random.default_rng(1).standard_normal((COUNT, 3))
    level = np.column_stack([np.cos(angle), -np.sin(angle), np.full(COUNT, 1.5)])
    return 25e-6 * level + 0.3e-6 * noise


@pytest.fixture
def force():
    return np.array([0.0, 0.0, 9.8]) + 0.05 * np.random.default_rng(2).standard_normal((COUNT, 3))


def wrong(findings):
    return {f.name for f in findings if f.grade is not Grade.EXCELLENT}


def test_good_streams_are_called_good(field, force):
    jitter = np.random.default_rng(3).uniform(-4e-3, 4e-3, COUNT)
    assert stamps_finding("field", 0.025 * np.arange(COUNT) + jitter).grade is Grade.EXCELLENT
    assert not wrong(field_findings(field))
    assert not wrong(imu_findings(force, 0.01 * force))


def test_one_gap_is_no_burst():
    time = 0.025 * np.arange(COUNT) + 3.0 * (np.arange(COUNT) > 300)
    assert stamps_finding("field", time).grade is Grade.EXCELLENT


@pytest.mark.parametrize("period", [0.2, 1.0])
def test_stamps_in_bursts_are_named(period):
    time = np.sort(
        np.floor(0.025 * np.arange(COUNT) / period) * period + 1e-3 * np.tile(range(40), 15)
    )
    found = stamps_finding("field", time)
    assert found.grade is Grade.WARN
    assert "bursts" in found.remedy


def repeated(field):
    out = field.copy()
    for row in np.flatnonzero(np.random.default_rng(4).random(COUNT) < 0.12):
        out[row] = out[max(row - 1, 0)]
    return out


def shifted(field):
    moved = field + np.array([115e-6, 0.0, 0.0])
    return np.clip(moved, -130e-6, 130e-6)


def dead(field):
    return field * np.array([1.0, 0.0, 1.0])


@pytest.mark.parametrize(
    ("fault", "name", "words"),
    [
        (repeated, "field: repeats", "publishes faster"),
        (lambda field: np.round(field / 0.6e-6) * 0.6e-6, "field: resolution", "finer range"),
        (shifted, "field: range", "x stops at one value"),
        (dead, "field: axes alive", "y never changes"),
        (lambda field: field * 1e6, "field: unit", "microtesla"),
        (lambda field: field * 1e4, "field: unit", "gauss"),
    ],
)
def test_a_fault_of_the_field_is_named(field, fault, name, words):
    found = {f.name: f for f in field_findings(fault(field))}
    assert found[name].grade is Grade.WARN
    assert words in found[name].remedy


@pytest.mark.parametrize(
    ("factor", "words"), [(1.0 / 9.8, "g published"), (-1.0, "gravity"), (2.0, "scale")]
)
def test_a_fault_of_gravity_is_named(force, factor, words):
    found = {f.name: f for f in imu_findings(factor * force, 0.01 * force)}
    assert found["IMU: gravity"].grade is Grade.WARN
    assert words in found["IMU: gravity"].remedy


def test_a_missing_and_a_dead_gyro_are_named(force):
    assert wrong(imu_findings(force, None)) == {"IMU: gyro"}
    assert wrong(imu_findings(force, force * np.array([1.0, 1.0, 0.0]))) == {"gyro: axes alive"}
