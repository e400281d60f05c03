"""The ROS graph of a test: the real node, and simulated robots that wait for it."""

import contextlib
import shutil
import threading
import time

import pytest
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.parameter import Parameter
from std_msgs.msg import Float64
from support import IMU_RATE, PATIENCE, REFERENCE, ROBOT, SPEED

from magcal_ros.ros import node as node_module
from magcal_ros.ros.node import Calibrator
from magcal_ros.ros.rehearsal import Rehearsal

HEARTBEAT = 0.2
"""Seconds between diagnostics, instead of one: most of what a test waits for comes with them."""

FARTHEST_AHEAD = 40
"""Messages that a robot may be ahead of the node; its queue takes a hundred."""

LOST_AFTER = 0.5
"""Seconds after which messages that have not arrived count as lost."""

WAITING_SPEED = 2.0
"""Fastest time of a robot at rest that waits for an answer, often for that of a fit."""


class ListeningRobot(Rehearsal):
    """A robot that keeps the published yaws."""

    def __init__(self, node, *arguments, **options):
        super().__init__(node, *arguments, **options)
        self.yaws = []
        node.create_subscription(Float64, "compass/yaw", lambda m: self.yaws.append(m.data), 10)


class PacedRobot(ListeningRobot):
    """A robot whose time waits for the node: no machine is too slow for it."""

    def __init__(self, *arguments, audience=None, **options):
        super().__init__(*arguments, **options)
        self._audience, self._under_way = audience, 0
        self.mangle = lambda sample: [sample]
        publish = self.source.publish

        def counted(sample):
            for each in self.mangle(sample):
                self._under_way += 1
                publish(each)

        self.source.publish = counted
        self._arrived = self._count()

    def answer(self, future):
        usual, self.speed = self.speed, min(self.speed, WAITING_SPEED)
        try:
            return super().answer(future)
        finally:
            self.speed = usual

    def _count(self):
        inputs = self._audience and self._audience._inputs
        return inputs.imu.messages + inputs.field.messages if inputs else 0

    def _spin_until(self, moment):
        super()._spin_until(moment)
        deadline = time.monotonic() + LOST_AFTER
        while self._audience is not None and self._is_far_ahead():
            if time.monotonic() > deadline:
                self._under_way = 0
            self._executor.spin_once(timeout_sec=0.01)

    def _is_far_ahead(self):
        before, self._arrived = self._arrived, self._count()
        self._under_way = max(0, self._under_way - (self._arrived - before))
        return self._under_way > FARTHEST_AHEAD


class Theatre:
    """Nodes and robots that end when it is closed."""

    def __init__(self):
        self._closing = contextlib.ExitStack()
        self.calibrators = []

    def start_node(self, parameters=REFERENCE, arguments=()):
        """Start the real node with parameters, spinning in a thread.

        It draws no reports unless its parameters name a folder: each costs a second of a core.
        """
        given = {"report_folder": "none", **parameters}
        overrides = [Parameter(name, value=value) for name, value in given.items()]
        node = Calibrator(parameter_overrides=overrides, cli_args=list(arguments) or None)
        spinner = node.spinner()

        def spin():
            with contextlib.suppress(ExternalShutdownException):
                spinner.spin()

        thread = threading.Thread(target=spin, daemon=True)
        thread.start()

        def end():
            spinner.shutdown(timeout_sec=PATIENCE)
            thread.join(timeout=PATIENCE)
            node.close()
            node.destroy_node()

        self._closing.callback(end)
        self.calibrators.append(node)
        return node

    def enter(self, robot=ROBOT, **options):
        """Bring a simulated robot into the graph."""
        node = rclpy.create_node("actor")
        self._closing.callback(node.destroy_node)
        # Several share their sensors, or are in separate namespaces.
        audience = self.calibrators[0] if len(self.calibrators) == 1 else None
        options = {"speed": SPEED, "imu_rate": IMU_RATE, **options}
        rehearsal = PacedRobot(node, robot, audience=audience, **options)
        rehearsal.wait_for_node(PATIENCE)
        return rehearsal

    def stage(self, robot=ROBOT, parameters=REFERENCE, **options):
        """Start the node and a robot; returns the robot."""
        self.start_node(parameters)
        return self.enter(robot, **options)

    def loaded(self, calibration, folder, robot=ROBOT, parameters=REFERENCE, **options):
        """Bring a robot whose node has a copy of a calibration in force already."""
        path = shutil.copy(calibration, folder / "calibration.yaml")
        rehearsal = self.stage(robot, {**parameters, "calibration_file": str(path)}, **options)
        rehearsal.run(PATIENCE, stop=lambda: rehearsal.status["state"] == "calibrated")
        assert rehearsal.status["state"] == "calibrated"
        return rehearsal

    def close(self):
        self._closing.close()


@contextlib.contextmanager
def open_theatre():
    """Join the ROS graph, and leave it with all nodes."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(node_module, "HEARTBEAT", HEARTBEAT)
        rclpy.init()
        theatre = Theatre()
        try:
            yield theatre
        finally:
            theatre.close()
            rclpy.try_shutdown()
