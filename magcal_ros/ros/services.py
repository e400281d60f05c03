"""The node's services: all Trigger, the long ones answer when they are done."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from typing import Any, Protocol

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future
from std_srvs.srv import Trigger

from magcal_ros.core.session.turn_events import Conclusion, TurnState
from magcal_ros.ros.keeper import Tell

CALLS = QoSProfile(depth=100)
"""With the usual depth of 10, calls of a storm overwrite each other before they are read."""


class Turns(Protocol):
    """What turns are asked for."""

    @property
    def state(self) -> TurnState:
        """What is going on."""

    def when_done(self, listener: Tell) -> None:
        """Call back once with the conclusion of the turn that is under way."""

    def finish(self) -> Conclusion | None:
        """End the turn now and fit what there is; None means the fit is under way."""

    def cancel(self) -> Conclusion:
        """Give up the turn under way; the calibration in force stays."""


class Services:
    """Offers the calibration to the graph.

    `short` services answer at once, one of them is `start`; `slow` ones tell when they are done.
    `note` is given each error in a service; its caller is told as well.
    """

    def __init__(
        self,
        node: Node,
        turns: Turns,
        short: Mapping[str, Callable[[], Conclusion]],
        slow: Mapping[str, Callable[[Tell], None]],
        note: Callable[[Exception], object],
    ) -> None:
        self._node, self._turns, self._note = node, turns, note
        self._start = short["start"]
        # A waiting coroutine holds its group: with one of its own nothing else starves, and
        # being reentrant it lets a second call in, to be refused with the reason.
        waiting = ReentrantCallbackGroup()
        waiting_for = {name: self._wait_for(action) for name, action in slow.items()}
        long = {"calibrate": self._calibrate, "finish": self._finish, **waiting_for}
        for name, answer in long.items():
            node.create_service(
                Trigger,
                f"~/{name}",
                self._late_answer(answer),
                qos_profile=CALLS,
                callback_group=waiting,
            )
        for name, action in short.items():
            node.create_service(Trigger, f"~/{name}", self._answer(action), qos_profile=CALLS)

    async def _calibrate(self) -> Conclusion:
        opened = self._start()
        return await self._conclusion() if opened.success else opened

    async def _finish(self) -> Conclusion:
        if self._turns.state is TurnState.IDLE:
            return self._turns.finish() or Conclusion(False, "")
        done = self._conclusion()
        self._turns.finish()
        return await done

    def _wait_for(self, action: Callable[[Tell], None]) -> Callable[[], Awaitable[Conclusion]]:
        async def answer() -> Conclusion:
            future = self._future()
            action(future.set_result)
            return await future

        return answer

    def _late_answer(
        self, action: Callable[[], Awaitable[Conclusion]]
    ) -> Callable[[Any, Any], Any]:
        async def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            try:
                return _fill(response, await action())
            except Exception as error:  # whatever it is, the caller is told
                return _fill(response, self._failed(error))

        return answer

    def _answer(self, action: Callable[[], Conclusion]) -> Callable[[Any, Any], Any]:
        def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            try:
                return _fill(response, action())
            except Exception as error:  # whatever it is, the caller is told
                return _fill(response, self._failed(error))

        return answer

    def _failed(self, error: Exception) -> Conclusion:
        self._note(error)
        return Conclusion(False, f"an error in the node: {error}; its log says where")

    def _future(self) -> Future:
        future: Future = Future(executor=self._node.executor)
        # An rclpy before 2026 does not wake for a future that a coroutine waits for, but for a
        # callback of it.
        future.add_done_callback(lambda _: None)
        return future

    def _conclusion(self) -> Future:
        future = self._future()
        self._turns.when_done(future.set_result)
        return future


def _fill(response: Trigger.Response, conclusion: Conclusion) -> Trigger.Response:
    response.success, response.message = conclusion.success, conclusion.message
    return response
