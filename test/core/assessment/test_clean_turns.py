"""A good turn gives no warning: a warning names a remedy that helps."""

from dataclasses import replace

import pytest
from long_form import first_of
from realistic_robots import by_rested_turn, by_turn
from turn_kinds import KINDS

from magcal_ros.core import Grade, calibrate

SENSORS = ("good", "typical", "cheap")


def warnings_of(scene, knowledge, gyro):
    window = scene.window if gyro else replace(scene.window, angular_rate=None)
    checks = calibrate(window, knowledge).verdict.checks
    return [check.words for check in checks if check.grade.rank >= Grade.WARN.rank]


@pytest.mark.parametrize(
    "case",
    first_of([("cheap", "slope", True), ("typical", "uneven", False), ("cheap", "even", True)]),
)
def test_a_good_turn_gives_no_warning(case):
    sensors, kind, gyro = case
    assert not warnings_of(*by_turn(kind, sensors, "open")(5003), gyro)


@pytest.mark.nightly
@pytest.mark.timeout(900)
@pytest.mark.parametrize(("gyro", "most"), [(True, 0.1), (False, 0.2)])
def test_few_good_turns_give_a_warning(gyro, most):
    """Without a gyro a short turn there and back is not taken for a full turn."""
    scenes = [by_turn(kind, each, "open") for kind in KINDS for each in SENSORS]
    scenes += [by_rested_turn("even", each, "open") for each in SENSORS]
    warned = [bool(warnings_of(*scene(seed), gyro)) for scene in scenes for seed in range(20, 23)]
    assert sum(warned) <= most * len(warned)
