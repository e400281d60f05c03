import math

import numpy as np
import pytest
from long_form import first_of
from simulated.turns import measure, turn

from magcal_ros.core import Figure, Grade, Window, calibrate, check
from magcal_ros.core.monitoring import (
    ONCE,
    RECHECK_BOUNDS,
    Record,
    check_beside_chance,
    compass_minus_gyro,
    fit_harmonics,
    harmonics,
)
from magcal_ros.core.simulation import Robot

BOUND = next(b for b in RECHECK_BOUNDS if b.figure is Figure.HEADING_SWING)
ROBOT = Robot(noise_field=0.3e-6)


def degrees(value):
    return value / BOUND.scale


def test_a_deviation_by_chance_is_not_stale():
    assert check_beside_chance(BOUND, degrees(8.0), 0.0, None).grade is Grade.REFUSED
    found = check_beside_chance(BOUND, degrees(8.0), degrees(6.9), None)
    assert found.grade is Grade.WARN
    assert (
        "8°, more than the 6.9° that chance explains: 4.05° are left, by squares "
        "(doubtful beyond 4°, stale beyond 7°)"
    ) in found.words


def test_if_chance_reaches_the_bound_the_check_is_uncertain():
    found = check_beside_chance(BOUND, degrees(5.0), degrees(9.0), None)
    assert found.grade is Grade.WARN
    assert "too uncertain to judge" in found.words
    assert "no more than chance explains" in found.words
    assert "9" not in found.words


@pytest.mark.nightly
@pytest.mark.parametrize("turns", [4, 40])
def test_the_allowance_for_chance_covers_few_independent_parts(turns):
    """One bend of the field a turn of 30 s, and no swing: chance explains it 19 times of 20."""
    rng = np.random.default_rng(2)
    heading = np.tile(np.arange(36) * (math.tau / 36), turns)
    stamp = np.arange(len(heading)) * (30.0 / 36.0)
    waves = harmonics(heading[:36])[:, 1:].T
    misses = 0
    for _ in range(200):
        values = 0.05 * (rng.normal(0.0, 1.0, (turns, 4)) @ waves).ravel()
        size, chance = fit_harmonics(harmonics(heading), values, stamp, 2.0).amplitude(ONCE)
        misses += bool(size > chance)
    assert misses <= 0.12 * 200


def test_a_turn_in_one_place_has_the_uncertainty_of_its_noise():
    heading, rng = np.linspace(0.0, math.tau, 36), np.random.default_rng(3)
    values = 0.1 * np.cos(heading) + 0.002 * rng.standard_normal(36)
    stamp = np.linspace(0.0, 14.0, 36)
    size, chance = fit_harmonics(harmonics(heading), values, stamp, 2.0).amplitude(ONCE)
    assert size == pytest.approx(0.1, rel=0.05)
    assert chance < 0.003


def test_what_other_data_decide_is_not_uncertain():
    hidden = check_beside_chance(BOUND, degrees(8.0), degrees(9.0), None, decided=True)
    assert hidden.grade is Grade.GOOD
    clear = check_beside_chance(BOUND, degrees(12.0), degrees(1.0), None, decided=True)
    assert clear.grade is Grade.REFUSED


def through_streets(seed, added):
    """Five turns through places of 5 s with a field of their own, 10 µT an axis."""
    rng = np.random.default_rng(seed)
    clean = measure(ROBOT, turn(arc=5.0 * math.tau, samples=1500, duration=75.0), rng)
    place = (clean.time // 5.0).astype(int)
    field = clean.field + rng.normal(0.0, 10e-6, (16, 3))[place] + added
    return Window(clean.time, field, clean.specific_force)


@pytest.mark.parametrize("seed", first_of(range(2)))
def test_in_streets_a_good_calibration_holds_and_a_changed_one_is_detected(seed):
    made = calibrate(measure(ROBOT, turn(), np.random.default_rng(seed)), ROBOT.knowledge())
    assert check(through_streets(seed, np.zeros(3)), made.calibration).state != "stale"
    changed = check(through_streets(seed, np.array([10e-6, 0.0, 0.0])), made.calibration)
    assert changed.state in ("doubtful", "stale")


@pytest.mark.parametrize(("places", "explained"), [(1, True), (12, False)])
def test_a_disturbance_at_one_place_is_not_attributed_to_the_calibration(places, explained):
    """A compass disturbed near iron is correct elsewhere; a changed one is not."""
    heading = np.tile(np.arange(0.0, math.tau, math.tau / 12.0), 20)
    is_aside = np.arange(240) // 20 < places
    yaw = heading + 0.3 * np.where(is_aside, np.cos(heading), 0.0)
    turned = np.unwrap(heading)
    rows = [Record(3.0 * k, yaw[k], 1.0, 0.0, turned[k], 0, 0.0) for k in range(240)]
    gyro = compass_minus_gyro(np.array(rows), heading, 2.0)
    swing, chance = gyro.waves.amplitude(ONCE)
    assert math.sqrt(np.mean(gyro.deviation**2)) > 0.05
    assert (math.sqrt(max(swing**2 - chance**2, 0.0)) < 0.03) is explained
