"""The node's parameters: declared, checked, and changed while it runs."""

from __future__ import annotations

from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from magcal_ros.ros.parameter_table import PARAMETERS
from magcal_ros.ros.settings import Settings
from magcal_ros.ros.spec import Spec


class Parameters:
    """The node's parameters, declared, checked and kept as `settings`.

    Parameters
    ----------
    node : rclpy.node.Node
        Where they are declared. A value from the command line or a file that is not allowed is
        said in the log and replaced by the default: the node stays alive.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._specs = {spec.name: spec for spec in PARAMETERS}
        self._values: dict[str, Any] = {}
        self.complaints: list[str] = []
        for spec in PARAMETERS:
            self._values[spec.name] = self._declare(spec)
        self.settings = Settings.of(self._values)
        node.add_on_set_parameters_callback(self._check)
        # Humble has nothing that tells when everybody agreed.
        when_agreed = getattr(node, "add_post_set_parameters_callback", None)
        self._effects_come_later = when_agreed is not None
        if when_agreed is not None:
            when_agreed(self._put_in_effect)

    def _declare(self, spec: Spec) -> Any:
        default = list(spec.default) if isinstance(spec.default, tuple) else spec.default
        # A range would end the node on a bad value from a file: it is added after the check.
        bare = _descriptor(spec)
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
        """Say whether changes are allowed; whoever is asked after this may still refuse them."""
        try:
            Settings.of(self._changed(changes))
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        if not self._effects_come_later:
            self._put_in_effect_afterwards(changes)
        return SetParametersResult(successful=True)

    def _put_in_effect(self, changes: list[Parameter]) -> None:
        """Use what everybody agreed to."""
        self._values = self._changed(changes)
        self.settings = Settings.of(self._values)

    def _put_in_effect_afterwards(self, changes: list[Parameter]) -> None:
        """Look, when the call is over, what became of it (Humble has nothing that tells)."""

        def look() -> None:
            names = [change.name for change in changes if self._node.has_parameter(change.name)]
            self._put_in_effect(self._node.get_parameters(names))

        executor = self._node.executor
        if executor is None:
            self._put_in_effect(changes)
        else:
            executor.create_task(look)

    def _changed(self, changes: list[Parameter]) -> dict[str, Any]:
        """Return all values with these changes.

        Raises
        ------
        ValueError
            If one is not allowed.
        """
        ours = [change for change in changes if change.name in self._specs]
        parsed = {change.name: self._specs[change.name].parse(change.value) for change in ours}
        return {**self._values, **parsed}


def _descriptor(spec: Spec) -> ParameterDescriptor:
    # Dynamic typing lets `-p reference.strength_ut:=48` and `[0, 0, 0]` pass as numbers.
    return ParameterDescriptor(
        description=spec.description,
        additional_constraints=spec.constraints,
        dynamic_typing=True,
    )


def _with_range(descriptor: ParameterDescriptor, spec: Spec) -> ParameterDescriptor:
    """Add the range that tools make a slider of; where NaN is allowed rclpy would refuse it."""
    if isinstance(spec.default, (bool, str, tuple)) or spec.may_be_unset:
        return descriptor
    if isinstance(spec.default, int):
        whole = IntegerRange(from_value=int(spec.low), to_value=int(spec.high), step=1)
        descriptor.integer_range = [whole]
    else:
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(spec.low), to_value=float(spec.high), step=0.0)
        ]
    return descriptor
