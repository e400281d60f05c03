"""Self-calibration while driving: a state machine without a clock or a thread.

Its inputs are samples, its outputs jobs. The owner runs a job in a worker and returns the findings,
from which decisions follow. Time is that of the samples, and only movement counts.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.calibration.heading_sigma import calibration_sigma, known_sigma
from magcal_ros.core.knowledge import Knowledge
from magcal_ros.core.samples.drive_log import DriveRecorder
from magcal_ros.core.samples.streams import Pair
from magcal_ros.core.self_calibration.jobs import (
    METHOD,
    CandidateKind,
    Decision,
    DecisionKind,
    DriveCandidate,
    DriveJob,
    DriveResult,
    Mode,
    Watch,
    difference,
    is_another,
    is_finer,
    is_same,
    reason_to_accept,
)
from magcal_ros.core.self_calibration.self_calibration_tuning import SELF_CALIBRATION

EARLIER, ALL, IRON = CandidateKind
REMEMBERED = 20  # decisions that are kept


class SelfCalibration:
    """Follows a drive and decides; `recorder` keeps the movement.

    In the mode `OFF` it only watches the calibration in force.
    """

    def __init__(self, mode: Mode = Mode.PROPOSE) -> None:
        self.mode = mode
        self.proposal: Calibration | None = None  # waits for the user
        self.recorder = DriveRecorder(SELF_CALIBRATION.memory)
        self.watch = Watch()  # of the calibration in force
        self._in_force: Calibration | None = None
        self._before: Calibration | None = None  # in force before it
        self._contests: dict[CandidateKind, DriveCandidate] = {}
        self.decisions: deque[Decision] = deque(maxlen=REMEMBERED)  # the oldest first
        self._changed = -math.inf  # clock of the last proved change of the robot
        self._looked = -math.inf
        self._round = 0
        self._is_pending = self._is_outdated = False
        self.lost = 0  # failed jobs since the last finished one

    @property
    def in_words(self) -> str:
        """The present state in words."""
        if self.mode is Mode.OFF:
            return "off"
        if self.proposal is not None:
            return "a calibration is proposed: call ~/accept to put it in force"
        contests = self._contests.items()
        probation = [each.in_words for kind, each in contests if kind is not EARLIER]
        if probation:
            return f"on probation: {' and '.join(probation)}"
        if self.recorder.rests:
            return "waiting for movement"
        sought = "a calibration" if self._in_force is None else "a better calibration"
        return f"looking for {sought}, {self.recorder.seconds / 60.0:.0f} min of driving stored"

    @property
    def _compared(self) -> Calibration | None:
        """The calibration to compare with: the proposal, or else the one in force."""
        return self._in_force if self.proposal is None else self.proposal

    def forget(self) -> None:
        """Forget the drive and its results: the sensors have changed, or the mode has."""
        self.recorder.begin_anew()
        self._contests.clear()
        self.proposal, self.watch = None, Watch()
        self._changed = self._looked = -math.inf
        self._is_outdated = True

    def put_in_force(self, calibration: Calibration | None) -> None:
        """Note that another calibration is in force.

        After a decision of this machine, the previous calibration remains on trial. Any other
        calibration resets the comparison.
        """
        old = self._in_force
        if is_same(calibration, old):
            return
        last = self.decisions[-1] if self.decisions else None
        wanted = self.proposal if last is None or self.proposal is not None else last.calibration
        decided = calibration is not None and is_same(calibration, wanted)
        earlier = self._contests.pop(EARLIER, None)
        self._contests.clear()
        self._in_force, self.proposal, self.watch = calibration, None, Watch()
        self._is_outdated = True
        if not decided:
            # Before a calibration by the user, iron may have been added or moved.
            self._changed = -math.inf if old is None else self.recorder.clock
        if old is None:
            return
        made = last.kind if decided and last is not None else None
        if made is DecisionKind.REFINED:
            # The calibration before the refined one stays the earlier one.
            if earlier is not None:
                self._contests[EARLIER] = earlier
            return
        self._before = old
        if decided and made is not DecisionKind.ROLLED_BACK:
            self._compare_earlier(old, self.recorder.clock)

    def _compare_earlier(self, calibration: Calibration, since: float) -> None:
        """Compare an earlier calibration with the one in force, on the data from a clock on."""
        self._contests[EARLIER] = DriveCandidate(EARLIER, calibration, since, since)

    def add(self, pair: Pair, speed: float = math.nan) -> bool:
        """Add a pair, which counts only if its IMU has a rate.

        The speed is in m/s, NaN if unknown. Returns whether a job is due.
        """
        is_needed = self.mode is not Mode.OFF or self._in_force is not None
        if not is_needed or not math.isfinite(sum(pair.imu.rate)):
            return False
        if not self.recorder.add(pair, speed):
            return False
        if self._is_pending or self.recorder.seconds < SELF_CALIBRATION.look_every:
            return False
        wait = SELF_CALIBRATION.look_every
        if self.mode is Mode.OFF:
            # Half of the data of each fit is new.
            wait = 0.5 * SELF_CALIBRATION.windows[0]
        elif IRON in self._contests:
            wait = 0.5 * SELF_CALIBRATION.look_every
        # The cause of a failed job may last: the wait doubles after each failure.
        return self.recorder.clock - self._looked >= wait * 2.0**self.lost

    def job(self, knowledge: Knowledge) -> DriveJob:
        """Return the job that is due; its findings are passed to `note`."""
        self._is_pending, self._is_outdated = True, False
        self._looked = self.recorder.clock
        self._round += 1
        in_force, windows = self._compared, SELF_CALIBRATION.windows
        if in_force is not None:
            # With a calibration in force, one window for each job is enough.
            since = max(self._changed, self.watch.since)
            seconds = min(self.recorder.seconds, self.recorder.clock - since)
            full = [each for each in windows if each <= seconds] or [windows[0]]
            windows = (full[self._round % len(full)],)
        log = self.recorder.log()
        contests = {kind: each for kind, each in self._contests.items() if kind is not IRON}
        return DriveJob(log, knowledge, in_force, windows, self._changed, contests, self._in_force)

    def fail(self) -> None:
        """Note that a job has failed; a later one tries again."""
        self._is_pending = False
        self.lost += 1

    def note(self, findings: DriveResult) -> list[Decision]:
        """Return the decisions that follow from a job's findings.

        The calibration of a decision must be put in force, or offered if it is `PROPOSED`.
        """
        is_current = self._is_pending and not self._is_outdated
        self._is_pending, self.lost = False, 0
        if not is_current:
            return []
        if self._in_force is not None:
            self.watch = self.watch.after(findings, self._in_force)
        if self.mode is Mode.OFF:
            return []
        made = self._weigh(findings)
        if not math.isnan(self.recorder.start):
            made = [replace(each, clock=each.clock - self.recorder.start) for each in made]
        self.decisions.extend(made)
        return made

    def _weigh(self, findings: DriveResult) -> list[Decision]:
        in_force, clock = self._compared, findings.clock
        good = sorted(filter(self._is_believable, findings.candidates), key=lambda each: each.sigma)
        if in_force is None:
            return self._begin(clock, good[0]) if good else []
        made = self._settled(findings)
        if not _changes(made):
            made += self._notice(findings, in_force)
        if not _changes(made):
            made += self._refined(clock, good, in_force)
        if not _changes(made):
            made += self._take_up(clock, good, in_force)
        return made

    def _begin(self, clock: float, best: DriveCandidate) -> list[Decision]:
        """Accept the first calibration if two windows agree."""
        first, self._contests[ALL] = self._contests.get(ALL), best
        if first is None:
            words = f"{best.in_words}; a second one that agrees confirms it"
            return [Decision(clock, DecisionKind.PROBATION, words)]
        if is_another(best, first.calibration):
            return []
        apart = math.degrees(difference(first.calibration, best.calibration))
        words = (
            f"{best.in_words}: it agrees with the fit before it ({apart:.1f}° apart), and no "
            "calibration was in force"
        )
        return [self._change(clock, best.calibration, words)]

    def _settled(self, findings: DriveResult) -> list[Decision]:
        """Put a proved calibration in force, and end comparisons that last too long."""
        made: list[Decision] = []
        since = findings.since_change
        if since is not None and IRON in self._contests:
            self._contests[IRON] = since
        for kind, candidate in list(self._contests.items()):
            ratio = findings.ratios.get(kind)
            if kind is IRON:
                why = candidate.proof if candidate is since else ""
            elif ratio is None:
                continue
            else:
                why = reason_to_accept(kind, ratio)
            if why and self._is_believable(candidate):
                return [*made, self._accept(findings.clock, candidate, why)]
            seconds = findings.clock - candidate.end
            if seconds > SELF_CALIBRATION.look_back:
                del self._contests[kind]
                made.append(_ended(findings.clock, candidate, seconds))
        return made

    def _accept(self, clock: float, candidate: DriveCandidate, why: str) -> Decision:
        """Put a proved calibration in force, or withdraw the proposal that is worse."""
        if candidate.kind is not ALL:
            self._changed = candidate.start
        if candidate.kind is not EARLIER:
            return self._change(clock, candidate.calibration, f"{candidate.in_words}: {why}")
        if self.proposal is not None and is_same(candidate.calibration, self._in_force):
            self._contests.clear()
            self.proposal = None
            words = f"the proposal is withdrawn, as what is in force is better: {why}"
            return Decision(clock, DecisionKind.DROPPED, words)
        words = f"the earlier calibration was better after all: {why}"
        return self._change(clock, candidate.calibration, words, DecisionKind.ROLLED_BACK)

    def _refined(
        self, clock: float, good: list[DriveCandidate], in_force: Calibration
    ) -> list[Decision]:
        """Replace a calibration by a much more certain one that agrees: their sigmas prove it."""
        best = next((each for each in good if is_finer(each, in_force)), None)
        is_driven = in_force.evidence.method == METHOD
        if best is None or (is_driven and self.mode is Mode.PROPOSE):
            return []
        known = math.degrees(known_sigma(in_force))
        if is_driven:
            words = f"{best.in_words}, compared with ±{known:.1f}° before"
            return [Decision(clock, DecisionKind.REFINED, words, best.calibration)]
        words = (
            f"{best.in_words}: it agrees with the calibration {self._which}, which was known to "
            f"±{known:.1f}°"
        )
        return [self._change(clock, best.calibration, words)]

    def _take_up(
        self, clock: float, good: list[DriveCandidate], in_force: Calibration
    ) -> list[Decision]:
        """Put a plausible candidate that differs from the calibration in force on probation."""
        others = (each for each in good if each.kind is ALL and is_another(each, in_force))
        best = next(others, None)
        if best is None or ALL in self._contests:
            return []
        self._contests[ALL] = best
        apart = math.degrees(difference(in_force, best.calibration))
        words = f"{best.in_words} differs by {apart:.1f}° from what is {self._which}"
        return [Decision(clock, DecisionKind.PROBATION, words)]

    def _notice(self, findings: DriveResult, in_force: Calibration) -> list[Decision]:
        """Report a change of hard iron, and put the new hard iron in force or on probation."""
        since, plainly = findings.since_change, SELF_CALIBRATION.plainly
        if since is None or IRON in self._contests or not is_another(since, in_force, plainly):
            return []
        self._contests[IRON] = since
        if self._before is not None:
            # If the iron is removed again, the calibration before it is valid again.
            self._compare_earlier(self._before, since.start)
        sigma = math.hypot(since.sigma, calibration_sigma(in_force))
        apart = difference(in_force, since.calibration)
        words = (
            f"the hard iron seems to have changed {since.seconds:.0f} s of driving ago: headings"
            f" would differ by {math.degrees(apart):.0f}° ±{math.degrees(sigma):.0f}°"
        )
        made = [Decision(findings.clock, DecisionKind.NOTICED, words)]
        if since.proof:
            # It is plain, so its sigma does not matter.
            made.append(self._accept(findings.clock, since, since.proof))
        return made

    def _is_believable(self, candidate: DriveCandidate) -> bool:
        if candidate.kind is EARLIER:
            return True
        old, plainly = self._compared, SELF_CALIBRATION.plainly
        if candidate.kind is IRON and old is not None and is_another(candidate, old, plainly):
            # A calibration that is plainly wrong may be replaced by a rough one.
            return True
        return candidate.sigma <= SELF_CALIBRATION.largest_sigma

    @property
    def _which(self) -> str:
        """The calibration to compare with, in words."""
        return "in force" if self.proposal is None else "proposed"

    def _change(
        self,
        clock: float,
        calibration: Calibration,
        words: str,
        kind: DecisionKind = DecisionKind.APPLIED,
    ) -> Decision:
        self._contests.clear()
        evidence = replace(calibration.evidence, reasons=(words,))
        calibration = replace(calibration, evidence=evidence)
        if self.mode is Mode.PROPOSE:
            self.proposal, kind = calibration, DecisionKind.PROPOSED
            if self._in_force is not None:
                self._compare_earlier(self._in_force, clock)
        return Decision(clock, kind, words, calibration)


def _changes(made: list[Decision]) -> bool:
    """Whether the last decision puts another calibration in force, or offers it."""
    return bool(made) and made[-1].calibration is not None


def _ended(clock: float, candidate: DriveCandidate, seconds: float) -> Decision:
    """Return the decision that a candidate was not proved better."""
    if candidate.kind is EARLIER:
        words = f"{seconds:.0f} s of driving show that no earlier calibration was better"
        return Decision(clock, DecisionKind.CONFIRMED, words)
    words = f"{candidate.in_words}: the driving since then has not proved it better"
    return Decision(clock, DecisionKind.DROPPED, words)
