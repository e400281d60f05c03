"""The node's services: all Trigger, the long ones answer when they are done."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future
from std_srvs.srv import Trigger

from magcal_ros.core.session.turn_events import Conclusion
from magcal_ros.core.session.turn_states import TurnState
from magcal_ros.ros.control import Control

Tell = Callable[[Conclusion], None]

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
    short : dict of callable
        What the services that answer at once do.
    slow : dict of callable
        What those do that go to the disk; each is given whom to tell when it is done.
    """

    def __init__(
        self,
        node: Node,
        control: Control,
        start: Callable[[], Conclusion],
        short: Mapping[str, Callable[[], Conclusion]],
        slow: Mapping[str, Callable[[Tell], None]],
    ) -> None:
        self._node = node
        self._control = control
        self._start = start
        # A waiting coroutine holds its group: with one of its own nothing else starves, and
        # being reentrant it lets a second call in, to be refused with the reason.
        waiting = ReentrantCallbackGroup()
        waiting_for = {name: self._wait_for(action) for name, action in slow.items()}
        long = {"calibrate": self._calibrate, "finish": self._finish, **waiting_for}
        for name, answer in long.items():
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
        if self._control.state is not TurnState.COLLECTING:
            return _fill(response, self._control.finish() or Conclusion(False, ""))
        done = self._conclusion()
        self._control.finish()
        return _fill(response, await done)

    def _wait_for(self, action: Callable[[Tell], None]) -> Callable[[Any, Any], Any]:
        async def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            future = self._future()
            action(future.set_result)
            return _fill(response, await future)

        return answer

    def _future(self) -> Future:
        future: Future = Future(executor=self._node.executor)
        # An rclpy before 2026 does not wake for a future that a coroutine waits for, but for a
        # callback of it.
        future.add_done_callback(lambda _: None)
        return future

    def _conclusion(self) -> Future:
        future = self._future()
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
