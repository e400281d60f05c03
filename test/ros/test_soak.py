"""A little of the day that `benchmarks/soak.py` lives through."""

import pytest
from long_form import rounds
from soak import faults, soak

pytestmark = pytest.mark.faults


@pytest.mark.nightly
def test_messages_as_fast_as_they_are_taken_leave_memory_where_it_was(graph, ros_home):
    marks = soak(hours=rounds(0.01, 1.0), marks=1)
    assert faults(marks) == []
    assert marks[-1].lost < 0.05 * marks[-1].messages
