"""The one table of parameters: descriptors, checks and the README's table come from it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from magcal_ros.core.calibrate import METHODS
from magcal_ros.core.knowledge import (
    INCLINATION_SIGMA_DEG,
    STRENGTH_SIGMA_UT,
    Knowledge,
    knowledge_of,
)
from magcal_ros.core.session import Limits
from magcal_ros.core.streams import MAX_GAP

UNSET = math.nan
"""Stands for a number that is not known; in YAML it is written .nan or left out."""


@dataclass(frozen=True)
class Spec:
    """One row of the table.

    Parameters
    ----------
    name : str
        Parameter name.
    default : float, str or tuple of float
        Default, which also fixes the type.
    low, high : float
        Allowed range, for numbers.
    unit : str
        Unit, empty for none.
    description : str
        What it does.
    choices : tuple of str
        Allowed texts; empty for any.
    """

    name: str
    default: float | str | tuple[float, ...]
    description: str
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    choices: tuple[str, ...] = ()

    @property
    def may_be_unset(self) -> bool:
        """Whether .nan is allowed and means "not known"."""
        return isinstance(self.default, float) and math.isnan(self.default)

    def parse(self, value: Any) -> float | str | tuple[float, ...]:
        """Return a value in the right type.

        Raises
        ------
        ValueError
            If it has the wrong type or lies outside the range; the text says what is right.
        """
        if isinstance(self.default, str):
            return self._parse_text(value)
        if isinstance(self.default, tuple):
            return self._parse_list(value)
        return self._parse_number(value)

    def _parse_text(self, value: Any) -> str:
        if not isinstance(value, str):
            raise ValueError(f"{self.name} must be a text, not {value!r}")
        if self.choices and value not in self.choices:
            raise ValueError(f"{self.name} must be one of {', '.join(self.choices)}, not {value!r}")
        return value

    def _parse_list(self, value: Any) -> tuple[float, ...]:
        assert isinstance(self.default, tuple)
        is_list = isinstance(value, Sequence) or hasattr(value, "tolist")
        if isinstance(value, str) or not is_list or len(value) != len(self.default):
            raise ValueError(f"{self.name} must be {len(self.default)} numbers, not {value!r}")
        return tuple(self._parse_number(item) for item in value)

    def _parse_number(self, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise ValueError(f"{self.name} must be a number, not {value!r}")
        number = float(value)
        if math.isnan(number) and self.may_be_unset:
            return UNSET
        if not self.low <= number <= self.high:
            raise ValueError(
                f"{self.name} must lie between {self.low:g} and {self.high:g}"
                f"{' ' + self.unit if self.unit else ''}, not {number:g}"
            )
        return number


PARAMETERS: tuple[Spec, ...] = (
    Spec(
        "calibration_file",
        "",
        "Where the calibration is stored and loaded from. Empty: "
        "$ROS_HOME/magcal/<namespace>/<frame of the magnetometer>.yaml",
    ),
    Spec(
        "report_folder",
        "",
        "Where each turn leaves a dated folder with report.html and samples.csv. Empty: "
        "$ROS_HOME/magcal/reports; none: no reports",
    ),
    Spec("method", METHODS[0], "How a turn is turned into a calibration", choices=METHODS),
    Spec(
        "reference.strength_ut",
        UNSET,
        "Strength of the Earth's field here; .nan if not known",
        15.0,
        100.0,
        "µT",
    ),
    Spec(
        "reference.strength_sigma_ut",
        STRENGTH_SIGMA_UT,
        "How far the true strength may be from it (1 σ); indoors rather 7",
        0.0,
        100.0,
        "µT",
    ),
    Spec(
        "reference.inclination_deg",
        UNSET,
        "Inclination (dip) of the Earth's field here, positive down; .nan if not known",
        -90.0,
        90.0,
        "°",
    ),
    Spec(
        "reference.inclination_sigma_deg",
        INCLINATION_SIGMA_DEG,
        "How far the true inclination may be from it (1 σ); indoors rather 5",
        0.0,
        90.0,
        "°",
    ),
    Spec(
        "reference.declination_deg",
        UNSET,
        "Declination here, positive east; .nan if not known, then no true north is published",
        -180.0,
        180.0,
        "°",
    ),
    Spec(
        "soft_iron_gains",
        (1.0, 1.0, 1.0),
        "Known gains of the magnetometer's axes",
        0.1,
        10.0,
    ),
    Spec(
        "mount_rpy_deg",
        (0.0, 0.0, 0.0),
        "Nominal roll, pitch, yaw of the magnetometer in the IMU's frame, as in a URDF",
        -360.0,
        360.0,
        "°",
    ),
    Spec(
        "confidence.target_sigma_deg",
        0.5,
        "Predicted heading error (1 σ, on the level) at which a complete turn is enough",
        0.01,
        10.0,
        "°",
    ),
    Spec(
        "window.timeout_s",
        90.0,
        "A turn is used or refused after this time, whatever was seen",
        2.0,
        3600.0,
        "s",
    ),
    Spec(
        "window.silence_s",
        10.0,
        "A turn ends when a sensor was silent for so long",
        0.5,
        600.0,
        "s",
    ),
    Spec(
        "window.max_gap_s",
        MAX_GAP,
        "IMU samples further apart are not interpolated between",
        0.001,
        5.0,
        "s",
    ),
)


@dataclass(frozen=True)
class Settings:
    """The parameters' values in SI units and in the core's own types."""

    calibration_file: str
    report_folder: str
    method: str
    knowledge: Knowledge
    limits: Limits
    max_gap: float

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Settings:
        """Build from checked values by parameter name."""
        knowledge = knowledge_of(
            values["reference.strength_ut"],
            values["reference.strength_sigma_ut"],
            values["reference.inclination_deg"],
            values["reference.inclination_sigma_deg"],
            values["reference.declination_deg"],
            values["soft_iron_gains"],
            values["mount_rpy_deg"],
        )
        return cls(
            values["calibration_file"],
            values["report_folder"],
            values["method"],
            knowledge,
            Limits(
                values["window.timeout_s"],
                values["window.silence_s"],
                target_sigma=math.radians(values["confidence.target_sigma_deg"]),
            ),
            values["window.max_gap_s"],
        )


class Parameters:
    """The node's parameters, declared, checked and kept as `settings`.

    Parameters
    ----------
    node : rclpy.node.Node
        Where they are declared. A value from the command line or a file that is not allowed is
        said in the log and replaced by the default: the node stays alive.
    """

    def __init__(self, node: Node) -> None:
        self._specs = {spec.name: spec for spec in PARAMETERS}
        self._values: dict[str, Any] = {}
        self.complaints: list[str] = []
        for spec in PARAMETERS:
            self._values[spec.name] = self._declare(node, spec)
        self.settings = Settings.of(self._values)
        node.add_on_set_parameters_callback(self._on_set)

    def _declare(self, node: Node, spec: Spec) -> Any:
        # Dynamic typing lets `-p reference.strength_ut:=48` and `[0, 0, 0]` pass as numbers.
        descriptor = ParameterDescriptor(
            description=spec.description,
            additional_constraints=_constraints(spec),
            dynamic_typing=True,
        )
        default = list(spec.default) if isinstance(spec.default, tuple) else spec.default
        given: Any = node.declare_parameter(spec.name, default, descriptor).value
        try:
            return spec.parse(given)
        except ValueError as error:
            self.complaints.append(str(error))
            node.get_logger().error(f"{error}; using the default {spec.default}")
            node.set_parameters([Parameter(spec.name, value=default)])
            return spec.default

    def _on_set(self, changes: list[Parameter[Any]]) -> SetParametersResult:
        values = dict(self._values)
        try:
            for change in changes:
                spec = self._specs.get(change.name)
                if spec is not None:
                    values[change.name] = spec.parse(change.value)
            settings = Settings.of(values)
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        self._values, self.settings = values, settings
        return SetParametersResult(successful=True)


def _constraints(spec: Spec) -> str:
    if spec.choices:
        return "one of: " + ", ".join(spec.choices)
    if math.isinf(spec.low):
        return ""
    unset = " or .nan" if spec.may_be_unset else ""
    return f"{spec.low:g} to {spec.high:g} {spec.unit}".rstrip() + unset


def as_yaml() -> str:
    """Return the table as the parameter file that is shipped in `config/`."""
    lines = ["# Every parameter of the calibrator node with its default.", "/**:"]
    lines.append("  ros__parameters:")
    group = ""
    for spec in PARAMETERS:
        prefix, _, name = spec.name.rpartition(".")
        if prefix and prefix != group:
            lines.append(f"    {prefix}:")
        group = prefix
        indent = "      " if prefix else "    "
        lines.append(f"{indent}# {_full_description(spec)}")
        lines.append(f"{indent}{name or spec.name}: {_yaml_value(spec.default)}")
    return "\n".join(lines) + "\n"


def as_markdown() -> str:
    """Return the table as it stands in the README."""
    lines = ["| parameter | default | range | meaning |", "|---|---|---|---|"]
    for spec in PARAMETERS:
        default = _yaml_value(spec.default)
        row = (f"`{spec.name}`", f"`{default}`", _constraints(spec), spec.description)
        lines.append("| " + " | ".join(row) + " |")
    return "\n".join(lines) + "\n"


def _full_description(spec: Spec) -> str:
    limits = _constraints(spec)
    return f"{spec.description} ({limits})" if limits else spec.description


def _yaml_value(value: float | str | tuple[float, ...]) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(_yaml_value(item) for item in value) + "]"
    if isinstance(value, float):
        return ".nan" if math.isnan(value) else repr(value)
    return value or '""'
