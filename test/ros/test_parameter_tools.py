"""What `ros2 param` and `--params-file` do to the parameters and back.

ros2cli is not on this machine: how `ros2 param load`, `set` and `dump` take a value to a message
and back follows its published source (ros2param/api, the same from Humble to Rolling).
"""

import math
from pathlib import Path

import pytest
import rclpy
import yaml
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue, SetParametersResult
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters
from rclpy.parameter import Parameter
from support import PATIENCE, wait_until

from magcal_ros.ros.parameter_table import PARAMETERS

SHIPPED = Path(__file__).parents[2] / "config" / "calibrator.yaml"

ARRAYS = (
    (bool, ParameterType.PARAMETER_BOOL_ARRAY, "bool_array_value"),
    (int, ParameterType.PARAMETER_INTEGER_ARRAY, "integer_array_value"),
    (float, ParameterType.PARAMETER_DOUBLE_ARRAY, "double_array_value"),
)
SCALARS = (
    (bool, ParameterType.PARAMETER_BOOL, "bool_value"),
    (int, ParameterType.PARAMETER_INTEGER, "integer_value"),
    (float, ParameterType.PARAMETER_DOUBLE, "double_value"),
)


def as_sent(value):
    """Take a value of a YAML file to a message, through Python's notation and YAML again."""
    text = str(value)
    guessed = yaml.safe_load(text)
    if isinstance(guessed, list):
        for kind, number, member in ARRAYS:
            if all(isinstance(item, kind) for item in guessed):
                return ParameterValue(type=number, **{member: guessed})
    else:
        for kind, number, member in SCALARS:
            if isinstance(guessed, kind):
                return ParameterValue(type=number, **{member: guessed})
    return ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=text)


def flat(tree, prefix=""):
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


class Tools:
    """The user's node."""

    def __init__(self, node, name="/calibrator"):
        self.node, self.name = node, name

    def call(self, kind, service, **request):
        client = self.node.create_client(kind, f"{self.name}/{service}")
        assert client.wait_for_service(timeout_sec=PATIENCE)
        future = client.call_async(kind.Request(**request))
        rclpy.spin_until_future_complete(self.node, future, timeout_sec=PATIENCE)
        return future.result()

    def load(self, document):
        (content,) = document.values()
        parameters = [
            ParameterMessage(name=name, value=as_sent(value))
            for name, value in flat(content["ros__parameters"])
        ]
        results = self.call(SetParameters, "set_parameters", parameters=parameters).results
        return [result.reason for result in results if not result.successful]

    def dump(self):
        names = [spec.name for spec in PARAMETERS]
        values = self.call(GetParameters, "get_parameters", names=names).values
        found = {}
        for name, value in zip(names, values, strict=True):
            members = [*SCALARS, *ARRAYS, (str, ParameterType.PARAMETER_STRING, "string_value")]
            member = next(member for _, number, member in members if number == value.type)
            held = getattr(value, member)
            found[name] = list(held) if member.endswith("array_value") else held
        return yaml.dump({self.name: {"ros__parameters": found}}, default_flow_style=False)


@pytest.fixture
def tools(graph):
    node = rclpy.create_node("tools")
    yield Tools(node)
    node.destroy_node()


def test_param_load_takes_the_shipped_file(start_node, tools):
    node = start_node({})
    assert tools.load(yaml.safe_load(SHIPPED.read_text())) == []
    assert node._table.settings.knowledge.reference.strength.is_unknown


def test_a_dump_is_loaded_again_by_both_ways(start_node, tools, tmp_path):
    node = start_node({"reference.strength_ut": 48.5, "window.max_gap_s": 0.00104})
    dumped = tools.dump()
    assert tools.load(yaml.safe_load(dumped)) == []
    again = tools.dump()
    path = tmp_path / "dump.yaml"
    path.write_text(again.replace("/calibrator:", "/**:"))
    other = start_node({}, arguments=["--ros-args", "-r", "__node:=b", "--params-file", str(path)])
    assert not other._table.complaints
    for settings in (node._table.settings, other._table.settings):
        assert settings.knowledge.reference.strength.value == pytest.approx(48.5e-6)
        assert settings.knowledge.reference.inclination.is_unknown
        assert settings.max_gap == 0.00104


def test_the_shipped_file_is_a_parameter_file(start_node):
    node = start_node({}, arguments=["--ros-args", "--params-file", str(SHIPPED)])
    assert not node._table.complaints


def test_a_misspelt_parameter_is_named(start_node):
    given = ["-p", "acumulate:=true", "-p", "robot_name:=a", "-p", "qos_overrides./tf.depth:=1"]
    node = start_node({}, arguments=["--ros-args", *given, "-p", "accumulate:=true"])
    (found,) = node._table.complaints
    assert "'acumulate'" in found
    assert "did you mean accumulate?" in found


def test_an_empty_list_does_not_end_the_node(start_node):
    node = start_node({}, arguments=["--ros-args", "-p", "mount_2_rpy_deg:=[]"])
    (found,) = node._table.complaints
    assert "mount_2_rpy_deg must be 3 numbers" in found


def test_small_numbers_and_lists_of_integers_are_accepted(start_node, tools):
    node = start_node({})
    document = {"x": {"ros__parameters": {"confidence.target_sigma_deg": 0.01}}}
    document["x"]["ros__parameters"] |= {"mount_rpy_deg": [0, 0, 180], "reports_kept": 7}
    document["x"]["ros__parameters"] |= {"reference.altitude_m": 1e-05}
    assert tools.load(document) == []
    assert node._table.settings.reports_kept == 7
    assert node._table.settings.limits.target_sigma == pytest.approx(math.radians(0.01))


def test_ranges_are_declared_unless_nan_is_allowed(start_node, tools):
    start_node({})
    names = [spec.name for spec in PARAMETERS]
    found = tools.call(DescribeParameters, "describe_parameters", names=names).descriptors
    for spec, descriptor in zip(PARAMETERS, found, strict=True):
        ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
        is_number = type(spec.default) in (int, float) and not spec.may_be_unset
        assert len(ranges) == int(is_number), spec.name
        if ranges:
            assert (ranges[0].from_value, ranges[0].to_value) == (spec.span.low, spec.span.high)
        assert descriptor.description == spec.description


def test_a_change_takes_effect_only_if_all_callbacks_accept_it(start_node):
    node = start_node({})
    before = node._table.settings
    refusal = SetParametersResult(successful=False, reason="not today")
    refuse = lambda _: refusal  # noqa: E731
    # Two, because rclpy asks the newest first and somebody may come before us too.
    node._on_set_parameters_callbacks.append(refuse)
    result = node.set_parameters([Parameter("reports_kept", value=7)])[0]
    assert not result.successful
    assert node._table.settings is before
    node.remove_on_set_parameters_callback(refuse)
    assert node.set_parameters([Parameter("reports_kept", value=7)])[0].successful
    assert node._table.settings.reports_kept == 7


def test_without_that_callback_a_change_takes_effect_slightly_later(start_node, tools, monkeypatch):
    from rclpy.node import Node

    monkeypatch.delattr(Node, "add_post_set_parameters_callback")
    node = start_node({})
    assert tools.load({"x": {"ros__parameters": {"reports_kept": 9}}}) == []
    wait_until(lambda: node._table.settings.reports_kept == 9)
    refusal = SetParametersResult(successful=False, reason="not today")
    node._on_set_parameters_callbacks.append(lambda _: refusal)
    assert tools.load({"x": {"ros__parameters": {"reports_kept": 11}}}) == ["not today"]
    for _ in range(10):
        rclpy.spin_once(tools.node, timeout_sec=0.05)
    assert node._table.settings.reports_kept == 9
