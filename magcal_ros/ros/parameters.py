"""Declares and checks the node's parameters, and follows their changes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from difflib import get_close_matches
from typing import Any

import numpy as np
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from magcal_ros.core.earth_field.reference import GivenReference
from magcal_ros.core.geometry.arrays import FloatArray
from magcal_ros.core.geometry.rotations import rotation_from_rpy
from magcal_ros.core.knowledge import Knowledge, Mounting
from magcal_ros.core.self_calibration.jobs import Mode
from magcal_ros.core.session.external_heading import ExternalHeading
from magcal_ros.core.session.session import Limits
from magcal_ros.files.default_paths import chosen_path, lies_within, own_folder
from magcal_ros.files.disk import FileError
from magcal_ros.ros.parameter_table import (
    MAY_BE_ENABLED,
    PARAMETERS,
    TRUE_NORTH,
    ParameterSpec,
    RuntimeChange,
    Value,
)


@dataclass(frozen=True)
class Rotation:
    """The parameters of a robot that turns itself."""

    enabled: bool
    speed: float
    """rad/s."""
    stamped: bool
    frame: str


@dataclass(frozen=True)
class Settings:
    """The values of the parameters in SI units and in types of the core."""

    calibration_file: str
    report_folder: str
    reports_kept: int
    method: str
    accumulate: bool
    knowledge: Knowledge  # given by parameters
    limits: Limits
    max_gap: float
    patience: float
    given: GivenReference  # parts of the reference field, and the place
    rotation: Rotation
    base_frame: str  # empty for the IMU's frame
    mounts: Mapping[int, FloatArray]  # given poses in the IMU's frame, by number of magnetometer
    magnetometers: int
    self_calibration: Mode
    vehicle_yaw: float | None  # of the IMU in the vehicle, radians; None if not given
    known_heading: ExternalHeading | None  # None if the yaw or the north is not given
    north_is_missing: bool  # whether only the yaw of the known heading is given
    heading_is_true: bool  # whether the topic `heading` refers to true north

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Settings:
        """Build from checked values by parameter name."""
        mounts = {
            number: rotation_from_rpy(*map(math.radians, values[name]))
            for number, name in ((1, "mount_rpy_deg"), (2, "mount_2_rpy_deg"))
            if not math.isnan(values[name][0])
        }
        given = GivenReference.of(
            {name.removeprefix("reference."): v for name, v in values.items()}
        )
        mounting = Mounting(values["soft_iron_gains"], mounts.get(1, np.eye(3)))
        by_hand, sigma = values["vehicle_yaw_deg"], values["confidence.target_sigma_deg"]
        yaw, north = values["known_heading.yaw_deg"], values["known_heading.north"]
        known_heading = None
        if north and not math.isnan(yaw):
            radians = math.radians(yaw), math.radians(values["known_heading.sigma_deg"])
            known_heading = ExternalHeading(*radians, north == TRUE_NORTH)
        turns_itself = ("enabled", "speed_rad_s", "stamped", "frame_id")
        rotation = (values[f"rotate.{name}"] for name in turns_itself)
        limits = values["window.timeout_s"], values["window.silence_s"]
        copied = {each.name: values[each.name] for each in fields(cls) if each.name in values}
        return cls(
            **copied | {"self_calibration": Mode(values["self_calibration"])},
            knowledge=Knowledge(given.field, mounting),
            limits=Limits(*limits, target_sigma=math.radians(sigma)),
            max_gap=values["window.max_gap_s"],
            patience=values["fused.patience_s"],
            given=given,
            rotation=Rotation(*rotation),
            mounts=mounts,
            vehicle_yaw=None if math.isnan(by_hand) else math.radians(by_hand),
            known_heading=known_heading,
            north_is_missing=not (math.isnan(yaw) or north),
            heading_is_true=values["known_heading.topic_north"] == TRUE_NORTH,
        )


OF_ROS = "use_sim_time", "start_type_description_service", "qos_overrides"
"""Parameters of every node, or the first part of their names."""


def given_names(name: str, arguments: Mapping[str, Any]) -> list[str]:
    """Return the names of the parameters that files and the command line give to a node.

    rclpy shows them only where it declares them all, so a short-lived node of the same name does.
    `arguments` are the other arguments of the node.
    """
    quiet = {"enable_rosout": False, "start_parameter_services": False}
    try:
        node = Node(
            name, automatically_declare_parameters_from_overrides=True, **{**arguments, **quiet}
        )
    except ValueError:
        # An empty list has no type and cannot be declared like this.
        return []
    names = [each for each in node.get_parameters_by_prefix("") if each.split(".")[0] not in OF_ROS]
    node.destroy_node()
    return names


class Parameters:
    """The node's parameters, declared, checked and kept as `settings`.

    A value from the command line or a file that is not allowed is logged and replaced by the
    default, so that the node continues. Unknown names among the `given` ones are logged.
    """

    def __init__(self, node: Node, given: Iterable[str] = ()) -> None:
        self._node = node
        self._specs = {spec.name: spec for spec in PARAMETERS}
        self.complaints: list[str] = []
        for name in given:
            if name not in self._specs:
                self._report_unknown(name)
        self._values = {spec.name: self._declare(spec) for spec in PARAMETERS}
        self._given = dict(self._values)
        self.settings = Settings.of(self._values)
        node.add_on_set_parameters_callback(self._check)
        # Humble has no callback after all callbacks have accepted a change.
        when_agreed = getattr(node, "add_post_set_parameters_callback", None)
        self._effects_come_later = when_agreed is not None
        if when_agreed is not None:
            when_agreed(self._put_in_effect)

    def _report_unknown(self, name: str) -> None:
        """Report a given name that no parameter has; it may be meant for other nodes, too."""
        words = f"there is no parameter {name!r}, so its value is not used"
        similar = get_close_matches(name, self._specs, 1)
        if similar:
            self.complaints.append(f"{words}: did you mean {similar[0]}?")
            self._node.get_logger().error(self.complaints[-1])
        else:
            self._node.get_logger().warning(words)

    def _declare(self, spec: ParameterSpec) -> Any:
        default = list(spec.default) if isinstance(spec.default, tuple) else spec.default
        # With dynamic typing, integers such as `-p reference.strength_ut:=48` and `[0, 0, 0]` are
        # accepted for floats. The range is added after the check, because with a range a bad value
        # in a file would end the node.
        bare = ParameterDescriptor(
            description=spec.description,
            additional_constraints=spec.constraints,
            dynamic_typing=True,
        )
        given: Any = self._node.declare_parameter(spec.name, default, bare).value
        try:
            value = spec.parse(given)
        except ValueError as error:
            self.complaints.append(str(error))
            self._node.get_logger().error(f"{error}; using the default {spec.yaml_default}")
            self._node.set_parameters([Parameter(spec.name, value=default)])
            value = spec.default
        self._node.set_descriptor(spec.name, _with_range(bare, spec))
        return value

    def _check(self, changes: list[Parameter]) -> SetParametersResult:
        """Return whether changes are allowed; another callback may still refuse them."""
        try:
            changed = self._parsed(changes)
            Settings.of(self._values | changed)
            for name, value in changed.items():
                self._require_changeable(self._specs[name], value)
        except (ValueError, FileError) as error:
            return SetParametersResult(successful=False, reason=str(error))
        if not self._effects_come_later:
            # On Humble the values are read again, after this call has stored them.
            executor = self._node.executor
            if executor is None:
                self._put_in_effect(changes)
            else:
                executor.create_task(self._read_again)
        return SetParametersResult(successful=True)

    def _require_changeable(self, spec: ParameterSpec, value: Value) -> None:
        """Raise ValueError for a change that is not allowed while the node runs."""
        # The comparison is with rclpy's value, because on Humble changes take effect later.
        if value == spec.parse(self._node.get_parameter(spec.name).value):
            return
        if spec.later is RuntimeChange.NOTHING:
            raise ValueError(
                f"{spec.name} is read when the node starts: restart the node with the new value"
            )
        if spec.later is RuntimeChange.SWITCH_OFF and value and not self._given[MAY_BE_ENABLED]:
            raise ValueError(
                f"{spec.name} can be switched on when the node starts; later only if the node was "
                f"started with {MAY_BE_ENABLED}:=true"
            )
        if spec.later in (RuntimeChange.FILE, RuntimeChange.FOLDER) and value not in spec.words:
            self._require_place(spec, str(value))

    def _require_place(self, spec: ParameterSpec, value: str) -> None:
        given = self._given[spec.name]
        places = [own_folder()]
        if given not in spec.words:
            places.append(chosen_path(given))
        # A path below a given file is not possible, so only a given folder is added.
        within = places if spec.later is RuntimeChange.FOLDER else places[:1]
        if value != given and not lies_within(chosen_path(value), within):
            named = " or ".join(str(place) for place in places)
            raise ValueError(
                f"{spec.name} must lie within {named} while the node runs: to use another path, "
                "restart the node with it"
            )

    def _put_in_effect(self, changes: list[Parameter]) -> None:
        """Use changes that all callbacks have accepted."""
        self._values |= self._parsed(changes)
        self.settings = Settings.of(self._values)

    def _read_again(self) -> None:
        self._put_in_effect(self._node.get_parameters(list(self._specs)))

    def _parsed(self, changes: list[Parameter]) -> dict[str, Any]:
        """Return the new values of the table's parameters."""
        ours = [change for change in changes if change.name in self._specs]
        return {change.name: self._specs[change.name].parse(change.value) for change in ours}


def _with_range(descriptor: ParameterDescriptor, spec: ParameterSpec) -> ParameterDescriptor:
    """Add the range, unless NaN is allowed, which rclpy would refuse with a range."""
    if isinstance(spec.default, (bool, str, tuple)) or spec.may_be_unset:
        return descriptor
    low, high, _ = spec.span
    if isinstance(spec.default, int):
        whole = IntegerRange(from_value=int(low), to_value=int(high), step=1)
        descriptor.integer_range = [whole]
    else:
        real = FloatingPointRange(from_value=float(low), to_value=float(high), step=0.0)
        descriptor.floating_point_range = [real]
    return descriptor
