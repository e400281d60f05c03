"""All magnetometers of the node: one heading of all, and one turn for all."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus

from magcal_ros.core.heading.several_compasses import SeveralCompasses
from magcal_ros.core.samples.gyro_at_rest import GyroAtRest
from magcal_ros.core.samples.streams import ImuSample
from magcal_ros.core.session.turn_events import Conclusion, TurnState
from magcal_ros.ros.control import Control
from magcal_ros.ros.further_magnetometer import FurtherMagnetometer
from magcal_ros.ros.heading_pipeline import FIRST
from magcal_ros.ros.keeper import CalibrationStore, Keeper
from magcal_ros.ros.services import Tell
from magcal_ros.ros.settings import Settings
from magcal_ros.ros.wire.outgoing import diagnostic, key_values

Ask = Callable[[Tell], object]
"""Asks for something that is answered later."""


class Magnetometers:
    """All magnetometers of the node: who is there, the heading of all, and turns of all at once."""

    def __init__(
        self, first: Control, topic: str, keeper: Keeper, several: SeveralCompasses
    ) -> None:
        self._first, self._topic, self._keeper, self._several = first, topic, keeper, several
        self.heard: list[FurtherMagnetometer] = []
        """The further ones that were heard, by their numbers."""

    def meet(self, met: FurtherMagnetometer) -> None:
        """Take note of one that sends for the first time."""
        self.heard = sorted([*self.heard, met], key=lambda each: each.number)

    def save(self, first: CalibrationStore, tell: Tell) -> None:
        """Save what is in force."""
        asked: dict[str, Ask] = {
            e.topic: e.store.save for e in self.heard if e.keeper.calibration is not None
        }
        if self._keeper.calibration is not None or not asked:
            asked = {self._topic: first.save} | asked
        told_together(asked, tell)

    def load(self, first: CalibrationStore, tell: Tell) -> None:
        """Put in force what the files have."""
        further = {each.topic: each.store.load for each in self.heard}
        told_together({self._topic: first.load} | further, tell)

    def accept(self, first: Callable[[Tell], None] | None, tell: Tell) -> None:
        """Put in force what waits for a person's word; `first` does so for the first of them."""
        asked: dict[str, Ask] = {e.topic: e.accept for e in self.heard if e.has_something_to_accept}
        if first is not None:
            asked = {self._topic: first} | asked
        if self.state is not TurnState.IDLE:
            tell(Conclusion(False, "a turn is under way: wait for its verdict first"))
        elif asked:
            told_together(asked, tell)
        else:
            tell(Conclusion(False, "there is no fitted calibration to accept"))

    def reset(self) -> bool:
        """Use no calibration of a further one any more; returns whether there was one."""
        were_several = self.are_calibrated
        for each in self.heard:
            each.reset()
        return were_several

    def start(self, gyro: GyroAtRest | None) -> None:
        """Let those that send collect the turn that begins."""
        for each in self.heard:
            each.start(gyro)

    def on_imu(self, sample: ImuSample) -> None:
        """Take an IMU sample."""
        for each in self.heard:
            each.on_imu(sample)

    def repeat_bias(self, stamp: Any) -> None:
        """Publish the biases of the further ones once more."""
        for each in self.heard:
            each.repeat_bias(stamp)

    def look(self, count_publishers: Callable[[str], int], settings: Settings) -> None:
        """Update those that send, once a second."""
        for each in self.heard:
            each.inputs.streams.max_gap = settings.max_gap
            each.inputs.look(count_publishers)
            if not settings.accumulate:
                each.control.forget_turns()

    def complaints(self) -> list[str]:
        """Return what is wrong with the further ones, and between all, in words."""
        found = [text for each in self.heard for text in each.inputs.complaints()]
        if not self.are_calibrated:
            return found
        topics = self._topics
        shares = self._several.shares
        # What disturbs all of them alike is no fault of one.
        if not all(share.why for share in shares.values()):
            for number, share in shares.items():
                part = f"has {share.weight:.0%} of the heading" if share.weight else "takes no part"
                found += [f"{topics[number]} {part}: {share.why}"] if share.why else []
        apart = math.degrees(self._several.disagreement)
        if apart:
            found.append(
                f"the headings of {' and '.join(topics[k] for k in shares)} are "
                f"{apart:.0f}° apart, and nothing tells which is wrong: the published sigma holds "
                "it. Calibrate all in one turn, and see whether each sits as mount_rpy_deg and "
                "mount_2_rpy_deg say"
            )
        return found

    def facts(self) -> list[dict[str, Any]]:
        """Return what `~/status` tells; nothing while only the first is there."""
        if not self.heard:
            return []
        shares = self._several.shares
        topics = self._topics
        return [
            {
                "topic": topics[number],
                "calibrated": keeper.calibration is not None,
                "created": keeper.origin.created if keeper.origin else "",
                "weight": round(shares[number].weight, 2) if number in shares else 0.0,
                "why": shares[number].why if number in shares else "",
            }
            for number, keeper in self.keepers.items()
        ]

    def diagnostics(self, name: str) -> list[DiagnosticStatus]:
        """Say how each takes part in the heading; nothing while only the first is there."""
        if not self.heard:
            return []
        status = diagnostic(name, "Magnetometers")
        facts = self.facts()
        complaints = [each.keeper.trouble for each in self.heard if each.keeper.trouble]
        complaints += self.complaints()
        status.message = "; ".join(complaints) or "all take part in the heading"
        status.level = DiagnosticStatus.WARN if complaints else DiagnosticStatus.OK
        if not self.are_calibrated:
            status.message = "; ".join(complaints) or (
                "only one of them is calibrated: ~/calibrate calibrates all in one turn"
            )
        values = {}
        for fact in facts:
            values[f"{fact['topic']} weight"] = f"{fact['weight']:.2f}"
            if fact["why"]:
                values[f"{fact['topic']}"] = fact["why"]
        status.values = key_values(values)
        return [status]

    @property
    def are_calibrated(self) -> bool:
        """Whether a calibration of a further one is in force."""
        return any(each.keeper.calibration is not None for each in self.heard)

    @property
    def keepers(self) -> dict[int, Keeper]:
        """Who has what is in force, by the magnetometers' numbers."""
        return {FIRST: self._keeper} | {each.number: each.keeper for each in self.heard}

    @property
    def _topics(self) -> dict[int, str]:
        return {FIRST: self._topic} | {each.number: each.topic for each in self.heard}

    @property
    def _controls(self) -> dict[str, Control]:
        further = {each.topic: each.control for each in self.heard}
        return {self._topic: self._first} | further

    @property
    def _busy(self) -> dict[str, Control]:
        return {t: c for t, c in self._controls.items() if c.state is not TurnState.IDLE}

    @property
    def state(self) -> TurnState:
        """What is going on; collecting as long as one of them does."""
        states = [control.state for control in self._busy.values()]
        if TurnState.COLLECTING in states:
            return TurnState.COLLECTING
        return states[0] if states else TurnState.IDLE

    def when_done(self, listener: Callable[[Conclusion], None]) -> None:
        """Call back once with the conclusion of the turns that are under way."""
        waiting = {t: c.when_done for t, c in self._busy.items()}
        told_together(waiting or {self._topic: self._first.when_done}, listener)

    def finish(self) -> Conclusion | None:
        """End the turns now and fit what there is; None means the fits are under way."""
        collecting = [c for c in self._busy.values() if c.state is TurnState.COLLECTING]
        for control in collecting:
            control.finish()
        return None if collecting else self._first.finish()

    def cancel(self) -> Conclusion:
        """Give up the turns under way; the calibrations in force stay."""
        busy = self._busy or {self._topic: self._first}
        return joined({topic: control.cancel() for topic, control in busy.items()})

    def tick(self) -> bool:
        """Let turns see that time has passed; returns whether one is under way."""
        return sum(control.tick() for control in self._controls.values()) > 0

    def shut_down(self) -> None:
        """Drop the turns under way."""
        for control in self._controls.values():
            control.shut_down()


def told_together(asked: Mapping[str, Ask], tell: Tell) -> None:
    """Ask several, by the topics of their magnetometers, and join the answers."""
    answers: dict[str, Conclusion] = {}

    def note(topic: str, conclusion: Conclusion) -> None:
        answers[topic] = conclusion
        if len(answers) == len(asked):
            tell(joined({each: answers[each] for each in asked}))

    for topic, ask in asked.items():
        ask(partial(note, topic))


def joined(conclusions: Mapping[str, Conclusion]) -> Conclusion:
    """Return one conclusion of several; only if all succeeded it is a success."""
    if len(conclusions) == 1:
        return next(iter(conclusions.values()))
    words = "; ".join(f"{topic}: {each.message}" for topic, each in conclusions.items())
    return Conclusion(all(each.success for each in conclusions.values()), words)
