"""Clocks that stand still, jump, or disagree."""

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rosgraph_msgs.msg import Clock
from support import PATIENCE, REFERENCE, assert_silent

from magcal_ros.core.samples import FieldSample

pytestmark = pytest.mark.faults


@pytest.fixture
def calibrated(loaded):
    """Return a robot whose node has loaded a calibration."""
    actor = loaded()
    actor.run(PATIENCE, stop=lambda: actor.yaws)
    assert actor.yaws
    return actor


def test_simulated_time_that_stands_still_blocks_nothing(loaded):
    actor = loaded(parameters={**REFERENCE, "use_sim_time": True})
    received = []
    actor.node.create_subscription(DiagnosticArray, "/diagnostics", received.append, 10)
    actor.run(PATIENCE, stop=lambda: bool(received))
    assert received
    clock = actor.node.create_publisher(Clock, "/clock", 10)
    paused = Clock()
    paused.clock.sec = 777
    actor.run(PATIENCE, stop=clock.get_subscription_count)
    clock.publish(paused)
    actor.run(PATIENCE, stop=lambda: received[-1].header.stamp.sec == 777)
    received.clear()
    actor.yaws.clear()
    actor.run(PATIENCE, stop=lambda: len(received) >= 2 and actor.yaws)
    assert {message.header.stamp.sec for message in received} == {777}
    assert actor.yaws


def test_a_bag_that_loops_is_followed_each_time(calibrated):
    for _ in range(3):
        calibrated.ride.stamp -= 1000.0
        calibrated.run(0.3)
        calibrated.yaws.clear()
        calibrated.run(PATIENCE, stop=lambda: len(calibrated.yaws) > 10)
        assert len(calibrated.yaws) > 10


@pytest.mark.parametrize("ahead", [0.6, pytest.param(40.0, marks=pytest.mark.nightly)])
def test_a_field_with_another_clock_is_reported_with_the_offset(calibrated, ahead):
    def shift(sample):
        late = isinstance(sample, FieldSample)
        return [sample._replace(stamp=sample.stamp + ahead) if late else sample]

    calibrated.mangle = shift
    assert_silent(calibrated)
    words = "field and IMU are "
    calibrated.run(PATIENCE, stop=lambda: words in " ".join(calibrated.status["complaints"]))
    assert not calibrated.yaws
    stated = " ".join(calibrated.status["complaints"])
    offset = float(stated.partition(words)[2].partition(" s apart")[0])
    assert offset == pytest.approx(ahead, abs=0.15)
