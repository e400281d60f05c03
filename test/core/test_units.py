import math

import pytest

from magcal_ros.core.units import likely_field_unit

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
def test_the_factor_named_brings_the_field_back_to_tesla(tesla, name, per_tesla, factor):
    assert tesla * per_tesla * float(factor) == pytest.approx(tesla)


@pytest.mark.parametrize("size", [0.0, 48e-6, 1e-3, 0.049, 6e5, math.inf, math.nan])
def test_where_no_unit_fits_nothing_is_said(size):
    assert likely_field_unit(size) == ""
