import math

import pytest

from magcal_ros.core.samples import likely_acceleration_unit, likely_field_unit, unit_by_strength

EARTH = [22e-6, 48e-6, 67e-6]
UNITS = [
    ("gauss", 1e4, "1e-4"),
    ("microtesla", 1e6, "1e-6"),
    ("milligauss", 1e7, "1e-7"),
    ("nanotesla", 1e9, "1e-9"),
]


@pytest.mark.parametrize("tesla", EARTH)
@pytest.mark.parametrize(("name", "per_tesla", "factor"), UNITS)
def test_the_earths_field_published_in_another_unit_is_recognised(tesla, name, per_tesla, factor):
    words = likely_field_unit(tesla * per_tesla)
    assert f"looks like {name} published as tesla" in words
    assert words.endswith(f"multiply by {factor} in the driver")


@pytest.mark.parametrize("tesla", EARTH)
@pytest.mark.parametrize(("name", "per_tesla", "factor"), UNITS)
def test_the_named_factor_converts_the_field_to_tesla(tesla, name, per_tesla, factor):
    assert tesla * per_tesla * float(factor) == pytest.approx(tesla)


@pytest.mark.parametrize(
    ("strength", "sigma", "drivers"),
    [
        (0.48, 0.02, ["VectorNav", "imu_3dm_gx4"]),
        (0.96, 0.05, ["Xsens"]),
        (1.39, 0.05, ["Inertial Sense"]),
        (1.25, 0.1, ["Xsens", "Inertial Sense"]),
        (0.1, 0.005, ["VectorNav", "imu_3dm_gx4"]),
    ],
)
def test_a_strength_without_hard_iron_distinguishes_units(strength, sigma, drivers):
    words = unit_by_strength(strength, sigma)
    all_drivers = ["VectorNav", "imu_3dm_gx4", "Xsens", "Inertial Sense", "MAVROS"]
    assert [each for each in all_drivers if each in words] == drivers
    assert unit_by_strength(strength * 1e-4) == ""


def test_two_equally_possible_units_are_both_named_the_likelier_first():
    words = unit_by_strength(1.25, 0.1)
    assert words.index("Inertial Sense") < words.index("Xsens")
    assert words.count("looks like") == words.count("multiply by") == 1
    # A strength that is the Earth's in both, and much likelier in one, names that one.
    assert "Xsens" not in unit_by_strength(1.32, 0.065)
    words = likely_field_unit(1.25)
    assert words.count("looks like") == words.count("multiply by") == 1
    assert "look up which one the driver publishes" in words


@pytest.mark.parametrize("size", [0.0, 48e-6, 1e-3, 0.049, 6e6, math.inf, math.nan])
def test_no_unit_is_named_if_none_fits(size):
    assert likely_field_unit(size) == ""


@pytest.mark.parametrize(
    ("name", "factor", "size"), [("g", "9.80665", 0.99), ("milli-g", "0.00980665", 1004.0)]
)
def test_gravity_published_in_another_unit_is_recognised(name, factor, size):
    words = likely_acceleration_unit(size)
    assert f"looks like {name} published as m/s²; multiply by {factor} in the driver" in words
    assert size * float(factor) == pytest.approx(9.8, rel=0.02)


@pytest.mark.parametrize("size", [0.0, 5.0, 9.81, 20.0, 9810.0, math.inf, math.nan])
def test_other_sizes_of_gravity_have_no_unit(size):
    assert likely_acceleration_unit(size) == ""
