"""The table of parameters, from which descriptors, checks and the table of doc/node.md are made."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, NamedTuple, NoReturn, TypeAlias

import yaml

from magcal_ros.core.calibrate import METHOD_WORDS, METHODS
from magcal_ros.core.earth_field.wmm import VALIDITY
from magcal_ros.core.heading.disturbance import PATIENCE
from magcal_ros.core.knowledge import (
    DECLINATION_SIGMA_DEG,
    INCLINATION_SIGMA_DEG,
    STRENGTH_SIGMA_UT,
)
from magcal_ros.core.samples.samples_tuning import STREAMS
from magcal_ros.core.self_calibration.jobs import Mode
from magcal_ros.files.disk import printable

Value: TypeAlias = "bool | int | float | str | tuple[float, ...]"
LONGEST_TEXT = 4096
"""Characters of a text parameter, as many as a path may have."""
MOST_SHOWN = 20  # items of a refused list that are shown
TRUE_NORTH, MAGNETIC_NORTH = "true_north", "magnetic_north"
"""Choices of a north; `true` alone would be a boolean in YAML."""
OFF = Mode.OFF.value
"""A choice that ROS reads as the boolean false unless it is quoted."""
UNSET = math.nan  # an unknown number, written as .nan in YAML or left out


class RuntimeChange(Enum):
    """Which changes of a parameter are allowed while the node runs, for anyone on its network."""

    ANYTHING = "anything"
    NOTHING = "nothing"
    FILE = "a file below the package's folder, or the one given at start"
    FOLDER = "a folder below the package's folder or below the one given at start"
    SWITCH_OFF = "switched off, and switched on only if that was allowed at start"


class NumberRange(NamedTuple):
    """The allowed range of a number, and its unit."""

    low: float = -math.inf
    high: float = math.inf
    unit: str = ""


ANY = NumberRange()


@dataclass(frozen=True)
class ParameterSpec:
    """One row of the table."""

    name: str
    default: Value  # also determines the type
    span: NumberRange = ANY
    choices: tuple[str, ...] = ()  # allowed texts; empty for any
    later: RuntimeChange = RuntimeChange.ANYTHING
    words: tuple[str, ...] = ("",)
    """Texts with another meaning, for a parameter that is otherwise a path."""
    description: str = ""

    def means(self, description: str) -> ParameterSpec:
        """Return the row with its description."""
        return replace(self, description=description)

    @property
    def may_be_unset(self) -> bool:
        """Whether .nan is allowed and means "not known"."""
        default = self.default[0] if isinstance(self.default, tuple) else self.default
        return isinstance(default, float) and math.isnan(default)

    def parse(self, value: Any) -> Value:
        """Return a value in the right type; raises ValueError with the allowed values."""
        default = self.default
        if isinstance(default, bool):
            return value if isinstance(value, bool) else self._refuse("true or false", value)
        if isinstance(default, str):
            return self._parse_text(value)
        if isinstance(default, tuple):
            return self._parse_list(value, len(default))
        number = _number(value)
        if isinstance(default, int) and (number is None or not number.is_integer()):
            self._refuse("a whole number", value)
        return type(default)(self._parse_number(value))

    def _parse_text(self, value: Any) -> str:
        if value is False and OFF in self.choices:
            return OFF
        if not isinstance(value, str):
            self._refuse("a text", value)
        if self.choices and value not in self.choices:
            self._refuse(self.constraints, value)
        if len(value) > LONGEST_TEXT:
            raise ValueError(f"{self.name} must be no longer than {LONGEST_TEXT} characters")
        return str(value)

    def _parse_list(self, value: Any, count: int) -> tuple[float, ...]:
        items = _items(value) or ()
        if len(items) != count:
            self._refuse(f"{count} numbers, as in {self.yaml_default}", value)
        numbers = tuple(self._parse_number(item) for item in items)
        if len({math.isnan(number) for number in numbers}) > 1:
            self._refuse("either all numbers or all .nan", value)
        return numbers

    def _parse_number(self, value: Any) -> float:
        number = _number(value)
        if number is None:
            self._refuse("a number", value)
        if math.isnan(number) and self.may_be_unset:
            return UNSET
        low, high, unit = self.span
        if not low <= number <= high:
            within = f"between {low:g} and {high:g} {unit}".rstrip()
            raise ValueError(f"{self.name} must lie {within}, not {number:g}")
        return number

    def _refuse(self, wanted: str, value: Any) -> NoReturn:
        raise ValueError(f"{self.name} must be {wanted}, not {_shown(value)}")

    @property
    def constraints(self) -> str:
        """The allowed values in words; empty for any."""
        if self.choices:
            return "one of " + ", ".join(choice or '""' for choice in self.choices)
        low, high, unit = self.span
        if math.isinf(low):
            return ""
        unset = " or .nan" if self.may_be_unset else ""
        return f"{low:g} to {high:g} {unit}".rstrip() + unset

    @property
    def yaml_default(self) -> str:
        """The default as it is written in YAML."""
        default = list(self.default) if isinstance(self.default, tuple) else self.default
        written, _, _ = yaml.safe_dump(default, default_flow_style=True).partition("\n")
        return str(written).replace("''", '""')


def _number(value: Any) -> float | None:
    """Return a number, also from a text; None for anything else.

    `ros2 param load` and `set` send NaN and 1e-5 as texts, because YAML 1.1 does not read Python's
    notation of them as numbers.
    """
    if isinstance(value, str):
        text = value.strip().lower()
        try:
            return math.nan if text == ".nan" else float(text)
        except ValueError:
            return None
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def _items(value: Any) -> list[Any] | None:
    """Return the items of a list, also from the text of `ros2 param`; None for anything else."""
    if isinstance(value, str):
        text = value.strip()
        return text[1:-1].split(",") if text[:1] == "[" and text[-1:] == "]" else None
    if hasattr(value, "tolist"):
        return list(value.tolist())
    return list(value) if isinstance(value, Sequence) else None


def _shown(value: Any) -> str:
    """Return a value as a user would type it; a long one is shortened."""
    items = None if isinstance(value, str) else _items(value)
    if items is not None:
        more = ", …]" if len(items) > MOST_SHOWN else "]"
        return "[" + ", ".join(map(_shown, items[:MOST_SHOWN])) + more
    if value is None:
        return "nothing"
    return printable(str(value).lower() if isinstance(value, bool) else repr(value))


MAY_BE_ENABLED = "rotate.may_be_enabled"
PARAMETERS: tuple[ParameterSpec, ...] = (
    ParameterSpec("calibration_file", "", later=RuntimeChange.FILE).means(
        "Where the calibration is stored and loaded from. Empty: "
        "$ROS_HOME/magcal/<namespace>/<node>.<frame of the magnetometer>.yaml. While the node "
        "runs, only a path below $ROS_HOME/magcal or the one given at start can be set"
    ),
    ParameterSpec("report_folder", "", later=RuntimeChange.FOLDER, words=("", "none")).means(
        "Where a dated folder with report.html and samples.csv is made for each turn. Empty: "
        "$ROS_HOME/magcal/reports; none: no reports. While the node runs, only a path below "
        "$ROS_HOME/magcal or below the one given at start can be set"
    ),
    ParameterSpec("reports_kept", 50, NumberRange(1, 100_000)).means(
        "How many reports are kept, in addition to those of turns that were put in force; older "
        "ones are removed"
    ),
    ParameterSpec(
        "memory_limit_mb", 1024, NumberRange(256, 1_000_000, "MB"), later=RuntimeChange.NOTHING
    ).means(
        "How much memory the node may use in addition to that at its start, so that a malformed "
        "request for millions of values fails. Read when the node starts; fits are not limited"
    ),
    ParameterSpec("method", METHODS[0], choices=METHODS).means(METHOD_WORDS),
    ParameterSpec("accumulate", False).means(
        "Join the next turns, made on different tilts, into one estimate of the full correction, "
        "installation yaw included; false: each turn is used alone"
    ),
    ParameterSpec("self_calibration", "propose", choices=tuple(mode.value for mode in Mode)).means(
        "What is done with a better calibration from ordinary driving: propose it (call ~/accept), "
        "apply it (and go back if it proves worse), or off. With off there is no search, and only "
        "the calibration in force is watched"
    ),
    ParameterSpec("reference.strength_ut", UNSET, NumberRange(15.0, 100.0, "µT")).means(
        "Strength of the Earth's field here; .nan to take it from the World Magnetic Model"
    ),
    ParameterSpec(
        "reference.strength_sigma_ut", STRENGTH_SIGMA_UT, NumberRange(0.0, 100.0, "µT")
    ).means("Local deviation of the strength, by crust and iron nearby (1 σ); indoors about 7"),
    ParameterSpec("reference.inclination_deg", UNSET, NumberRange(-90.0, 90.0, "°")).means(
        "Inclination (dip) of the Earth's field here, positive down; .nan for the model's"
    ),
    ParameterSpec(
        "reference.inclination_sigma_deg", INCLINATION_SIGMA_DEG, NumberRange(0.0, 90.0, "°")
    ).means("Local deviation of the inclination, by crust and iron nearby (1 σ); indoors about 5"),
    ParameterSpec("reference.declination_deg", UNSET, NumberRange(-180.0, 180.0, "°")).means(
        "Declination here, positive east; .nan for the model's"
    ),
    ParameterSpec(
        "reference.declination_sigma_deg", DECLINATION_SIGMA_DEG, NumberRange(0.0, 90.0, "°")
    ).means("Local deviation of the declination, by crust and iron nearby (1 σ); indoors about 5"),
    ParameterSpec("reference.latitude_deg", UNSET, NumberRange(-90.0, 90.0, "°")).means(
        "Where the robot is, for the model, positive north; .nan to take it from gps/fix"
    ),
    ParameterSpec("reference.longitude_deg", UNSET, NumberRange(-180.0, 180.0, "°")).means(
        "The same, positive east"
    ),
    ParameterSpec("reference.altitude_m", 0.0, NumberRange(*VALIDITY.altitudes, "m")).means(
        "The same, above the sea or the ellipsoid; a kilometre changes the strength by 0.05%"
    ),
    ParameterSpec("soft_iron_gains", (1.0, 1.0, 1.0), NumberRange(0.1, 10.0)).means(
        "Known gains of the sensor's axes"
    ),
    ParameterSpec("base_frame", "").means(
        "Frame for which the attitudes are published, given by the fixed joints of "
        "robot_description or the static transforms. Empty: the IMU's frame"
    ),
    ParameterSpec("vehicle_yaw_deg", UNSET, NumberRange(-360.0, 360.0, "°")).means(
        "Yaw of the IMU in the vehicle, to the left of the vehicle's front. It is used for "
        "base_frame and for calibration by a circle or a drive; .nan for the yaw in the robot's "
        "description, corrected by up to 15° by an estimate while driving"
    ),
    ParameterSpec("mount_rpy_deg", (UNSET, UNSET, UNSET), NumberRange(-360.0, 360.0, "°")).means(
        "Nominal roll, pitch, yaw of the magnetometer in the IMU's frame, as in a URDF; .nan for "
        "the values in the robot's description if base_frame is set, else zero"
    ),
    ParameterSpec("mount_2_rpy_deg", (UNSET, UNSET, UNSET), NumberRange(-360.0, 360.0, "°")).means(
        "The same for the magnetometer on imu/mag_2"
    ),
    ParameterSpec("magnetometers", 2, NumberRange(1, 8), later=RuntimeChange.NOTHING).means(
        "How many magnetometers are subscribed to: imu/mag, imu/mag_2, imu/mag_3 and so on. A "
        "topic without messages is ignored. Read when the node starts"
    ),
    ParameterSpec("confidence.target_sigma_deg", 0.5, NumberRange(0.01, 10.0, "°")).means(
        "Predicted heading error (1 σ, on level ground) at which a complete turn is enough; after "
        "1.2 turns, up to twice as much is accepted"
    ),
    ParameterSpec("known_heading.yaw_deg", UNSET, NumberRange(-360.0, 360.0, "°")).means(
        "Heading of the robot when ~/calibrate_at_heading is called: ENU yaw, 0 to the east, 90 to "
        "the north, positive to the left; .nan for the heading on the topic heading"
    ),
    ParameterSpec("known_heading.north", "", choices=("", TRUE_NORTH, MAGNETIC_NORTH)).means(
        "Which north known_heading.yaw_deg refers to; there is no default"
    ),
    ParameterSpec("known_heading.sigma_deg", 2.0, NumberRange(0.05, 30.0, "°")).means(
        "Standard deviation of known_heading.yaw_deg"
    ),
    ParameterSpec(
        "known_heading.topic_north", TRUE_NORTH, choices=(TRUE_NORTH, MAGNETIC_NORTH)
    ).means("Which north the topic heading refers to; for two antennas it is true north"),
    ParameterSpec("window.timeout_s", 90.0, NumberRange(2.0, 3600.0, "s")).means(
        "A turn ends after this time at the latest, and is used or refused"
    ),
    ParameterSpec("window.silence_s", 10.0, NumberRange(0.5, 600.0, "s")).means(
        "A turn ends when a sensor has been silent for this long"
    ),
    ParameterSpec("window.max_gap_s", STREAMS.max_gap, NumberRange(0.001, 5.0, "s")).means(
        "Largest gap between IMU samples over which they are interpolated"
    ),
    ParameterSpec("fused.patience_s", PATIENCE, NumberRange(1.0, 3600.0, "s")).means(
        "A field that differs from the calibrated one for this long is accepted as the new field"
    ),
    ParameterSpec("rotate.enabled", False, later=RuntimeChange.SWITCH_OFF).means(
        "Whether the robot turns itself, by velocities on cmd_vel, when a turn is requested. While "
        "the node runs, it can be switched off, but switched on only with rotate.may_be_enabled"
    ),
    ParameterSpec(MAY_BE_ENABLED, False, later=RuntimeChange.NOTHING).means(
        "Whether rotate.enabled may be switched on while the node runs, by anyone on its network. "
        "Read when the node starts"
    ),
    ParameterSpec("rotate.speed_rad_s", 0.4, NumberRange(0.1, 1.0, "rad/s")).means(
        "How fast the robot turns itself"
    ),
    ParameterSpec("rotate.stamped", False).means(
        "Whether cmd_vel is a TwistStamped instead of a Twist"
    ),
    ParameterSpec("rotate.frame_id", "base_link").means("Frame of the TwistStamped"),
)
