"""Hundreds of simultaneous service calls in every state, by callers that end."""

import numpy as np
import pytest
import rclpy
from long_form import rounds
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from std_srvs.srv import Trigger
from support import PATIENCE, REFERENCE, calibrate_quickly

pytestmark = pytest.mark.faults

SERVICES = ("calibrate", "start", "finish", "cancel", "accept", "save", "load", "reset")


def test_hundreds_of_calls_are_all_answered(stage, ros_home):
    actor = stage(parameters={**REFERENCE, "report_folder": "none"}, speed=8.0)
    rng = np.random.default_rng(3)
    deep = QoSProfile(depth=1000)
    clients = {
        name: actor.node.create_client(Trigger, f"/calibrator/{name}", qos_profile=deep)
        for name in SERVICES
    }
    for client in clients.values():
        assert client.wait_for_service(PATIENCE)
    futures = []
    for _ in range(rounds(4, 200)):
        futures += [clients[str(name)].call_async(Trigger.Request())
                    for name in rng.choice(SERVICES, 30)]  # fmt: skip
        actor.run(0.2, 0.5)
    for _ in range(3):
        futures.append(clients["cancel"].call_async(Trigger.Request()))
        actor.run(PATIENCE, 0.5, stop=lambda: all(future.done() for future in futures))
    assert all(future.result().message for future in futures)
    answer = calibrate_quickly(actor)
    assert answer.success, answer.message


@pytest.mark.nightly
def test_a_caller_that_ends_does_no_harm(stage):
    actor = stage(speed=8.0)
    caller = rclpy.create_node("caller")
    client = caller.create_client(Trigger, "/calibrator/calibrate")
    assert client.wait_for_service(PATIENCE)
    client.call_async(Trigger.Request())
    actor.run(0.5, 0.5)
    assert actor.status["state"] == "collecting"
    caller.destroy_node()
    actor.run(PATIENCE, 0.5, stop=lambda: actor.status["answer"])
    assert actor.status["answer"]["success"], actor.status["answer"]


@pytest.mark.nightly
def test_parameters_changed_during_a_turn_apply_to_the_next(stage, ros_home):
    (ros_home / "magcal").mkdir(parents=True)
    (ros_home / "magcal" / "mine").write_text("a file in the way of a folder")
    actor = stage()
    setting = actor.node.create_client(SetParameters, "/calibrator/set_parameters")
    assert setting.wait_for_service(PATIENCE)
    future = actor.call("calibrate")
    actor.run(1.0, 0.5)
    changes = {
        "method": "min_max",
        "reference.strength_ut": 90.0,
        "window.timeout_s": 2.0,
        "mount_rpy_deg": [90.0, 0.0, 0.0],
        "calibration_file": str(ros_home / "magcal" / "mine" / "cal.yaml"),
        "report_folder": str(ros_home / "magcal" / "reports"),
    }
    request = SetParameters.Request(
        parameters=[
            Parameter(name, value=value).to_parameter_msg() for name, value in changes.items()
        ]
    )
    done = setting.call_async(request)
    actor.run(PATIENCE, 0.5, stop=lambda: future.done() and done.done())
    assert all(result.successful for result in done.result().results)
    answer = future.result()
    assert not answer.success
    # Where to store it is asked when it is stored; that there is no such folder ends nothing.
    assert "not saved: cannot write" in answer.message
    for service, words in (("save", "cannot write"), ("load", "cannot be loaded")):
        refused = actor.answer(actor.call(service))
        assert not refused.success
        assert words in refused.message
