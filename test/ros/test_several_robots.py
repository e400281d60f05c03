"""Two robots in one graph: separate diagnostics, and a command for one of them."""

import signal
import subprocess
import sys
import time

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from support import PATIENCE

COMMAND = [sys.executable, "-m", "magcal_ros.cli.main", "calibrate", "--skip-preflight"]
NODE = [sys.executable, "-m", "magcal_ros.ros.main"]


def in_namespace(name):
    return ["--ros-args", "-r", f"__ns:=/{name}"]


def run(*arguments):
    return subprocess.run(
        [*COMMAND, *arguments], capture_output=True, text=True, timeout=PATIENCE, check=False
    )


def test_diagnostics_have_separate_names_and_hardware(start_node, actor):
    start_node(arguments=in_namespace("one"))
    start_node(arguments=in_namespace("two"))
    start_node()
    robot = actor()
    received = {}

    def hear(message):
        received.update({status.name: status for status in message.status})

    robot.node.create_subscription(DiagnosticArray, "/diagnostics", hear, 50)
    wanted = {f"{name}: Inputs" for name in ("one/calibrator", "two/calibrator", "calibrator")}
    robot.run(PATIENCE, stop=lambda: wanted <= set(received))
    assert wanted <= set(received)

    def values_of(name):
        return {pair.key: pair.value for pair in received[f"{name}: Inputs"].values}

    def rates():
        values = values_of("calibrator")
        return [values[f"/{topic} rate"].split() for topic in ("imu/data_raw", "imu/mag")]

    robot.run(PATIENCE, stop=lambda: all(float(number) > 10.0 for number, _ in rates()))
    assert all(float(number) > 10.0 and unit == "Hz" for number, unit in rates())
    assert {status.hardware_id for name, status in received.items() if name[0] == "c"} == {
        "mag_link"
    }
    assert values_of("one/calibrator")["/one/imu/mag rate"] == "0.0 Hz"


@pytest.mark.nightly
def test_with_several_calibrators_a_name_is_required(start_node):
    start_node(arguments=in_namespace("one"))
    start_node(arguments=in_namespace("two"))
    done = run()
    assert done.returncode == 2
    assert "2 calibrators were found: /one/calibrator, /two/calibrator" in done.stderr
    done = run("--node", "/calibrator")
    assert done.returncode == 1
    assert "calibrators found: /one/calibrator, /two/calibrator" in done.stderr


@pytest.mark.nightly
def test_without_a_calibrator_the_remedy_is_given():
    done = run()
    assert done.returncode == 1
    assert "no calibrator was found" in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.fixture
def node_process():
    process = subprocess.Popen([*NODE, "--ros-args", "-p", "report_folder:=none"])
    yield process
    process.kill()
    process.wait()


@pytest.fixture
def command(node_process):
    process = subprocess.Popen(COMMAND, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    yield process
    process.kill()
    process.communicate()


def wait_for_turn(graph_node):
    from std_msgs.msg import String

    from magcal_ros.ros.sensor_frames import LATCHED

    received = []
    graph_node.create_subscription(
        String, "/calibrator/status", lambda m: received.append(m.data), LATCHED
    )
    until = time.monotonic() + PATIENCE
    while not (received and '"collecting"' in received[-1]) and time.monotonic() < until:
        rclpy.spin_once(graph_node, timeout_sec=0.1)
    assert '"collecting"' in received[-1]


@pytest.fixture
def graph_node(graph):
    node = rclpy.create_node("looks_on")
    yield node
    node.destroy_node()


@pytest.mark.nightly
def test_a_killed_node_ends_the_command_within_seconds(node_process, command, graph_node):
    wait_for_turn(graph_node)
    time.sleep(1.5)
    node_process.kill()
    _, errors = command.communicate(timeout=PATIENCE)
    assert command.returncode == 1
    assert "/calibrator has been silent for 6 s: the node has ended or hangs" in errors


@pytest.mark.nightly
def test_ctrl_c_ends_the_command_immediately_even_without_the_node(
    node_process, command, graph_node
):
    wait_for_turn(graph_node)
    node_process.kill()
    time.sleep(0.5)
    command.send_signal(signal.SIGINT)
    command.communicate(timeout=PATIENCE)
    assert command.returncode == 130
