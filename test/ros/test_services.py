"""Every service in every state."""

import pytest
from long_form import first_of
from support import (
    PATIENCE,
    REFERENCE,
    assert_silent,
    calibrate_quickly,
    store_calibration,
    turn_by,
)

pytestmark = pytest.mark.faults


def collect_a_moment(actor, yaw_rate=0.5):
    actor.run(0.5, yaw_rate)


def test_a_second_call_is_refused_while_the_first_collects(stage):
    actor = stage()
    first = actor.call("calibrate")
    collect_a_moment(actor)
    for service in ("calibrate", "start"):
        second = actor.answer(actor.call(service))
        assert not second.success
        assert "already collecting" in second.message
    assert not first.done()
    assert actor.answer(actor.call("cancel")).success
    assert not actor.answer(first).success


@pytest.mark.nightly
def test_cancel_answers_the_waiting_call_and_keeps_the_calibration(stage):
    actor = stage()
    assert actor.calibrate().success
    in_force = actor.status["calibration"]
    waiting = actor.call("calibrate")
    collect_a_moment(actor)
    assert actor.answer(actor.call("cancel")).success
    assert "cancelled" in actor.answer(waiting).message
    actor.run(1.5)
    assert actor.status["state"] == "calibrated"
    assert actor.status["calibration"] == in_force
    again = actor.answer(actor.call("cancel"))
    assert not again.success
    assert "nothing to cancel" in again.message


@pytest.mark.nightly
def test_start_and_finish_are_calibrate_in_two_steps(stage):
    actor = stage(speed=8.0)
    too_early = actor.answer(actor.call("finish"))
    assert not too_early.success
    assert "~/start" in too_early.message
    assert actor.answer(actor.call("start")).success
    turn_by(actor, 240.0)
    answer = actor.answer(actor.call("finish"))
    assert answer.success, answer.message
    assert "finished by the user" in answer.message
    assert actor.status["state"] == "calibrated"


@pytest.mark.parametrize("meanwhile", first_of(["fitting", "calibrated"]))
def test_finish_after_the_end_of_a_turn_answers_with_its_verdict(stage, meanwhile):
    actor = stage(speed=8.0)
    assert actor.answer(actor.call("start")).success
    actor.run(PATIENCE, 0.5, lambda: actor.status["state"] == "collecting")
    actor.run(PATIENCE, 0.5, lambda: actor.status["state"] == meanwhile)
    answer = actor.answer(actor.call("finish"))
    assert answer.success, answer.message
    assert answer.message.startswith("Calibrated")
    assert "~/start" in actor.answer(actor.call("finish")).message


def test_reset_stops_the_yaw_and_load_restores_it(loaded):
    actor = loaded()
    assert actor.answer(actor.call("reset")).success
    assert_silent(actor)
    nothing = actor.answer(actor.call("save"))
    assert not nothing.success
    assert "no calibration in force" in nothing.message
    loaded = actor.answer(actor.call("load"))
    assert loaded.success, loaded.message
    actor.run(PATIENCE, stop=lambda: actor.yaws)
    assert actor.yaws
    assert actor.answer(actor.call("save")).success


def test_accept_applies_a_refused_calibration(stage):
    # A reference a third too weak: steel does not make the field larger.
    actor = stage(parameters={**REFERENCE, "reference.strength_ut": 32.0}, speed=8.0)
    assert "no fitted calibration" in actor.answer(actor.call("accept")).message
    refused = calibrate_quickly(actor)
    assert not refused.success
    assert "~/accept" in refused.message
    assert actor.status["state"] == "uncalibrated"
    assert not actor.status["verdict"]["accepted"]
    accepted = actor.answer(actor.call("accept"))
    assert accepted.success
    actor.run(PATIENCE, stop=lambda: actor.yaws and actor.status["state"] == "calibrated")
    assert actor.status["state"] == "calibrated"
    assert actor.yaws


def test_before_the_first_field_no_impossible_file_is_named(stage):
    actor = stage()
    actor.mangle = lambda _: []
    answer = actor.answer(actor.call("load"))
    assert not answer.success
    assert "no field has arrived yet" in answer.message
    assert ".yaml" not in answer.message


def test_the_calibration_of_a_new_sensor_is_used(stage, ros_home):
    store_calibration(ros_home / "magcal" / "calibrator.mag_link.yaml")
    actor = stage()
    actor.run(PATIENCE, stop=lambda: actor.status["state"] == "calibrated")
    assert actor.status["calibration"]["magnetometer_frame"] == "mag_link"
