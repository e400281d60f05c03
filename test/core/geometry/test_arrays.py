from __future__ import annotations

import numpy as np
import pytest

from magcal_ros.core.geometry import frozen_array, running_mean


def test_a_frozen_array_is_a_copy_and_immutable():
    source = np.zeros((2, 3))
    frozen = frozen_array(source, (-1, 3), "field")
    source[:] = 1.0
    assert not frozen.any()
    with pytest.raises(ValueError, match="read-only"):
        frozen[0, 0] = 1.0


MASKED = np.ma.masked_array(np.zeros((1, 3)), mask=[[False, True, False]])


@pytest.mark.parametrize(
    "values", [np.zeros(3), np.zeros((2, 2)), [[0.0, np.nan, 0.0]], pytest.param(MASKED, id="mask")]
)
def test_an_invalid_array_is_named(values):
    with pytest.raises(ValueError, match="field"):
        frozen_array(values, (-1, 3), "field")


@pytest.mark.parametrize("width", [1, 3, 5, 50])
def test_a_running_mean_has_as_many_values_as_its_input(width):
    values = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    mean = running_mean(values, width)
    assert mean.shape == values.shape
    assert mean[2] == pytest.approx(3.0)
    assert running_mean(np.ones(5), width) == pytest.approx(1.0)
