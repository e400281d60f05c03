"""The World Magnetic Model: published values, uncertainties, its life, and the whole Earth."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.core.earth_field import NoModel, decimal_year, model_field, wmm, year_of
from magcal_ros.core.earth_field.reference import TUNING
from magcal_ros.core.earth_field.wmm import Place
from magcal_ros.core.geometry import wrap_angle

# Year, altitude in km, latitude, longitude, declination, inclination, F in nT: from the table of
# test values that NOAA publishes with WMM2025.
PUBLISHED = """
2025.0   28   89  -121   -99.77   88.47  56214
2025.0   65   43    93     0.50   64.10  55627
2025.0   51  -33   109    -5.49  -67.50  57055
2025.0   39  -59    -8   -15.75  -58.55  28590
2025.5    6  -36  -137    20.28  -52.11  41281
2025.5   44   33  -118    11.10   57.89  44543
2026.0   33   -3  -147     9.71   -2.12  30979
2026.0   82  -64    87   -81.74  -75.40  55453
2026.5   12  -79   115  -137.58  -77.37  59546
2026.5   19   29    66     2.24   46.04  47178
2027.5    0  -13   -59   -17.49  -15.26  23220
2027.5    8   62    53    19.39   76.67  56369
2029.0   19   46   -22    -5.65   60.89  46527
2029.5   93   -2   158     7.09  -17.84  35788
"""
ROWS = [tuple(map(float, line.split())) for line in PUBLISHED.strip().splitlines()]
MUNICH = Place(48.1, 11.6, 520.0)

latitudes = st.floats(-90.0, 90.0)
longitudes = st.floats(-180.0, 180.0)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row[0]} {row[2]:g} {row[3]:g}")
def test_published_values_in_units_and_signs(row):
    year, kilometres, latitude, longitude, declination, inclination, strength = row
    found = model_field(Place(latitude, longitude, kilometres * 1000.0), year)
    assert found.strength.value == pytest.approx(strength * 1e-9, abs=0.51e-9)
    assert math.degrees(found.inclination.value) == pytest.approx(inclination, abs=0.0051)
    assert math.degrees(found.declination.value) == pytest.approx(declination, abs=0.0051)
    assert found.model == "World Magnetic Model 2025"
    assert found.years_late == 0.0


def test_the_sigmas_are_those_of_the_published_error_model():
    found = model_field(MUNICH, 2026.9)
    level = found.strength.value * math.cos(found.inclination.value)
    assert found.level == pytest.approx(level)
    assert found.strength.sigma == pytest.approx(138e-9)
    assert math.degrees(found.inclination.sigma) == pytest.approx(0.20)
    expected = math.hypot(0.26, 5417e-9 / level)
    assert math.degrees(found.declination.sigma) == pytest.approx(expected)


def test_a_drive_of_years_ago_has_the_model_of_its_time():
    assert model_field(MUNICH, 2017.3).model == "World Magnetic Model 2015"
    assert model_field(MUNICH, 2024.99).model == "World Magnetic Model 2020"


def test_after_its_life_the_model_grows_uncertain_year_by_year():
    fields = [model_field(MUNICH, year) for year in (2029.9, 2030.0, 2031.0, 2033.0, 2035.0)]
    assert [field.years_late for field in fields] == pytest.approx([0.0, 0.0, 1.0, 3.0, 5.0])
    for name in ("strength", "inclination", "declination"):
        sigmas = [getattr(field, name).sigma for field in fields]
        assert sigmas[0] == pytest.approx(sigmas[1], rel=1e-3)
        assert sigmas[1:] == sorted(sigmas[1:])
        assert sigmas[4] > 1.1 * sigmas[1]


def test_the_grown_sigma_covers_the_errors_of_older_models(monkeypatch):
    """The model of 2020, carried on to 2029, against the one of 2025 at a hundred places."""
    places = [Place(lat, lon) for lat in range(-75, 76, 15) for lon in range(-180, 180, 40)]
    truth = [model_field(place, 2029.9) for place in places]
    monkeypatch.delitem(wmm.ERRORS, 2025)
    stale = [model_field(place, 2029.9) for place in places]
    for name in ("strength", "inclination"):
        squares = [
            ((getattr(s, name).value - getattr(t, name).value) / getattr(s, name).sigma) ** 2
            for s, t in zip(stale, truth, strict=True)
        ]
        assert 0.1 < sum(squares) / len(squares) < 1.5


@pytest.mark.parametrize("year", [1970.0, 2014.99, 2035.2, 2106.0, math.nan, math.inf, -math.inf])
def test_a_date_without_a_model_is_reported_with_the_remedy(year):
    with pytest.raises(NoModel, match="set the clock, or bring magcal_ros up to date"):
        model_field(MUNICH, year)


@given(latitudes, longitudes, st.floats(-1000.0, 850_000.0), st.floats(2015.0, 2035.0))
def test_it_agrees_with_another_evaluation(lat, lon, altitude, year):
    pygeomag = pytest.importorskip("pygeomag")
    base = max(b for b in (2015, 2020, 2025) if b <= year)
    file = f"wmm/WMM_{base}{'v2' if base == 2015 else ''}.COF"
    # That one divides by the cosine of the latitude at the poles.
    lat = max(-89.99, min(lat, 89.99))
    other = pygeomag.GeoMag(coefficients_file=file).calculate(
        lat, lon, altitude / 1000.0, year, allow_date_outside_lifespan=True
    )
    found = model_field(Place(lat, lon, altitude), year)
    assert found.strength.value == pytest.approx(other.f * 1e-9, abs=1e-12)
    assert found.inclination.value == pytest.approx(math.radians(other.i), abs=1e-6)
    turned = wrap_angle(found.declination.value - math.radians(other.d))
    assert abs(turned) * found.level < 1e-12
    if year < 2030.0:
        sigma = other.calculate_uncertainty()
        assert found.strength.sigma == pytest.approx(sigma.f * 1e-9)
        assert math.degrees(found.inclination.sigma) == pytest.approx(sigma.i)
        assert found.declination.sigma == pytest.approx(
            min(math.radians(sigma.d), math.pi), rel=1e-4
        )


@pytest.mark.parametrize("latitude", [90.0, -90.0])
def test_at_a_pole_the_field_does_not_depend_on_the_meridian(latitude):
    east, west = (model_field(Place(latitude, lon), 2026.0) for lon in (77.0, -13.0))
    assert east.strength.value == pytest.approx(west.strength.value, rel=1e-12)
    assert east.inclination.value == pytest.approx(west.inclination.value, rel=1e-9)
    near = model_field(Place(math.copysign(89.9999, latitude), 77.0), 2026.0)
    assert east.declination.value == pytest.approx(near.declination.value, abs=1e-3)


def test_the_coefficients_are_those_published():
    for base, first in ((2015, -29438.2), (2020, -29404.5), (2025, -29351.8)):
        model = wmm._load(base)
        assert (model.epoch, len(model.terms), model.terms[0, 2]) == (base, 90, first)


@given(latitudes, longitudes, st.floats(-1000.0, 850_000.0), st.floats(2015.0, 2035.0))
def test_everywhere_on_earth_the_numbers_are_finite_and_in_range(lat, lon, altitude, year):
    found = model_field(Place(lat, lon, altitude), year)
    assert 12e-6 < found.strength.value < 72e-6
    assert abs(found.inclination.value) <= math.pi / 2
    assert abs(found.declination.value) <= math.pi
    for belief in (found.strength, found.inclination, found.declination):
        assert 0.0 < belief.sigma <= math.pi


@pytest.mark.parametrize(
    "spot",
    [(90.1, 0), (-91, 0), (0, 180.1), (math.nan, 0), (0, math.inf), (0, 0, 9e5), (0, 0, math.nan)],
)
def test_no_place_lies_off_the_earth(spot):
    with pytest.raises(ValueError, match="no field model"):
        Place(*spot)


def test_distances_on_the_globe():
    degree = math.radians(1.0) * wmm.EARTH_RADIUS
    assert Place(10.0, 20.0).distance(Place(11.0, 20.0)) == pytest.approx(degree)
    assert Place(0.0, 179.5).distance(Place(0.0, -179.5)) == pytest.approx(degree)
    assert Place(90.0, 10.0).distance(Place(90.0, -170.0)) == pytest.approx(0.0, abs=1e-6)


@given(latitudes, longitudes, latitudes, longitudes)
def test_distances_are_symmetric_and_at_most_half_way_round(a, b, c, d):
    one, other = Place(a, b), Place(c, d)
    assert one.distance(other) == pytest.approx(other.distance(one), abs=1e-3)
    assert 0.0 <= one.distance(other) <= math.pi * wmm.EARTH_RADIUS
    assert one.distance(one) == 0.0


@pytest.mark.parametrize(
    ("stamp", "year"),
    [
        (0.0, 1970.0),
        (1735689600.0, 2025.0),
        (1735689599.0, 2025.0),
        (1719878400.0, 2024.5),
        (1751457600.0, 2025.5),
    ],
)
def test_seconds_become_decimal_years(stamp, year):
    assert decimal_year(stamp) == pytest.approx(year, abs=1e-6)


def test_the_date_is_the_earliest_possible_one():
    now, replay_drive, simulated, wrong = 1.795e9, 1.6e9, 12.5, 2.1e9
    assert year_of([replay_drive, now], now) == decimal_year(replay_drive)
    assert year_of([wrong, now], now) == decimal_year(now)
    assert year_of([simulated, simulated], now) == decimal_year(now)
    assert year_of([0.0, -math.inf], 0.0) == 1970.0


def test_ten_kilometres_change_the_field_little_at_most_places():
    # Even steps of the sine are even in area; this is all but the polar caps beyond 67°.
    latitudes_even = np.degrees(np.arcsin(np.linspace(-0.92, 0.92, 15))).tolist()
    places = [(lat, lon) for lat in latitudes_even for lon in range(-180, 180, 20)]
    north = math.degrees(TUNING.moved / wmm.EARTH_RADIUS)
    turned, stronger = [], []
    for lat, lon in places:
        east = north / math.cos(math.radians(lat))
        here = model_field(Place(lat, lon), 2026.9)
        for there in (Place(lat + north, lon), Place(lat, lon + east)):
            other = model_field(there, 2026.9)
            turned.append(abs(wrap_angle(other.declination.value - here.declination.value)))
            stronger.append(abs(other.strength.value - here.strength.value))
    assert math.degrees(np.percentile(turned, 80)) < 0.1
    assert np.max(stronger) < 0.1e-6
