"""No internal name of rclpy is used, because it may change with any release."""

import ast
import inspect
from pathlib import Path

import pytest

import magcal_ros.ros
from magcal_ros.ros.node import Calibrator
from magcal_ros.ros.threads import SensorGroup

DOCUMENTED = {"_replace", "_asdict", "_fields", "_exit"}
"""Public in spite of their names: those of named tuples, and of `os`."""

FILES = sorted(Path(magcal_ros.ros.__file__).parent.rglob("*.py"))


def is_private(name):
    return name.startswith("_") and not name.endswith("__") and name not in DOCUMENTED


def private_reads(tree):
    """Yield the private names that are read of anything but `self`, by dot or by `getattr`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and is_private(node.attr):
            if not (isinstance(node.value, ast.Name) and node.value.id == "self"):
                yield node.attr
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            names = [each.value for each in node.args[1:2] if isinstance(each, ast.Constant)]
            if node.func.id in ("getattr", "setattr", "hasattr"):
                yield from (name for name in names if is_private(str(name)))


def private_names_on_self(source):
    """Return the private names that a class uses of itself."""
    return {
        node.attr
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Attribute) and is_private(node.attr)
    }


def names_of_rclpy(kind):
    """Return the private names that rclpy's bases of a class use of themselves."""
    bases = [base for base in kind.__mro__ if base.__module__.startswith("rclpy.")]
    assert bases
    return set().union(*(private_names_on_self(inspect.getsource(base)) for base in bases))


def test_no_private_name_of_another_object_is_used():
    found = {path.name: list(private_reads(ast.parse(path.read_text()))) for path in FILES}
    assert {name: reads for name, reads in found.items() if reads} == {}


@pytest.mark.parametrize("kind", [Calibrator, SensorGroup])
def test_no_private_name_of_the_package_is_one_of_rclpy(kind):
    """Neither used by way of `self` nor overwritten."""
    assert not private_names_on_self(inspect.getsource(kind)) & names_of_rclpy(kind)


INHERITED = {"Node", "CallbackGroup", "MutuallyExclusiveCallbackGroup", "Executor"}


def test_these_are_all_the_classes_that_inherit_from_rclpy():
    found = set()
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text())):
            bases = node.bases if isinstance(node, ast.ClassDef) else []
            if {ast.unparse(base) for base in bases} & INHERITED:
                found.add(node.name)
    assert found == {Calibrator.__name__, SensorGroup.__name__}


def test_only_the_internals_used_by_wait_for_message_are_imported():
    from rclpy import wait_for_message

    allowed = ast.unparse(ast.parse(inspect.getsource(wait_for_message)))
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text())):
            modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                modules = [node.module or ""]
            for module in modules:
                if module.startswith("rclpy.impl") or "._" in module:
                    assert module in allowed, path
