from __future__ import annotations

import math

import numpy as np
import pytest

from magcal_ros.core import Belief, Mounting, ReferenceField, SoftIron
from magcal_ros.core.geometry import rotation_from_rpy


def test_a_belief_is_exact_uncertain_or_unknown():
    known, uncertain, unknown = Belief(1.0), Belief(1.0, 0.1), Belief.unknown()
    assert [b.is_exact for b in (known, uncertain, unknown)] == [True, False, False]
    assert [b.is_unknown for b in (known, uncertain, unknown)] == [False, False, True]


@pytest.mark.parametrize(("value", "sigma"), [(math.nan, 0), (math.inf, 0), (1, -1), (1, math.nan)])
def test_invalid_beliefs_are_rejected(value, sigma):
    with pytest.raises(ValueError, match="belief"):
        Belief(value, sigma)


def test_a_reference_is_complete_with_both_numbers():
    assert ReferenceField(Belief(50e-6), Belief(1.0, 0.1)).is_complete
    assert not ReferenceField(Belief(50e-6), Belief.unknown()).is_complete
    assert not ReferenceField().is_complete


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"strength": Belief(-48e-6, 1e-6)}, "not positive"),
        ({"strength": Belief(0.0)}, "not positive"),
        ({"strength": 48e-6}, "are beliefs"),
        ({"inclination": Belief(60.0, 1.0)}, "not in radians"),
        ({"declination": 4.0}, "not in radians"),
        ({"declination": math.nan}, "not in radians"),
        ({"declination": 0.1, "declination_sigma": math.inf}, "sigma of a declination"),
    ],
)
def test_a_reference_in_other_units_is_rejected(given, words):
    """Degrees were fitted, and the turn was refused with other words or NaN."""
    with pytest.raises(ValueError, match=words):
        ReferenceField(**given)


@pytest.mark.parametrize("pose", [np.ones((3, 3)), 2.0 * np.eye(3)])
def test_a_pose_that_is_no_rotation_is_rejected(pose):
    with pytest.raises(ValueError, match="orthonormal"):
        Mounting(pose=pose)


def test_a_front_is_a_unit_vector():
    with pytest.raises(ValueError, match="unit vector"):
        Mounting(forward=[0.0, 0.0, 0.0])


@pytest.mark.parametrize("sigma", [-0.1, math.nan, math.inf])
def test_invalid_soft_iron_is_rejected(sigma):
    with pytest.raises(ValueError, match="soft iron"):
        SoftIron(sigma, 0.02)


def test_the_mounting_rotates_before_it_scales():
    # For a board rotated by 90° to the left, the robot's forward is its -y.
    mounting = Mounting(gains=[2.0, 3.0, 4.0], pose=rotation_from_rpy(0.0, 0.0, math.pi / 2))
    np.testing.assert_allclose(mounting.matrix @ [1.0, 0.0, 0.0], [0.0, -3.0, 0.0], atol=1e-15)


@pytest.mark.parametrize("gains", [[1.0, 0.0, 1.0], [1.0, -1.0, 1.0]])
def test_gains_must_be_positive(gains):
    with pytest.raises(ValueError, match="positive"):
        Mounting(gains=gains)


def test_no_soft_iron_means_none():
    assert SoftIron.none() == SoftIron(0.0, 0.0, False)


def test_the_rotation_to_body_axes_inverts_the_mounting():
    mounting = Mounting([0.8, 1.1, 1.3], rotation_from_rpy(0.4, -0.7, 2.0))
    assert np.allclose(mounting.to_body @ mounting.matrix, np.eye(3), atol=1e-15)
