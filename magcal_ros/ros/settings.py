"""What the parameters mean, in SI units and in the core's own types."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from magcal_ros.core.earth_field.reference import Local
from magcal_ros.core.earth_field.wmm import Place
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import rotation_from_rpy
from magcal_ros.core.knowledge import Knowledge, knowledge_of
from magcal_ros.core.session.external_heading import ExternalHeading
from magcal_ros.core.session.session import Limits
from magcal_ros.ros.spec import TRUE_NORTH


@dataclass(frozen=True)
class Rotation:
    """Whether and how the robot turns itself."""

    enabled: bool
    """Whether it does."""
    speed: float
    """rad/s."""
    stamped: bool
    """Whether velocities are TwistStamped."""
    frame: str
    """Their frame_id then."""


@dataclass(frozen=True)
class Settings:
    """The parameters' values in SI units and in the core's own types.

    `knowledge` is what was given by hand; `place`, `local` and the World Magnetic Model fill in
    what its reference field lacks. `half_place` tells that only one of two coordinates was given,
    `mount_is_given` that the magnetometer's pose was; `second_mount` is that of the second one.
    An empty `base_frame` is the IMU's.
    `vehicle_yaw` is that of the IMU in the vehicle by hand, radians; None without.
    `known_heading` is the heading typed in; None without, or while its north is not said.
    `heading_is_true` tells which north the topic `heading` is to.
    """

    calibration_file: str
    report_folder: str
    reports_kept: int
    method: str
    accumulate: bool
    knowledge: Knowledge
    limits: Limits
    max_gap: float
    patience: float
    place: Place | None
    half_place: bool
    local: Local
    rotation: Rotation
    base_frame: str
    mount_is_given: bool
    second_mount: FloatArray | None
    magnetometers: int
    self_calibration: str
    vehicle_yaw: float | None
    known_heading: ExternalHeading | None
    north_is_missing: bool
    heading_is_true: bool

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Settings:
        """Build from checked values by parameter name."""
        mount = values["mount_rpy_deg"]
        mount_is_given = not any(math.isnan(angle) for angle in mount)
        knowledge = knowledge_of(
            values["reference.strength_ut"],
            values["reference.strength_sigma_ut"],
            values["reference.inclination_deg"],
            values["reference.inclination_sigma_deg"],
            values["reference.declination_deg"],
            values["soft_iron_gains"],
            mount if mount_is_given else (0.0, 0.0, 0.0),
            values["reference.declination_sigma_deg"],
        )
        spot = (values["reference.latitude_deg"], values["reference.longitude_deg"])
        unset = [math.isnan(angle) for angle in spot]
        by_hand = values["vehicle_yaw_deg"]
        return cls(
            values["calibration_file"],
            values["report_folder"],
            values["reports_kept"],
            values["method"],
            values["accumulate"],
            knowledge,
            Limits(
                values["window.timeout_s"],
                values["window.silence_s"],
                target_sigma=math.radians(values["confidence.target_sigma_deg"]),
            ),
            values["window.max_gap_s"],
            values["fused.patience_s"],
            None if any(unset) else Place(*spot, values["reference.altitude_m"]),
            unset[0] is not unset[1],
            Local(
                values["reference.strength_sigma_ut"] * 1e-6,
                math.radians(values["reference.inclination_sigma_deg"]),
                math.radians(values["reference.declination_sigma_deg"]),
            ),
            Rotation(
                values["rotate.enabled"],
                values["rotate.speed_rad_s"],
                values["rotate.stamped"],
                values["rotate.frame_id"],
            ),
            values["base_frame"],
            mount_is_given,
            _pose(values["mount_2_rpy_deg"]),
            values["magnetometers"],
            values["self_calibration"],
            None if math.isnan(by_hand) else math.radians(by_hand),
            _told(values),
            not (math.isnan(values["known_heading.yaw_deg"]) or values["known_heading.north"]),
            values["known_heading.topic_north"] == TRUE_NORTH,
        )


def _told(values: Mapping[str, Any]) -> ExternalHeading | None:
    """Return the heading typed in; None without one, or while its north is not said."""
    yaw, north = values["known_heading.yaw_deg"], values["known_heading.north"]
    if math.isnan(yaw) or not north:
        return None
    sigma = math.radians(values["known_heading.sigma_deg"])
    return ExternalHeading(math.radians(yaw), sigma, north == TRUE_NORTH)


def _pose(rpy_deg: tuple[float, float, float]) -> FloatArray | None:
    """Return a pose given by hand; None without one."""
    roll, pitch, yaw = (math.radians(angle) for angle in rpy_deg)
    return None if math.isnan(roll) else rotation_from_rpy(roll, pitch, yaw)
