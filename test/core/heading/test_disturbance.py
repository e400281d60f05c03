import math

import numpy as np
import pytest

from magcal_ros.core import Calibration, Correction
from magcal_ros.core.calibration import Evidence
from magcal_ros.core.heading import FieldDeviation, FieldUse

DIP = math.radians(65.0)
UP = (0.0, 0.0, 1.0)


def field(strength=48e-6, dip=DIP):
    return (strength * math.cos(dip), 0.0, -strength * math.sin(dip))


def watch(patience=20.0, iron_sigma=0.0):
    covariance = np.diag([0.0] * 9 + [iron_sigma**2] * 3)
    noise, nothing = 0.3e-6, Evidence("truth", "", "", "")
    calibration = Calibration(Correction.identity(), covariance, noise, 0.0, 48e-6, DIP, nothing)
    return FieldDeviation(calibration, patience)


def look(found, seconds, start=1.0, **changes):
    """Returns at how many samples a new field was accepted."""
    stamps = [start + 0.02 * k for k in range(int(seconds / 0.02))]
    accepted = 0
    for t in stamps:
        found.add(t, field(**changes), UP, 1e-5, 0.5)
        accepted += found.is_accepted
    return accepted


def test_the_calibrated_field_is_good():
    found = watch()
    assert not look(found, 5.0)
    assert found.use is FieldUse.GOOD
    assert found.deviation == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("changes", "use"),
    [
        ({"strength": 48e-6 * 1.05}, FieldUse.WEIGHED_DOWN),
        ({"dip": DIP - math.radians(3.0)}, FieldUse.WEIGHED_DOWN),
        ({"strength": 48e-6 * 1.3}, FieldUse.IGNORED),
        ({"dip": DIP + math.radians(10.0)}, FieldUse.IGNORED),
    ],
)
def test_a_deviating_field_gets_less_weight_and_is_then_ignored(changes, use):
    found = watch()
    look(found, 5.0, **changes)
    assert found.use is use


def test_a_disturbance_is_recorded_with_time_heading_and_size():
    found = watch()
    look(found, 2.0)
    look(found, 5.0, start=3.0, strength=48e-6 * 1.3)
    last = found.last
    assert last.since == pytest.approx(3.0, abs=0.3)
    assert last.until == pytest.approx(8.0, abs=0.1)
    assert last.strength == pytest.approx(0.3, abs=0.01)
    assert "+30%" in last.in_words
    assert "29°" in last.in_words


def test_a_field_that_returns_is_used_again():
    found = watch()
    look(found, 5.0, strength=48e-6 * 1.3)
    look(found, 3.0, start=6.0)
    assert found.use is FieldUse.GOOD
    assert not found.last.is_accepted


def test_a_field_that_stays_is_accepted_and_the_calibrated_one_still_is():
    found = watch(patience=20.0)
    assert not look(found, 19.0, strength=48e-6 * 1.3)
    assert look(found, 5.0, start=20.0, strength=48e-6 * 1.3) == 1
    assert found.use is FieldUse.GOOD
    assert found.last.is_accepted
    look(found, 5.0, start=25.0)
    assert found.use is FieldUse.GOOD


def test_differing_places_widen_the_limits_of_a_good_field():
    found = watch()
    for k in range(6000):
        wave = 0.08 * math.sin(0.02 * k)
        found.add(1.0 + 0.02 * k, field(strength=48e-6 * (1.0 + wave)), UP, 1e-5, 0.5)
        found.learn(0.02, 1e-5, wave**2)
    assert 0.03 < math.sqrt(found.amplitude_variance) < 0.08
    assert found.deviation < 2.0


def test_a_poor_calibration_is_no_disturbance():
    sure = watch()
    unsure = watch(iron_sigma=3e-6)
    for found in (sure, unsure):
        look(found, 5.0, strength=48e-6 * 1.08)
    assert sure.use is FieldUse.IGNORED
    assert unsure.use is not FieldUse.IGNORED
