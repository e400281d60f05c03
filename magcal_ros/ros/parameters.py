"""The node's parameters: declared, checked, and changed while it runs."""

from __future__ import annotations

from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
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
            additional_constraints=spec.constraints,
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
