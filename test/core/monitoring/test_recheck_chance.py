import math

import numpy as np
import pytest
from simulated.turns import measure, turn

from magcal_ros.core import Figure, Grade, Window, calibrate, check
from magcal_ros.core.monitoring import RECHECK_BOUNDS, check_beside_chance
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


def through_streets(seed, added):
    """Five turns through places of 5 s with a field of their own, 10 µT an axis."""
    rng = np.random.default_rng(seed)
    clean = measure(ROBOT, turn(arc=5.0 * math.tau, samples=1500, duration=75.0), rng)
    place = (clean.time // 5.0).astype(int)
    field = clean.field + rng.normal(0.0, 10e-6, (16, 3))[place] + added
    return Window(clean.time, field, clean.specific_force)


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(2))
def test_in_streets_a_good_calibration_holds_and_a_changed_one_is_detected(seed):
    made = calibrate(measure(ROBOT, turn(), np.random.default_rng(seed)), ROBOT.knowledge())
    assert check(through_streets(seed, np.zeros(3)), made.calibration).state != "stale"
    changed = check(through_streets(seed, np.array([10e-6, 0.0, 0.0])), made.calibration)
    assert changed.state in ("doubtful", "stale")
