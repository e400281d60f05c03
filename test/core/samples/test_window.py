from __future__ import annotations

import numpy as np
import pytest

from magcal_ros.core import Window


def window(**changes):
    n = 5
    given = {
        "time": np.arange(n) * 0.1,
        "field": np.arange(3.0 * n).reshape(n, 3),
        "specific_force": np.ones((n, 3)),
        "angular_rate": np.zeros((n, 3)),
    }
    return Window(**(given | changes))


def test_the_length_is_the_number_of_samples():
    assert len(window()) == 5


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"field": None}, "needs field"),
        ({"time": None}, "needs time"),
        ({"speed": np.ones(3)}, "speed must have the shape"),
        ({"speed": np.ones((5, 1))}, "speed must have the shape"),
        ({"speed": np.full(5, np.inf)}, "speed is infinite"),
        ({"rested": np.zeros(3, bool)}, "rested must have the shape"),
    ],
)
def test_every_column_is_checked_where_it_is_given(changes, words):
    with pytest.raises(ValueError, match=words):
        window(**changes)


def test_a_speed_may_be_a_list_with_gaps():
    assert window(speed=[0.5, np.nan, 0.5, 0.5, 0.5]).rolls


@pytest.mark.parametrize("rows", [np.array([0, 2, 3]), np.array([1, 0, 1, 1, 0], dtype=bool)])
def test_taking_rows_keeps_the_samples_together(rows):
    whole = window()
    part = whole.take(rows)
    np.testing.assert_array_equal(part.time, whole.time[rows])
    np.testing.assert_array_equal(part.field, whole.field[rows])
    np.testing.assert_array_equal(part.angular_rate, whole.angular_rate[rows])
    assert window(angular_rate=None).take(rows).angular_rate is None


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"field": np.zeros((4, 3))}, "field"),
        ({"specific_force": np.full((5, 3), np.nan)}, "specific force"),
        ({"angular_rate": np.full((5, 3), np.inf)}, "angular rate"),
        ({"time": np.array([0.0, 0.1, 0.1, 0.2, 0.3])}, "increase"),
        ({"time": np.array([0.0, 0.2, 0.1, 0.3, 0.4])}, "increase"),
    ],
)
def test_unclean_samples_are_rejected_with_a_reason(change, what):
    with pytest.raises(ValueError, match=what):
        window(**change)


def test_an_empty_window_is_allowed():
    assert len(Window(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)))) == 0
