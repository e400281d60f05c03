"""Known headings: typed in where a robot stands, or told by a topic."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import Imu

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.messages import heading_of
from magcal_ros.core.samples.streams import FieldSample, Pair, Pairer, Streams
from magcal_ros.core.samples.travel_samples import HeadingSample
from magcal_ros.core.session.told_heading import TUNING, ToldHeading, TurnSince
from magcal_ros.core.session.turn_events import Conclusion
from magcal_ros.core.session.turn_states import TurnState
from magcal_ros.core.up import UpFollower
from magcal_ros.ros.aside import Aside, Stopped
from magcal_ros.ros.control import in_words
from magcal_ros.ros.errands import Errands
from magcal_ros.ros.keeper import Keeper
from magcal_ros.ros.seat import Seat
from magcal_ros.ros.services import Tell, Turns
from magcal_ros.ros.settings import Settings
from magcal_ros.ros.straight import SENSOR_DATA
from magcal_ros.ros.wire.incoming import Unreadable, by_rclpy

if TYPE_CHECKING:
    from magcal_ros.core.session.dockings import Docked
    from magcal_ros.core.smoother.headings import Standing

TOPIC = "heading"
FRESH = 1.0
"""Seconds after which the topic's last heading is no heading of this moment."""
TICK = 0.2
"""Seconds between looks while samples are collected."""
NO_HEADING = (
    "no known heading: set known_heading.yaw_deg (ENU: 0 to the east, 90 to the north, positive to "
    "the left) and known_heading.north (true or magnetic), or publish a sensor_msgs/Imu with an "
    "orientation on "
)
NO_NORTH = (
    "say which north known_heading.yaw_deg is to: set known_heading.north to true (maps, walls in "
    "plans, two antennas) or magnetic (a compass)"
)


class Owner(Protocol):
    """What the node does for it."""

    def put_in_force(self, calibration: Calibration, tell: Tell, keeps_former: bool = True) -> None:
        """Apply a calibration and store it; only what is stored as well is a success."""


class KnownHeadings:
    """Calibrates where the robot stands at a known heading.

    Parameters
    ----------
    node : rclpy.node.Node
        Where the subscription lives.
    owner : Owner
        Puts in force what was found.
    keeper : Keeper
        Has what is in force.
    settled : callable
        Returns the parameters as they hold for a turn.
    seat : Seat
        Whose heading is published, and so is told.
    follower : UpFollower
        Has taken each IMU message.
    streams : Streams
    fits : Errands
    group : CallbackGroup
        Of the subscription.

    Attributes
    ----------
    is_collecting : bool
        Whether it wants each field sample.
    follows : bool
        Whether it wants each IMU sample.
    """

    def __init__(
        self,
        node: Node,
        owner: Owner,
        keeper: Keeper,
        settled: Callable[[], Settings],
        seat: Seat,
        follower: UpFollower,
        streams: Streams,
        fits: Errands,
        group: CallbackGroup,
    ) -> None:
        self._owner, self._keeper, self._settled, self._seat = owner, keeper, settled, seat
        self._follower, self._streams, self._fits = follower, streams, fits
        self._aside = Aside()
        self._topic = node.resolve_topic_name(TOPIC)
        self._standings: tuple[Standing, ...] = ()
        self._in_words: list[str] = []
        self._since: TurnSince | None = None
        self._pairs: list[Pair] = []
        self._pairer = Pairer(streams)
        self._told: ToldHeading | None = None
        self._tell: Tell | None = None
        self._deadline = math.inf
        self._heard: tuple[float, HeadingSample] | None = None
        self._yaws: list[HeadingSample] = []
        self._odd = ""
        self._answer = ""
        self.is_collecting = self.follows = False
        self.subscription = node.create_subscription(
            Imu, TOPIC, self._on_heading, SENSOR_DATA, raw=True, callback_group=group
        )
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(TICK, self._on_tick, clock=steady)
        self._timer.cancel()

    def end(self) -> None:
        """End the process that fits for good."""
        self._aside.end()

    def forget(self) -> None:
        """Begin anew with the next heading."""
        self._standings, self._in_words, self._since = (), [], None
        self.follows = False
        self._answer = ""

    def calibrate(self, turns: Turns, tell: Tell) -> None:
        """Collect where the robot stands now, and tell what its heading shows.

        Parameters
        ----------
        turns : Turns
            Another calibration that may be under way.
        tell : callable
        """
        if turns.state is not TurnState.IDLE:
            tell(Conclusion(False, "a turn is under way: wait for its verdict first"))
            return
        if self._tell is not None:
            tell(Conclusion(False, "already collecting at a known heading: wait for its answer"))
            return
        settings = self._settled()
        told = settings.known_heading
        if settings.north_is_missing:
            tell(Conclusion(False, NO_NORTH))
        elif told is None and not self._is_fresh():
            tell(Conclusion(False, f"{NO_HEADING}{self._topic}{self._topic_in_words()}"))
        elif self._seat.view is None:
            tell(
                Conclusion(
                    False,
                    "the pose of the IMU in base_frame is not known, so that a heading of that "
                    "frame says nothing of the IMU's: publish robot_description, or leave "
                    "base_frame empty and give the IMU's heading",
                )
            )
        else:
            self._tell, self._told = tell, told
            self._pairs, self._yaws = [], []
            self._pairer = Pairer(self._streams)
            self._deadline = time.monotonic() + TUNING.patience
            self.is_collecting = True
            self._timer.reset()

    def on_field(self, sample: FieldSample) -> None:
        """Take a field sample while collecting."""
        self._pairer.offer(sample)
        self._pairs += self._pairer.take()
        pairs = self._pairs
        if pairs and pairs[-1].field.stamp - pairs[0].field.stamp >= TUNING.seconds:
            self._fit()

    def on_imu(self, stamp: float) -> None:
        """Go on to an IMU message, of which up knows already, since the last standing."""
        up, since = self._follower.newest, self._since
        if since is None or up is None:
            return
        follower = self._follower
        if not follower.is_propagated:
            # What turned meanwhile nobody knows.
            self._since, self.follows = None, False
            return
        since.add(stamp, up, follower.mean_rate, follower.gyro_bias.variance)

    def facts(self) -> dict[str, Any] | None:
        """Return what `~/status` tells; None where there is no known heading."""
        if not self._standings and self._heard is None and not self._answer:
            return None
        return {
            "collecting": self.is_collecting,
            "headings": self._in_words,
            "answer": self._answer,
            "topic": None if self._heard is None else self._topic,
        }

    @property
    def complaints(self) -> list[str]:
        """What is wrong with the topic, in words."""
        return [f"{self._topic}: {self._odd}"] if self._odd else []

    def _on_heading(self, data: bytes) -> None:
        try:
            sample = heading_of(by_rclpy(data, Imu))
        except Unreadable as error:
            sample = str(error)
        if isinstance(sample, str):
            self._odd = sample
            return
        self._odd = ""
        self._heard = time.monotonic(), sample
        if self.is_collecting:
            self._yaws.append(sample)

    def _is_fresh(self) -> bool:
        return self._heard is not None and time.monotonic() - self._heard[0] < FRESH

    def _topic_in_words(self) -> str:
        if self._odd:
            return f" (there is one, but {self._odd})"
        return " (the last one came too long ago)" if self._heard is not None else ""

    def _on_tick(self) -> None:
        if not self.is_collecting:
            self._timer.cancel()
        elif time.monotonic() > self._deadline:
            self._fit()

    def _fit(self) -> None:
        from magcal_ros.core.session.dockings import Stood, dock_stood

        # The timer ends itself: cancelled by another thread it may be on its way already.
        self.is_collecting = False
        settings = self._settled()
        told = self._told or self._told_by_topic(settings)
        view = self._seat.view
        if told is None or view is None:
            self._conclude(Conclusion(False, f"{self._topic} fell silent meanwhile"))
            return
        follower = self._follower
        stood = Stood(
            tuple(self._pairs),
            told,
            settings.knowledge,
            view.pose[0],
            self._since,
            follower.gyro_bias.rate if follower.is_propagated else (0.0, 0.0, 0.0),
        )
        self._pairs = []
        before, in_force = self._standings, self._keeper.calibration
        self._fits.run(
            lambda: self._aside.run(dock_stood, before, stood, in_force),
            lambda docked: self._note(docked, told),
            self._lost,
        )

    def _told_by_topic(self, settings: Settings) -> ToldHeading | None:
        """Return the mean of the topic's headings while the robot stood."""
        if not self._yaws:
            return None
        east = sum(math.cos(each.yaw) for each in self._yaws)
        north = sum(math.sin(each.yaw) for each in self._yaws)
        # What is wrong in one message of a receiver is wrong in the next, too.
        sigma = max(each.sigma for each in self._yaws)
        return ToldHeading(math.atan2(north, east), sigma, settings.heading_is_true)

    def _lost(self, error: Exception) -> None:
        words = "the node ends" if isinstance(error, Stopped) else in_words(error)
        self._conclude(Conclusion(False, f"nothing was found: {words}"))

    def _note(self, docked: Docked, told: ToldHeading) -> None:
        self._aside.stop()
        if docked.standings is not self._standings and docked.outcome.calibration is not None:
            self._standings = docked.standings
            self._in_words = [*self._in_words, told.in_words][-len(docked.standings) :]
            self._since, self.follows = TurnSince(), True
        calibration = docked.outcome.calibration
        if not docked.applies or calibration is None:
            # A heading that agrees with a better calibration is no failure.
            self._conclude(Conclusion(docked.outcome.verdict.accepted, docked.words))
            return
        self._owner.put_in_force(
            calibration,
            lambda done: self._conclude(Conclusion(done.success, f"{docked.words} {done.message}")),
        )

    def _conclude(self, conclusion: Conclusion) -> None:
        tell, self._tell = self._tell, None
        self._told, self._answer = None, conclusion.message
        if tell is not None:
            tell(conclusion)
