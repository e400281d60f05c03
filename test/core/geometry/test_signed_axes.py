import numpy as np
import pytest

from magcal_ros.core.geometry import axes_in_words, is_mirrored, likely_slip, signed_permutations

EVERY = signed_permutations()


def test_there_are_48_and_half_of_them_are_rotations():
    assert len({tuple((axes + 0.0).ravel()) for axes in EVERY}) == 48
    assert [is_mirrored(axes) for axes in EVERY] == [False] * 24 + [True] * 24
    assert all(np.array_equal(axes @ axes.T, np.eye(3)) for axes in EVERY)


def test_the_smallest_change_comes_first():
    assert np.array_equal(EVERY[0], np.eye(3))
    assert sorted(int(np.trace(axes)) for axes in EVERY[24:28]) == [1, 1, 1, 1]


def test_upside_down_is_first_explained_by_a_rotation_about_x():
    half_turns = [axes for axes in EVERY[:24] if np.array_equal(np.abs(axes), np.eye(3))][1:]
    assert axes_in_words(half_turns[0]) == "x forward, y right, z down"


@pytest.mark.parametrize(
    ("axes", "words"),
    [
        (np.diag([1.0, -1.0, 1.0]), "one axis has the wrong sign in the driver, most likely y"),
        (np.diag([1.0, 1.0, -1.0]), "one axis has the wrong sign in the driver, most likely z"),
        (np.eye(3)[[1, 0, 2]], "x and y are swapped in the driver"),
    ],
)
def test_the_mistake_of_the_driver_is_named(axes, words):
    assert likely_slip(axes) == words
