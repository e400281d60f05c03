"""The real node in a thread of its own, and a simulated robot that talks to it over DDS."""

import contextlib
import shutil
import sys
import threading

import pytest
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.parameter import Parameter
from support import PATIENCE, REFERENCE, ROBOT, SPEED, store_calibration

from magcal_ros.ros.main import SWITCH_INTERVAL
from magcal_ros.ros.node import Calibrator
from magcal_ros.ros.rehearsal import Rehearsal


@pytest.fixture(autouse=True, scope="session")
def switch_interval():
    """Let threads take turns as they do in the node's own process."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_INTERVAL)
    yield
    sys.setswitchinterval(before)


@pytest.fixture(autouse=True)
def ros_home(tmp_path, monkeypatch):
    """Give each test a ROS home of its own."""
    home = tmp_path / "ros_home"
    monkeypatch.setenv("ROS_HOME", str(home))
    return home


@pytest.fixture
def graph():
    """Join the ROS graph for one test."""
    rclpy.init()
    yield
    rclpy.try_shutdown()


@pytest.fixture
def start_node(graph):
    """Return a function that starts the real node with parameters, spinning in a thread.

    It draws no reports unless its parameters name a folder: each costs a second of a core.
    """
    running = []

    def start(parameters=REFERENCE, arguments=()):
        given = {"report_folder": "none", **parameters}
        overrides = [Parameter(name, value=value) for name, value in given.items()]
        node = Calibrator(parameter_overrides=overrides, cli_args=list(arguments) or None)
        spinner = node.spinner()

        def spin():
            with contextlib.suppress(ExternalShutdownException):
                spinner.spin()

        thread = threading.Thread(target=spin, daemon=True)
        thread.start()
        running.append((node, spinner, thread))
        return node

    yield start
    for node, spinner, thread in running:
        spinner.shutdown(timeout_sec=PATIENCE)
        thread.join(timeout=PATIENCE)
        node.close()
        node.destroy_node()


@pytest.fixture
def actor(graph):
    """Return a function that brings a simulated robot into the graph."""
    nodes = []

    def enter(robot=ROBOT, **options):
        node = rclpy.create_node("actor")
        nodes.append(node)
        rehearsal = Rehearsal(node, robot, **{"speed": SPEED, **options})
        rehearsal.wait_for_node(PATIENCE)
        return rehearsal

    yield enter
    for node in nodes:
        node.destroy_node()


@pytest.fixture(scope="session")
def calibration_of_the_robot(tmp_path_factory):
    """Return a file with a calibration of the robot, for copies to be loaded from."""
    return store_calibration(tmp_path_factory.mktemp("stored") / "calibration.yaml")


@pytest.fixture
def loaded(stage, calibration_of_the_robot, tmp_path):
    """Return a function that brings a robot whose node has a calibration in force already."""

    def set_up(robot=ROBOT, parameters=REFERENCE, **options):
        path = shutil.copy(calibration_of_the_robot, tmp_path / "calibration.yaml")
        stored = {**parameters, "calibration_file": str(path)}
        rehearsal = stage(robot, stored, **options)
        rehearsal.run(PATIENCE, stop=lambda: rehearsal.status["state"] == "calibrated")
        assert rehearsal.status["state"] == "calibrated"
        return rehearsal

    return set_up


@pytest.fixture
def stage(start_node, actor):
    """Return a function that starts the node and a robot, and gives the robot."""

    def set_up(robot=ROBOT, parameters=REFERENCE, **options):
        start_node(parameters)
        return actor(robot, **options)

    return set_up
