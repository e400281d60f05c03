import math

import numpy as np
import pytest

from magcal_ros.core.assessment.grading import Grade
from magcal_ros.core.calibrate import calibrate
from magcal_ros.core.calibration import Figure, GyroSwing
from magcal_ros.core.monitoring.recheck import check
from magcal_ros.core.monitoring.recheck_chance import (
    RECHECK_BOUNDS,
    chances,
    check_beside_chance,
    scatter_of_means,
    sectors,
)
from magcal_ros.core.samples import Window
from magcal_ros.core.simulation import Robot, measure, turn

BOUND = next(b for b in RECHECK_BOUNDS if b.figure is Figure.HEADING_SWING)
ROBOT = Robot(noise_field=0.3e-6)


def degrees(value):
    return value / BOUND.scale


def test_what_chance_explains_is_not_stale():
    assert check_beside_chance(BOUND, degrees(8.0), 0.0, None).grade is Grade.REFUSED
    found = check_beside_chance(BOUND, degrees(8.0), degrees(6.9), None)
    assert found.grade is Grade.WARN
    assert "chance may be 6.9°" in found.words


def test_where_chance_reaches_the_bound_nothing_is_shown():
    found = check_beside_chance(BOUND, degrees(5.0), degrees(9.0), None)
    assert found.grade is Grade.WARN
    assert "too uncertain to judge" in found.words
    assert "no more than chance explains" in found.words
    assert "9" not in found.words


@pytest.mark.parametrize("visits", [4, 40])
def test_chance_is_as_large_as_few_visits_may_make_it(visits):
    """One bend of the field a visit, and no swing: chance explains it 19 times of 20."""
    rng = np.random.default_rng(2)
    around, visit = np.tile(np.arange(36), visits), np.repeat(np.arange(visits), 36)
    misses = 0
    for _ in range(200):
        phase = np.arange(36) * (math.tau / 36)
        waves = np.array([np.cos(phase), np.sin(phase), np.cos(2.0 * phase), np.sin(2.0 * phase)])
        values = (rng.normal(0.0, 1.0, (visits, 4)) @ waves).ravel()
        seen = values.reshape(visits, 36).mean(axis=0).std()
        misses += bool(seen > scatter_of_means(values, around, visit))
    assert misses <= 0.12 * 200
    assert scatter_of_means(values[:36], around[:36], visit[:36]) == 0.0


def test_what_a_drive_shows_of_iron_replaces_what_its_streets_hide():
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


@pytest.mark.parametrize("seed", range(2))
def test_a_good_calibration_is_not_stale_in_streets_and_a_changed_one_is_noticed(seed):
    made = calibrate(measure(ROBOT, turn(), np.random.default_rng(seed)), ROBOT.knowledge())
    assert check(through_streets(seed, np.zeros(3)), made.calibration).state != "stale"
    changed = check(through_streets(seed, np.array([10e-6, 0.0, 0.0])), made.calibration)
    assert changed.state in ("doubtful", "stale")


@pytest.mark.parametrize(("strays", "explained"), [((2,), True), ((1, 3), False)])
def test_what_one_place_alone_adds_is_not_the_calibrations(strays, explained):
    """Beside iron the compass goes round once; two visits to other places do as a change would."""
    visit = np.repeat(np.arange(6), 60)
    heading = np.radians(30.0 * visit + np.tile(np.linspace(0.1, 29.9, 60), 6))
    deviation = np.where(np.isin(visit, strays), 1.2, 0.05) * np.cos(7.0 * heading)
    figure = Figure.GYRO_COMPASS_DIFFERENCE
    swing = GyroSwing(heading, deviation, math.sqrt(np.mean(deviation**2)))
    around, nothing = sectors(heading, 36), {figure: 0.0}
    found = chances({}, visit, around, (swing, np.arange(360)), nothing, nothing, 36)[figure]
    assert (math.sqrt(max(swing.rms**2 - found**2, 0.0)) < 0.05) is explained
