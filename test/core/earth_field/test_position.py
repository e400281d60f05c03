"""Fixes of a receiver, and the place that follows from them."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.core.earth_field import EARTH_RADIUS, Fix, Fixes, LocalPlane, place_of
from magcal_ros.core.earth_field.reference import TUNING
from magcal_ros.core.earth_field.wmm import Place

HOME = (48.1, 11.6)
DEGREE = math.radians(1.0) * EARTH_RADIUS


def fix(latitude=HOME[0], longitude=HOME[1], altitude=520.0, has_fix=True, stamp=1.79e9):
    return Fix(has_fix, latitude, longitude, altitude, stamp)


def north(metres, **more):
    return fix(HOME[0] + metres / DEGREE, **more)


BAD = {
    "there is no fix": fix(has_fix=False),
    "not finite": fix(latitude=math.nan),
    "lie outside": fix(longitude=200.0),
    "850 km": fix(altitude=9e6),
    "0° N 0° E": fix(0.0, 0.0),
}


@pytest.mark.parametrize("words", BAD)
def test_a_bad_fix_is_ignored_and_reported(words):
    fixes = Fixes()
    assert not fixes.add(BAD[words])
    assert (fixes.place, fixes.stamp) == (None, 0.0)
    (complaint,) = fixes.complaints(None)
    assert complaint.startswith("gps/fix: no position yet, its messages ")
    assert words in complaint


def test_the_first_good_fix_ends_the_complaints():
    fixes = Fixes()
    for each in (BAD["not finite"], BAD["there is no fix"]):
        fixes.add(each)
    assert len(fixes.complaints(None)) == 2
    assert fixes.add(fix())
    assert fixes.place == Place(*HOME, 520.0)
    assert fixes.complaints(None) == []


def test_before_any_message_there_is_no_complaint():
    assert Fixes().complaints(None) == []


def test_an_unknown_altitude_is_no_obstacle():
    assert place_of(fix(altitude=math.nan)) == Place(*HOME, 0.0)


def test_the_place_changes_only_by_a_confirmed_relevant_distance():
    fixes = Fixes()
    assert fixes.add(fix())
    assert not any(fixes.add(north(0.9 * TUNING.moved)) for _ in range(20))
    assert [fixes.add(north(1.2 * TUNING.moved)) for _ in range(3)] == [False, False, True]
    assert fixes.place.distance(Place(*HOME)) == pytest.approx(1.2 * TUNING.moved, rel=1e-3)


def test_outliers_do_not_change_the_place():
    fixes = Fixes()
    fixes.add(fix())
    for k in range(50):
        assert not fixes.add(north(3e5 if k % 2 else 6e5))
        assert not fixes.add(fix(-20.0 + k, 50.0 + k))
    fixes.add(fix())
    assert fixes.place == Place(*HOME, 520.0)


def test_the_newest_good_stamp_gives_the_date():
    fixes = Fixes()
    fixes.add(fix(stamp=5.0))
    fixes.add(fix(stamp=6.0))
    fixes.add(fix(stamp=7.0, has_fix=False))
    assert fixes.stamp == 6.0


def test_a_fix_far_from_the_given_place_is_reported():
    fixes = Fixes()
    fixes.add(fix())
    assert fixes.complaints(Place(HOME[0] + 0.9 * TUNING.far / DEGREE, HOME[1])) == []
    (complaint,) = fixes.complaints(Place(52.5, 13.4))
    assert "km from the given position 52.50°N 13.40°E, which is used" in complaint


def test_a_place_far_from_the_first_is_reported():
    fixes = Fixes()
    fixes.add(fix())
    for _ in range(3):
        fixes.add(north(1.5 * TUNING.far))
    (complaint,) = fixes.complaints(None)
    assert "gps/fix has moved by 75 km, from 48.10°N" in complaint


anything = st.floats(allow_nan=True, allow_infinity=True)


@given(st.lists(st.builds(Fix, st.booleans(), anything, anything, anything, anything), max_size=20))
def test_any_input_gives_a_place_on_earth(messages):
    fixes = Fixes()
    for message in messages:
        fixes.add(message)
        assert all(isinstance(words, str) for words in fixes.complaints(Place(1.0, 2.0)))
    assert fixes.place is None or abs(fixes.place.latitude_deg) <= 90.0


def test_fixes_are_metres_from_the_first_good_one():
    plane = LocalPlane()
    assert plane.position(Fix(False, 48.0, 11.0, 0.0, 1.0)) is None
    assert plane.position(Fix(True, 48.0, 179.9999, 0.0, 1.0))[1:] == (0.0, 0.0)
    _, east, north = plane.position(Fix(True, 48.0001, -179.9999, math.nan, 2.0))
    assert north == pytest.approx(11.12, abs=0.02)
    assert east == pytest.approx(2.0 * 11.12 * math.cos(math.radians(48.0)), abs=0.05)
    assert plane.position(Fix(True, math.nan, 11.0, 0.0, 3.0)) is None
