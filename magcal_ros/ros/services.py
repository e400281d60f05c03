"""The node's services: all Trigger, the long ones answer when they are done."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future
from std_srvs.srv import Trigger

from magcal_ros.ros.control import Conclusion, Control, State

CALLS = QoSProfile(depth=100)
"""With the usual depth of 10, calls of a storm overwrite each other before they are read."""


class Services:
    """Offers the calibration to the graph.

    Parameters
    ----------
    node : rclpy.node.Node
        Where the services live.
    control : Control
        Runs the turn.
    start : callable
        Opens a session with the parameters of the moment.
    accept, save, load, reset : callable
        What the short services do.
    """

    def __init__(
        self,
        node: Node,
        control: Control,
        start: Callable[[], Conclusion],
        short: dict[str, Callable[[], Conclusion]],
    ) -> None:
        self._node = node
        self._control = control
        self._start = start
        # A waiting coroutine holds its group: with one of its own nothing else starves, and
        # being reentrant it lets a second call in, to be refused with the reason.
        waiting = ReentrantCallbackGroup()
        for name, answer in {"calibrate": self._calibrate, "finish": self._finish}.items():
            node.create_service(
                Trigger, f"~/{name}", answer, qos_profile=CALLS, callback_group=waiting
            )
        for name, action in {"start": start, "cancel": control.cancel, **short}.items():
            node.create_service(Trigger, f"~/{name}", _answer_with(action), qos_profile=CALLS)

    async def _calibrate(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        opened = self._start()
        if not opened.success:
            return _fill(response, opened)
        return _fill(response, await self._conclusion())

    async def _finish(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._control.state is not State.COLLECTING:
            return _fill(response, self._control.finish() or Conclusion(False, ""))
        done = self._conclusion()
        self._control.finish()
        return _fill(response, await done)

    def _conclusion(self) -> Future[Conclusion]:
        future: Future[Conclusion] = Future(executor=self._node.executor)
        self._control.when_done(future.set_result)
        return future


def _answer_with(action: Callable[[], Conclusion]) -> Callable[[Any, Any], Any]:
    def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return _fill(response, action())

    return answer


def _fill(response: Trigger.Response, conclusion: Conclusion | None) -> Trigger.Response:
    assert conclusion is not None
    response.success, response.message = conclusion.success, conclusion.message
    return response
