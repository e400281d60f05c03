"""How the shared numbers move."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from magcal_ros.core.estimation import parameters as p
from magcal_ros.core.estimation.parameters import Globals

SMALL = st.floats(-0.3, 0.3)


def shared(strength=1.1, inclination=math.radians(55.0)):
    return Globals(np.eye(3), np.eye(3), 0.1, -0.2, np.zeros(3), strength, inclination)


def step(longer=0.0, steeper=0.0):
    move = np.zeros(p.COUNT)
    move[p.STRENGTH], move[p.INCLINATION] = longer, steeper
    return move


@given(SMALL.filter(bool), SMALL)
def test_strength_and_inclination_move_the_field_in_a_straight_line(longer, steeper):
    here = shared()
    along = longer * here.field_enu / here.strength + steeper * here.field_enu_by_inclination
    there = here.moved(step(longer, steeper))
    np.testing.assert_allclose(there.field_enu, here.field_enu + along, atol=1e-12)


@given(SMALL)
def test_a_strength_that_is_held_does_not_move(steeper):
    there = shared().moved(step(steeper=steeper))
    assert there.strength == shared().strength
    assert there.inclination == pytest.approx(shared().inclination + steeper)


@given(SMALL)
def test_an_inclination_that_is_held_does_not_move(longer):
    there = shared().moved(step(longer=longer))
    assert there.inclination == pytest.approx(shared().inclination)
    assert there.strength == pytest.approx(shared().strength + longer)
