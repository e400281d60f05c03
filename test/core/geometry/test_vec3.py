import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.core.geometry import exp_rotation, vec3

vectors = st.tuples(*[st.floats(-5.0, 5.0)] * 3)


@given(vectors, vectors)
def test_products_and_lengths_agree_with_numpy(a, b):
    assert vec3.dot(a, b) == pytest.approx(np.dot(a, b))
    assert vec3.cross(a, b) == pytest.approx(np.cross(a, b))
    assert vec3.length(a) == pytest.approx(np.linalg.norm(a))
    assert vec3.distance(a, b) == pytest.approx(np.linalg.norm(np.subtract(a, b)))
    assert vec3.interpolate(a, b, 0.3) == pytest.approx(0.7 * np.array(a) + 0.3 * np.array(b))


@given(vectors, vectors)
def test_a_fixed_direction_rotates_opposite_to_the_body(a, turn):
    expected = exp_rotation(-np.array(turn)) @ np.array(a)
    assert vec3.propagated(a, turn) == pytest.approx(expected, abs=1e-9)


def test_a_unit_triple_has_length_one():
    assert vec3.unit_triple((3.0, 0.0, 4.0)) == pytest.approx((0.6, 0.0, 0.8))
