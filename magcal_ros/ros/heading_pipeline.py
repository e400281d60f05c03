"""The steps from a field message of any magnetometer to the published heading."""

from __future__ import annotations

from collections.abc import Mapping

from rclpy.node import Node

from magcal_ros.core.calibration.calibration import Calibration
from magcal_ros.core.heading.compass import Compass, Moment
from magcal_ros.core.heading.several_compasses import SeveralCompasses
from magcal_ros.core.keeping.decisions import Mode
from magcal_ros.core.samples.streams import FieldSample, Streams
from magcal_ros.core.session.turn_events import TurnState
from magcal_ros.core.up import UpFollower
from magcal_ros.files.calibration_file import Origin
from magcal_ros.ros.inputs import Sensor
from magcal_ros.ros.keeper import Keeper
from magcal_ros.ros.motors import Motors
from magcal_ros.ros.outputs import FusedOutput, HeadingOutput
from magcal_ros.ros.reference_source import ReferenceSource
from magcal_ros.ros.sensor_frames import SensorFrames
from magcal_ros.ros.settings import Settings
from magcal_ros.ros.travel import Travel
from magcal_ros.ros.wire.incoming import FieldArrival

FIRST = 1
"""Number of the magnetometer on `imu/mag`; the second is on `imu/mag_2`."""


class HeadingPipeline:
    """Computes and publishes the heading from the messages of all magnetometers.

    Attributes
    ----------
    motors : Motors
        Follows what the motors do.
    several : SeveralCompasses
        Joins the magnetometers.
    are_several : bool
        Whether a calibration of a further one is in force, so that there is something to join.
    lead : Calibration or None
        In whose terms the heading is: that of the first magnetometer that has one.
    """

    def __init__(
        self,
        node: Node,
        up: UpFollower,
        imu: Sensor,
        streams: Streams,
        frames: SensorFrames,
        reference_source: ReferenceSource,
        travel: Travel,
    ) -> None:
        self._node, self.up, self._imu, self.streams = node, up, imu, streams
        self.frames, self._reference, self._travel = frames, reference_source, travel
        self.motors = Motors(node, up, travel)
        self.headings = HeadingOutput(node, frames)
        self.fused = FusedOutput(node, up, frames)
        self.several = SeveralCompasses()
        self.are_several = False
        self.lead: Calibration | None = None
        self._origin: Origin | None = None
        self._in_force: dict[int, Calibration | None] = {}

    def use(self, keepers: Mapping[int, Keeper]) -> None:
        """Use what is in force, by the numbers of the magnetometers."""
        for number, keeper in keepers.items():
            if keeper.calibration is not self._in_force.get(number):
                self._in_force[number] = keeper.calibration
                self.several.put_in_force(number, keeper.calibration)
        in_force = [number for number, keeper in keepers.items() if keeper.calibration is not None]
        self.are_several = self.fused.is_needed = any(number > FIRST for number in in_force)
        leader = keepers[min(in_force)] if in_force else None
        lead = None if leader is None else leader.calibration
        self._origin = None if leader is None else leader.origin
        if lead is not self.lead:
            self.lead = lead
            self.headings.begin_anew(lead)
            self.fused.begin_anew(lead)
            self._reference.use(lead)
            self._travel.use(self._origin.vehicle_yaw if self._origin else None)

    def follow(self, settings: Settings, keeper: Keeper, turn: TurnState) -> None:
        """Take the parameters, use what was learnt of the motors and keep it, once a second."""
        self.fused.patience = settings.patience
        learnt = self.motors.follow(Mode(settings.self_calibration), turn is not TurnState.IDLE)
        if learnt is not None:
            keeper.keep_motors(learnt)

    def on_imu(self, seconds: float, stamp: bytes) -> None:
        """Go on to an IMU message, of which up knows already."""
        reference = self._reference.reference.field
        self.fused.on_imu(seconds, stamp, self.body_frame(), reference)

    def moment_of(self, compass: Compass, sample: FieldSample) -> Moment:
        """Return what a field sample comes to by a compass."""
        up = self.up.at(sample.stamp, self.streams.max_gap)
        running = self.motors.as_used(compass, sample.stamp)
        turning = self.up.rate if self.up.is_propagated else None
        return Moment.of(compass, sample, up, self.streams.newest_rate, running, turning)

    def take(self, number: int, moment: Moment, arrived: FieldArrival) -> None:
        """Publish the heading that follows from a magnetometer's message."""
        if self.are_several:
            now = self.streams.imu_stamps.newest
            joined = self.several.add(number, moment, now, self.fused.yaw)
            if joined is None:
                return
            moment = joined
        reference = self._reference.reference.field
        self.headings.publish(moment, arrived.stamp, self.body_frame(), reference)
        self.fused.on_field(moment)
        self._travel.on_moment(moment)

    def body_frame(self) -> str:
        """Return the IMU's frame."""
        return self._imu.frame or (self._origin.imu_frame if self._origin else "")

    def settled(self, number: int = FIRST, frame: str = "") -> Settings:
        """Return the parameters as they hold for a turn of one magnetometer."""
        settings = self._reference.settings
        if number == FIRST:
            return self.frames.settled(settings)
        return self.frames.settled_for(settings, number, frame)

    def origin_of(self, magnetometer_frame: str) -> Origin:
        """Return where a calibration that is made now comes from."""
        node = self._node.get_fully_qualified_name()
        return Origin.now(magnetometer_frame, self._imu.frame, node, self._travel.yaw)

    @property
    def vehicle_words(self) -> str:
        """How the IMU sits in the vehicle, for people; empty while it is not known."""
        return self._travel.words
