"""The real node in its own thread, and a simulated robot that sends to it over DDS."""

import sys

import pytest
from support import store_calibration
from theatre import open_theatre

from magcal_ros.ros.main import SWITCH_INTERVAL


@pytest.fixture(autouse=True, scope="session")
def switch_interval():
    """Switch threads as often as in the node's process."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_INTERVAL)
    yield
    sys.setswitchinterval(before)


@pytest.fixture(autouse=True)
def ros_home(tmp_path, monkeypatch):
    """Give each test a separate ROS home."""
    home = tmp_path / "ros_home"
    monkeypatch.setenv("ROS_HOME", str(home))
    return home


@pytest.fixture
def graph():
    """Join the ROS graph for one test."""
    with open_theatre() as theatre:
        yield theatre


@pytest.fixture
def start_node(graph):
    """Return a function that starts the real node with parameters, spinning in a thread."""
    return graph.start_node


@pytest.fixture
def actor(graph):
    """Return a function that brings a simulated robot into the graph."""
    return graph.enter


@pytest.fixture
def stage(graph):
    """Return a function that starts the node and a robot, and gives the robot."""
    return graph.stage


@pytest.fixture(scope="session")
def calibration_of_the_robot(tmp_path_factory):
    """Return a file with a calibration of the robot, for copies to be loaded from."""
    return store_calibration(tmp_path_factory.mktemp("stored") / "calibration.yaml")


@pytest.fixture
def loaded(graph, calibration_of_the_robot, tmp_path):
    """Return a function that brings a robot whose node has a calibration in force already."""

    def set_up(*arguments, **options):
        return graph.loaded(calibration_of_the_robot, tmp_path, *arguments, **options)

    return set_up
