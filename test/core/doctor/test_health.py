import math

import numpy as np
import pytest
from long_form import first_of
from simulated.turns import measure, turn

from magcal_ros.core.doctor import (
    alive_finding,
    examine_window,
    field_findings,
    gravity_size_finding,
    noise_findings,
    repeats_finding,
    stamps_finding,
    stuck_axes,
)
from magcal_ros.core.doctor.finding import vector_in_words
from magcal_ros.core.samples import SensorLog
from magcal_ros.core.simulation import Robot

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


def found_in(field):
    return [*field_findings(field), repeats_finding("field", field)]


def wrong(findings):
    return {f.key for f in findings if f.is_wrong}


def test_good_streams_give_no_warning(field, force):
    jitter = np.random.default_rng(3).uniform(-4e-3, 4e-3, COUNT)
    assert not stamps_finding("field", 0.025 * np.arange(COUNT) + jitter).is_wrong
    assert not wrong(found_in(field))
    assert not gravity_size_finding(force, 9.8).is_wrong
    assert not alive_finding("gyro", force).is_wrong


def test_one_gap_is_no_burst():
    time = 0.025 * np.arange(COUNT) + 3.0 * (np.arange(COUNT) > 300)
    assert not stamps_finding("field", time).is_wrong


@pytest.mark.parametrize("period", [0.2, 1.0])
def test_stamps_in_bursts_are_named(period):
    time = np.sort(
        np.floor(0.025 * np.arange(COUNT) / period) * period + 1e-3 * np.tile(range(40), 15)
    )
    found = stamps_finding("field", time)
    assert found.key == "bursts"
    assert "bursts" in found.remedy


def test_a_field_that_comes_slowly_is_named():
    found = stamps_finding("field", np.arange(60.0))
    assert found.key == "slow"
    assert "the field comes at 1 Hz" in found.remedy
    assert not stamps_finding("field", 0.2 * np.arange(60.0)).remedy


def test_stamps_that_jitter_by_most_of_a_gap_are_named():
    time = np.sort(0.025 * (np.arange(COUNT) + np.random.default_rng(5).uniform(-3, 3, COUNT)))
    assert "jitter" in stamps_finding("field", time).remedy


@pytest.mark.parametrize("share", [0.25, 0.5, 0.6])
def test_lost_samples_are_distinguished_from_jitter(share):
    rng = np.random.default_rng(6)
    time = 0.02 * np.arange(COUNT) + rng.normal(0.0, 1e-3, COUNT)
    found = stamps_finding("field", time[rng.random(COUNT) > share])
    assert "lost" in found.remedy
    assert "jitter" not in found.remedy


@pytest.mark.parametrize("seed", range(5))
def test_single_late_stamps_are_no_lost_samples(seed):
    rng = np.random.default_rng(seed)
    late = rng.exponential(0.06, COUNT) * (rng.random(COUNT) < 0.3)
    found = stamps_finding("field", np.unique(0.02 * np.arange(COUNT) + late))
    assert "jitter" in found.remedy
    assert "lost" not in found.remedy


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
    ("fault", "key", "words"),
    [
        (repeated, "repeats", "publishes faster"),
        (lambda field: np.round(field / 0.6e-6) * 0.6e-6, "resolution", "finer range"),
        (shifted, "saturation", "x reached the end of the range"),
        (dead, "frozen", "y never changes"),
        (lambda field: field * 1e6, "field_unit", "microtesla"),
        (lambda field: field * 1e4, "field_unit", "gauss"),
    ],
)
def test_a_fault_of_the_field_is_named_alone(field, fault, key, words):
    found = {f.key: f for f in found_in(fault(field)) if f.is_wrong}
    assert set(found) == {key}
    assert words in found[key].remedy


def test_a_rest_at_the_extreme_of_a_coarse_field_is_no_saturation(field):
    resting = np.concatenate([np.round(field / 0.6e-6) * 0.6e-6, np.tile(field[:1], (300, 1))])
    resting[COUNT:, 0] = resting[:, 0].max()
    assert "saturation" not in wrong(field_findings(resting))


@pytest.mark.parametrize("step", [1.5e-6, 3e-6, 5e-6])
def test_a_vertical_axis_of_a_few_coarse_numbers_is_no_saturation(field, step):
    """A level turn hardly changes z; whole turns in coarse numbers were refused."""
    coarse = np.round(field / step) * step
    coarse[:, 2] = step * np.where(np.arange(COUNT) % 3, -20.0, -19.0)
    assert "saturation" not in wrong(field_findings(coarse))


def test_an_axis_always_at_its_limit_is_distinguished_from_a_coarse_one(field):
    assert stuck_axes(dead(field)) == [1]
    assert stuck_axes(np.round(dead(field) / 0.15e-6) * 0.15e-6) == [1]
    # Without most of its noise the same turn leaves a rounded z at one number.
    quiet = field - 0.27e-6 * np.random.default_rng(1).standard_normal((COUNT, 3))
    coarse = np.round((quiet + 0.3e-6) / 0.6e-6) * 0.6e-6
    assert np.ptp(coarse[:, 2]) == 0.0
    assert not stuck_axes(coarse)
    assert not stuck_axes(field)


def test_coarse_numbers_of_a_quiet_sensor_are_no_repeats():
    quiet = 20e-6 + 0.1e-6 * np.random.default_rng(6).standard_normal((COUNT, 3))
    coarse = np.round(quiet / 0.6e-6) * 0.6e-6
    assert not repeats_finding("field", coarse).is_wrong


@pytest.mark.parametrize(("factor", "words"), [(1.0 / 9.8, "g published"), (2.0, "scale")])
def test_a_wrong_size_of_gravity_is_named(force, factor, words):
    assert words in gravity_size_finding(factor * force, factor * 9.8).remedy


@pytest.mark.parametrize("seconds", first_of([0.1, 1.0, 0.5, 1.25, 1.5], 2))
def test_a_very_short_turn_can_be_examined(seconds):
    motion = turn(arc=math.radians(57.0), samples=max(3, round(60 * seconds)), duration=seconds)
    window = measure(Robot(noise_rate=1e-3), motion, np.random.default_rng(3), gyro=True)
    assert examine_window(window).findings


@pytest.mark.parametrize(("share", "gap", "is_named"), [(0.1, 0.02, True), (0.01, 0.02, False)])
def test_single_wrong_samples_are_named(field, force, share, gap, is_named):
    rng = np.random.default_rng(5)
    hit = rng.random(COUNT) < share
    spiky = field + np.where(hit[:, None], 15e-6 * rng.standard_normal((COUNT, 3)), 0.0)
    time = gap * np.arange(COUNT)
    (line,) = [
        f
        for f in noise_findings(SensorLog(time, force, 0.0 * force, time, spiky), 1.0)
        if f.key == "spikes"
    ]
    assert line.is_wrong is is_named
    assert float(line.evidence.partition("%")[0]) == pytest.approx(100.0 * hit.mean(), abs=1.0)


def test_a_slow_field_has_no_spikes(field, force):
    time = 0.1 * np.arange(COUNT)
    log = SensorLog(time, force, 0.0 * force, time, field[::-1])
    assert "spikes" not in {f.key for f in noise_findings(log, 1.0)}


def test_a_vector_has_no_negative_zero():
    assert vector_in_words(np.array([0.004, -0.004, -9.81])) == "(0.00, 0.00, -9.81)"
