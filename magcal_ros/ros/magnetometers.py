"""All magnetometers of the node, which share heading and turns; the node's services."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future
from std_srvs.srv import Trigger

from magcal_ros.core.assessment.grading import shown
from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.heading_sigma import known_sigma
from magcal_ros.core.heading.several_compasses import CompassWeight
from magcal_ros.core.session.turn_machine import Conclusion, TurnState
from magcal_ros.files.disk import printable
from magcal_ros.ros.calibration_store import Tell
from magcal_ros.ros.magnetometer import Magnetometer
from magcal_ros.ros.wire import diagnostic

Ask = Callable[[Tell], object]


class Magnetometers:
    """The magnetometers that publish: their common turns, and their parts in the heading."""

    def __init__(self, first: Magnetometer) -> None:
        self._pipeline, self._compasses = first.pipeline, first.pipeline.compasses
        self.active = [first]
        """The first magnetometer, and the further ones that have published, by number."""

    @property
    def others(self) -> list[Magnetometer]:
        """The magnetometers in `active` without the first."""
        return self.active[1:]

    def add(self, magnetometer: Magnetometer) -> None:
        """Note a magnetometer that publishes."""
        if magnetometer not in self.active:
            self.active = sorted([*self.active, magnetometer], key=lambda each: each.number)

    def save(self, tell: Tell) -> None:
        """Save the calibrations in force."""
        saving = [each for each in self.active if each.store.calibration is not None]
        ask_all({e.topic: e.store.save for e in saving or self.active[:1]}, tell)

    def load(self, tell: Tell) -> None:
        """Put the calibrations in the files in force."""
        ask_all({each.topic: each.store.load for each in self.active}, tell)

    def accept(self, proposal: Calibration | None, tell: Tell) -> None:
        """Put the refused calibrations in force; for the first magnetometer rather a `proposal`."""
        asked: dict[str, Ask] = {}
        for each in self.active:
            found = proposal if proposal is not None and each is self.active[0] else each.acceptable
            if found is not None:
                asked[each.topic] = partial(_put_in_force, each, found, found is proposal)
        if self.state is not TurnState.IDLE:
            tell(Conclusion(False, "a turn is under way: wait for its verdict first"))
        elif asked:
            ask_all(asked, tell)
        else:
            tell(Conclusion(False, "there is no fitted calibration to accept"))

    def start(self) -> Conclusion:
        """Begin a turn of all magnetometers that publish."""
        first = self.active[0]
        if self.state is not TurnState.IDLE and first.control.turn.state is TurnState.IDLE:
            words = f"already {self.state.value} the turn of another magnetometer: wait"
            return Conclusion(False, words)
        opened = first.start()
        for each in self.others if opened.success else ():
            each.start()
        return opened

    def look(self) -> None:
        """Update the magnetometers that publish, once a second."""
        node, settings = self._pipeline.node, self._pipeline.settings
        # All have the same IMU.
        sensors = [self.active[0].inputs.imu, *(each.inputs.field for each in self.active)]
        for sensor in sensors:
            infos = node.get_publishers_info_by_topic(sensor.topic)
            sensor.look([info.topic_type for info in infos])
        for each in self.active:
            each.inputs.streams.max_gap = settings.max_gap
            each.inputs.look()
            if not settings.accumulate:
                each.control.turn.forget()

    def complaints(self) -> list[str]:
        """Return the faults of the further magnetometers and of the common heading, in words."""
        found = [text for each in self.others for text in each.inputs.complaints()]
        if not self.are_calibrated:
            return found
        topics = {each.number: each.topic for each in self.active}
        weights = self._compasses.weights
        # A disturbance of all of them is not a fault of one.
        if not all(share.why for share in weights.values()):
            for number, share in weights.items():
                percent = round(100.0 * share.weight)
                part = "is not used for the heading"
                if percent:
                    part = f"has a weight of {percent}% in the heading"
                found += [f"{topics[number]} {part}: {share.why}"] if share.why else []
        apart = math.degrees(self._compasses.disagreement)
        if apart:
            names = " and ".join(topics[number] for number in weights)
            found.append(
                f"the headings of {names} are {apart:.0f}° apart, and the samples do not show "
                "which is wrong: the published sigma includes this difference. Calibrate all in "
                "one turn, and check that mount_rpy_deg and mount_2_rpy_deg are right"
            )
        return found

    def facts(self) -> list[dict[str, Any]]:
        """Return the part of `~/status` on the magnetometers; empty if there is only the first."""
        zero = {each.number: CompassWeight(0.0) for each in self.active}
        weights = zero | self._compasses.weights
        return [
            {
                "topic": each.topic,
                "calibrated": each.store.calibration is not None,
                "created": each.store.origin.created if each.store.origin else "",
                "weight": round(weights[each.number].weight, 2),
                "why": weights[each.number].why,
            }
            for each in (self.active if self.others else ())
        ]

    def diagnostics(self) -> list[DiagnosticStatus]:
        """Return the diagnostic of the common heading; empty if there is only one magnetometer."""
        if not self.others:
            return []
        complaints = [each.store.problem for each in self.others if each.store.problem]
        complaints += self.complaints()
        words = "all are used for the heading"
        if not self.are_calibrated:
            words = "only one of them is calibrated: ~/calibrate calibrates all in one turn"
        level = DiagnosticStatus.WARN if complaints else DiagnosticStatus.OK
        values = {}
        for fact in self.facts():
            values[f"{fact['topic']} weight"] = f"{fact['weight']:.2f}"
            if fact["why"]:
                values[f"{fact['topic']}"] = fact["why"]
        words = "; ".join(complaints) or words
        return [diagnostic("Magnetometers", words, values, level)]

    @property
    def are_calibrated(self) -> bool:
        """Whether a calibration of a further magnetometer is in force."""
        return any(each.store.calibration is not None for each in self.others)

    @property
    def _busy(self) -> list[Magnetometer]:
        return [each for each in self.active if each.control.turn.state is not TurnState.IDLE]

    @property
    def state(self) -> TurnState:
        """The state of the turns; collecting as long as one of them is."""
        states = [each.control.turn.state for each in self._busy]
        if TurnState.COLLECTING in states:
            return TurnState.COLLECTING
        return states[0] if states else TurnState.IDLE

    def when_done(self, listener: Tell) -> None:
        """Call `listener` once with the common conclusion of the present turns."""
        waiting = self._busy or self.active[:1]
        asked = {each.topic: each.control.when_done for each in waiting}
        ask_all(asked, listener, of_turns)

    def finish(self, tell: Tell) -> None:
        """End the collection, fit the samples so far, and answer with the common conclusion."""
        if self.state is TurnState.IDLE:
            tell(self.active[0].control.finish() or Conclusion(False, ""))
            return
        self.when_done(tell)
        for each in self._busy:
            if each.control.turn.state is TurnState.COLLECTING:
                each.control.finish()

    def cancel(self) -> Conclusion:
        """Cancel the turns under way; the calibrations in force are kept."""
        busy = self._busy or self.active[:1]
        return joined({e.topic: e.control.tell(e.control.turn.cancel) for e in busy})

    def tick(self) -> bool:
        """Check the progress of the turns; returns whether one is under way."""
        return sum(each.control.tick() for each in self.active) > 0

    def shut_down(self) -> None:
        """Discard the turns under way."""
        for each in self.active:
            each.control.shut_down()


def _put_in_force(
    magnetometer: Magnetometer, found: Calibration | str, is_proposal: bool, tell: Tell
) -> None:
    """Put a calibration in force and log it, or answer why it must not be."""
    if isinstance(found, str):
        tell(Conclusion(False, found))
        return
    if not is_proposal:
        magnetometer.reporter.put_in_force()
    sigma, method = math.degrees(known_sigma(found)), printable(found.evidence.method)
    words = f"a calibration by {method}, predicted heading error {shown(sigma)}° (1σ)"

    def note(conclusion: Conclusion) -> None:
        log = magnetometer.pipeline.node.get_logger()
        log.info(f"~/accept on {magnetometer.topic}: {words}. {conclusion.message}")
        tell(conclusion)

    magnetometer.use(found.accepted_by_person(), note)


def joined(conclusions: Mapping[str, Conclusion]) -> Conclusion:
    """Return several conclusions as one, which is a success if all are."""
    if len(conclusions) == 1:
        return next(iter(conclusions.values()))
    words = "; ".join(f"{topic}: {each.message}" for topic, each in conclusions.items())
    words = words.replace(".; ", "; ")
    return Conclusion(all(each.success for each in conclusions.values()), words)


def of_turns(conclusions: Mapping[str, Conclusion]) -> Conclusion:
    """Return several conclusions of a turn as one, which is a success if at least one is.

    It begins with the magnetometers that were not calibrated.
    """
    together = joined(conclusions)
    missing = [topic for topic, each in conclusions.items() if not each.success]
    if len(missing) in (0, len(conclusions)):
        return together
    names = " and ".join(missing)
    words = f"{names}: not calibrated, or not saved; remove the cause below"
    return Conclusion(True, f"{words}. {together.message}")


def ask_all(
    asked: Mapping[str, Ask],
    tell: Tell,
    join: Callable[[Mapping[str, Conclusion]], Conclusion] = joined,
) -> None:
    """Ask several magnetometers, by their topics, and join the answers."""
    answers: dict[str, Conclusion] = {}

    def note(topic: str, conclusion: Conclusion) -> None:
        answers[topic] = conclusion
        if len(answers) == len(asked):
            tell(join({each: answers[each] for each in asked}))

    for topic, ask in asked.items():
        ask(partial(note, topic))


CALLS = QoSProfile(depth=100)
"""With the default depth of 10, many calls at once would overwrite each other in the queue."""


def at_once(act: Callable[[], Conclusion]) -> Ask:
    """Return a service that answers immediately."""
    return lambda tell: tell(act())


def offer_services(
    node: Node, services: Mapping[str, Ask], note: Callable[[Exception], object]
) -> None:
    """Offer services, which answer as soon as their function has returned its conclusion.

    `note` takes each error in a service; the caller receives the error as well.
    """
    # A waiting coroutine blocks its callback group, so the services have their own group. It is
    # reentrant, so that a second call can be refused with the reason.
    waiting = ReentrantCallbackGroup()

    async def answer(ask: Ask, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        future: Future = Future(executor=node.executor)
        # Before 2026, rclpy wakes for the callback of a future, but not for a coroutine that
        # awaits it.
        future.add_done_callback(lambda _: None)
        try:
            ask(future.set_result)
            conclusion = await future
        except Exception as error:  # any error: the caller must be answered
            note(error)
            words = f"an error in the node: {error}; see the node's log"
            conclusion = Conclusion(False, words)
        response.success, response.message = conclusion.success, conclusion.message
        return response

    for name, ask in services.items():
        node.create_service(
            Trigger,
            f"~/{name}",
            partial(answer, ask),
            qos_profile=CALLS,
            callback_group=waiting,
        )
