from __future__ import annotations

import numpy as np
import pytest

from magcal_ros.core.geometry.arrays import frozen_array


def test_it_copies_and_locks():
    source = np.zeros((2, 3))
    frozen = frozen_array(source, (-1, 3), "field")
    source[:] = 1.0
    assert not frozen.any()
    with pytest.raises(ValueError, match="read-only"):
        frozen[0, 0] = 1.0


@pytest.mark.parametrize("values", [np.zeros(3), np.zeros((2, 2)), [[0.0, np.nan, 0.0]]])
def test_it_names_what_is_wrong(values):
    with pytest.raises(ValueError, match="field"):
        frozen_array(values, (-1, 3), "field")
