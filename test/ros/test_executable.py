"""The package as a ROS user builds and runs it, in separate processes."""

import fcntl
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from xml.etree import ElementTree

import pytest
import rclpy
import yaml
from rcl_interfaces.srv import GetParameters
from std_srvs.srv import Trigger
from support import AT_ONCE, IMU_RATE, PATIENCE
from theatre import ListeningRobot

from magcal_ros.core.simulation import Robot

CHECKOUT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def installed(tmp_path_factory):
    """Build a copy of the checkout with colcon; returns the package's install prefix.

    The processes of one test run share it: the first builds, the others wait.
    """
    own = tmp_path_factory.getbasetemp()
    place = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "colcon"
    place.mkdir(exist_ok=True)
    prefix = place / "install" / "magcal_ros"
    with (place / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not prefix.is_dir():
            build(place)
    return prefix


def build(place):
    source = place / "src" / "magcal_ros"
    ignored = shutil.ignore_patterns(".*", "build", "install", "log", "__pycache__", "*.egg-info")
    shutil.copytree(CHECKOUT, source, ignore=ignored)
    environment = {**os.environ, "AMENT_PREFIX_PATH": sys.prefix, "PYTHONWARNINGS": "ignore"}
    colcon = shutil.which("colcon", path=f"{Path(sys.executable).parent}{os.pathsep}{os.defpath}")
    assert colcon, "colcon is neither beside this Python nor in the system"
    built = subprocess.run(
        [colcon, "--log-base", "log", "build", "--base-paths", "src"],
        cwd=place,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert built.returncode == 0, built.stdout + built.stderr


def before_others(**paths):
    """The variables of a setup file; ROS itself may be found by the same ones."""
    given = {name: os.environ.get(name, "") for name in paths}
    return {
        name: os.pathsep.join(filter(None, [str(path), given[name]]))
        for name, path in paths.items()
    }


@pytest.fixture
def run_installed(installed):
    """Return a function that runs the installed calibrator as `ros2 run` would."""
    processes = []
    site = next((installed / "lib").glob("python*/site-packages"))
    environment = {**os.environ, **before_others(PYTHONPATH=site, AMENT_PREFIX_PATH=installed)}

    def run(*arguments):
        process = subprocess.Popen(
            [installed / "lib" / "magcal_ros" / "calibrator", *arguments],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        processes.append(process)
        return process

    yield run
    for process in processes:
        if process.poll() is None:
            process.kill()
        process.communicate()


def parameter_of(actor, full_name, parameter):
    client = actor.node.create_client(GetParameters, f"{full_name}/get_parameters")
    assert client.wait_for_service(PATIENCE)
    future = client.call_async(GetParameters.Request(names=[parameter]))
    return actor.answer(future).values[0]


def test_all_files_are_installed_where_ros_expects_them(installed):
    assert (installed / "lib/magcal_ros/calibrator").is_file()
    assert (installed / "share/ament_index/resource_index/packages/magcal_ros").is_file()
    assert (installed / "share/magcal_ros/config/calibrator.yaml").is_file()
    manifest = ElementTree.parse(installed / "share/magcal_ros/package.xml").getroot()
    assert manifest.findtext("name") == "magcal_ros"
    assert manifest.findtext("export/build_type") == "ament_python"
    depends = {element.text for element in manifest.iter("exec_depend")}
    assert {"rclpy", "sensor_msgs", "std_msgs", "std_srvs", "diagnostic_msgs"} <= depends
    assert {"python3-numpy", "python3-scipy", "python3-yaml"} <= depends


def test_the_installed_node_calibrates_with_a_parameter_file_remaps_and_a_namespace(
    graph, run_installed, installed, tmp_path
):
    shipped = installed / "share/magcal_ros/config/calibrator.yaml"
    parameters = yaml.safe_load(shipped.read_text())
    reference = parameters["/**"]["ros__parameters"]["reference"]
    reference.update(strength_ut=50.0, inclination_deg=60.0, declination_deg=4.5)
    changed = tmp_path / "changed.yaml"
    changed.write_text(yaml.safe_dump(parameters))
    remaps = [
        *("-r", "__ns:=/robot1", "-r", "imu/mag:=/sensors/mag"),
        *("-r", "imu/data_raw:=/sensors/imu"),
    ]
    process = run_installed("--ros-args", *remaps, "--params-file", str(changed))
    node = rclpy.create_node("actor", cli_args=["--ros-args", *remaps])
    options = {"speed": 4.0, "imu_rate": IMU_RATE}
    actor = ListeningRobot(node, Robot(), calibrator="/robot1/calibrator", **options)
    actor.wait_for_node(PATIENCE)
    value = parameter_of(actor, "/robot1/calibrator", "reference.declination_deg")
    assert value.double_value == 4.5
    answer = actor.calibrate()
    assert answer.success, answer.message
    assert "/magcal/robot1/calibrator.mag_link.yaml" in answer.message
    actor.run(PATIENCE, stop=lambda: actor.yaws)
    assert actor.yaws
    node.destroy_node()
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert "error" not in errors.lower()


@pytest.mark.parametrize(
    ("how", "busy"),
    [
        (signal.SIGTERM, True),
        pytest.param(signal.SIGTERM, False, marks=pytest.mark.nightly),
        pytest.param(signal.SIGINT, False, marks=pytest.mark.nightly),
        pytest.param(signal.SIGINT, True, marks=pytest.mark.nightly),
    ],
)
def test_a_signal_ends_the_node_immediately_without_output(graph, run_installed, how, busy):
    process = run_installed()
    node = rclpy.create_node("caller")
    client = node.create_client(Trigger, "/calibrator/calibrate")
    assert client.wait_for_service(PATIENCE)
    if busy:
        client.call_async(Trigger.Request())
        time.sleep(0.5)
    process.send_signal(how)
    started = time.monotonic()
    _, errors = process.communicate(timeout=PATIENCE)
    assert time.monotonic() - started < AT_ONCE
    assert process.returncode == 0
    assert "Traceback" not in errors
    node.destroy_node()


def test_a_bad_parameter_file_is_reported_in_one_line(run_installed, tmp_path):
    bad = tmp_path / "bad.yaml"
    bad.write_text("calibrator: [")
    process = run_installed("--ros-args", "--params-file", str(bad))
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 2
    assert "Traceback" not in errors
    assert errors.splitlines()[-1].startswith("calibrator: ")
