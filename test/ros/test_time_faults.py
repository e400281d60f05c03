"""Clocks that do not run, jump, or disagree."""

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rosgraph_msgs.msg import Clock
from support import REFERENCE, store_calibration

from magcal_ros.core.streams import FieldSample

pytestmark = pytest.mark.faults


@pytest.fixture
def calibrated(stage, tmp_path):
    """Return a robot whose node has loaded a calibration."""
    path = store_calibration(tmp_path / "calibration.yaml")
    actor = stage(parameters={**REFERENCE, "calibration_file": str(path)})
    actor.run(0.3)
    assert actor.yaws
    return actor


def test_simulated_time_that_has_not_begun_or_is_paused_holds_nothing_up(stage):
    actor = stage(parameters={**REFERENCE, "use_sim_time": True}, speed=8.0)
    heard = []
    actor.node.create_subscription(DiagnosticArray, "/diagnostics", heard.append, 10)
    answer = actor.calibrate()
    assert answer.success, answer.message
    actor.run(1.2)
    assert heard
    clock = actor.node.create_publisher(Clock, "/clock", 10)
    paused = Clock()
    paused.clock.sec = 777
    clock.publish(paused)
    actor.run(0.2)
    heard.clear()
    actor.yaws.clear()
    clock.publish(paused)
    actor.run(2.3)
    assert len(heard) >= 2
    assert heard[-1].header.stamp.sec == 777
    assert actor.yaws


def test_a_clock_that_is_set_back_in_the_turn_begins_it_anew_and_says_so(stage):
    actor = stage()
    future = actor.call("calibrate")
    actor.run(1.5, 0.5)
    assert actor.status["progress"]["arc_deg"] > 90.0
    actor.ride.stamp -= 100.0
    actor.run(0.5, 0.5)
    assert actor.status["progress"]["arc_deg"] < 90.0
    actor.run(60.0, 0.5, stop=future.done)
    answer = future.result()
    assert answer.success, answer.message
    assert "time was set back during the turn" in answer.message


def test_a_bag_that_loops_is_followed_each_time(calibrated):
    for _ in range(3):
        calibrated.ride.stamp -= 1000.0
        calibrated.run(0.3)
        calibrated.yaws.clear()
        calibrated.run(0.3)
        assert len(calibrated.yaws) > 10


@pytest.mark.parametrize("ahead", [0.6, 40.0])
def test_a_field_stamped_by_another_clock_is_said_with_the_offset(calibrated, ahead):
    def shift(sample):
        late = isinstance(sample, FieldSample)
        return [sample._replace(stamp=sample.stamp + ahead) if late else sample]

    calibrated.mangle = shift
    calibrated.run(0.4)
    calibrated.yaws.clear()
    calibrated.run(1.3)
    assert not calibrated.yaws
    said = " ".join(calibrated.status["complaints"])
    offset = float(said.partition("field and IMU are ")[2].partition(" s apart")[0])
    assert offset == pytest.approx(ahead, abs=0.15)
