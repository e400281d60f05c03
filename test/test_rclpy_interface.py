"""Whether every supported distribution has the names of rclpy that the package uses.

`rclpy_interface.yaml` says what each of them has. Where rclpy is installed, the table is held
against it as well.
"""

import contextlib
import importlib
import importlib.metadata
import inspect
import textwrap
from pathlib import Path

import pytest
import yaml
from rclpy_usage import uses

import magcal_ros

PACKAGE = Path(magcal_ros.__file__).resolve().parent
TABLE = yaml.safe_load(Path(__file__).with_name("rclpy_interface.yaml").read_text("utf-8"))
NAMES = TABLE["names"]
DISTRIBUTIONS = TABLE["distributions"]
GIVES = {name: facts["gives"] for name, facts in NAMES.items() if "gives" in facts}
FILES = sorted(path for path in PACKAGE.rglob("*.py") if "rclpy" in path.read_text("utf-8"))


def faults(text):
    """Name, by line, what a distribution lacks or the table does not have."""
    return [f"line {use.line}: {fault}" for use in uses(text, GIVES) for fault in faults_of(use)]


def faults_of(use):
    if use.name not in NAMES:
        if not is_package(use.name):
            yield f"{use.name} is not in rclpy_interface.yaml: look it up for each distribution"
        return
    facts = NAMES[use.name]
    if "lacks" in facts:
        yield f"{', '.join(facts['lacks'])} lacks {use.name}"
    lacking = facts.get("lacking", {})
    for keyword in use.keywords:
        if keyword in lacking:
            yield f"{', '.join(lacking[keyword])} lacks {use.name}({keyword}=)"
        elif keyword not in facts.get("takes", []):
            yield f"{use.name}({keyword}=) is not in rclpy_interface.yaml"


def is_package(name):
    return any(known.startswith(name + ".") for known in NAMES)


def test_every_distribution_has_the_used_names_of_rclpy():
    found = {path.name: faults(path.read_text("utf-8")) for path in FILES}
    assert {name: each for name, each in found.items() if each} == {}


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("from rclpy.clock_type import ClockType", "humble lacks rclpy.clock_type.ClockType"),
        ("import rclpy\nrclpy.spin_for_a_while()", "rclpy.spin_for_a_while is not in"),
        (
            "from rclpy.node import Node\n"
            "def f(node: Node): node.create_timer(1.0, f, autostart=False)",
            "humble lacks rclpy.node.Node.create_timer(autostart=)",
        ),
        (
            "from rclpy.node import Node\n"
            "class A(Node):\n"
            "    def f(self): self.get_clock().now().to_seconds()",
            "rclpy.time.Time.to_seconds is not in",
        ),
        (
            "from rclpy.node import Node\n"
            "class A:\n"
            "    def f(self): self._timer.start()\n"
            "    def __init__(self, node: Node):\n"
            "        self._name, self._timer = '', node.create_timer(1.0, self.f)",
            "rclpy.timer.Timer.start is not in",
        ),
    ],
)
def test_missing_names_of_a_distribution_are_found(text, fault):
    assert any(fault in each for each in faults(text))


def installed():
    """Return the distribution of the installed rclpy, or skip."""
    pytest.importorskip("rclpy")
    path = Path(importlib.import_module("rclpy").__file__)
    version = version_beside(path)
    for name, facts in DISTRIBUTIONS.items():
        if version.startswith(facts["rclpy"].split(".")[0] + "."):
            return name
    pytest.skip(f"rclpy {version} is of no distribution in rclpy_interface.yaml")


def version_beside(path):
    """Find the version among the wheel's metadata, or those of a system's ROS."""
    for name in ("ros-rclpy", "rclpy"):
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            return importlib.metadata.version(name)
    return pytest.skip(f"the rclpy of {path.parent} does not tell its version")


def test_the_table_agrees_with_the_installed_rclpy():
    distribution = installed()
    assert NAMES
    for name, facts in NAMES.items():
        is_there, keywords = look_up(name)
        assert is_there == (distribution not in facts.get("lacks", [])), name
        if is_there and keywords is not None:
            lacking = facts.get("lacking", {})
            missing = {keyword for keyword, where in lacking.items() if distribution in where}
            assert set(facts.get("takes", [])) <= keywords, name
            assert set(lacking) & keywords == set(lacking) - missing, name


def look_up(name):
    """Return whether rclpy has a name, and the keywords of a function; None if it takes any."""
    found, rest = deepest_module(name)
    for part in rest:
        if inspect.isclass(found) and is_set_in(found, part):
            return True, None
        if not hasattr(found, part):
            return False, None
        found = getattr(found, part)
    try:
        parameters = inspect.signature(found).parameters.values()
    except (TypeError, ValueError):
        return True, None
    takes_any = any(each.kind is each.VAR_KEYWORD for each in parameters)
    return True, None if takes_any else {each.name for each in parameters}


def deepest_module(name):
    parts = name.split(".")
    for k in range(len(parts), 0, -1):
        with contextlib.suppress(ModuleNotFoundError):
            return importlib.import_module(".".join(parts[:k])), parts[k:]
    return None, parts


def is_set_in(kind, attribute):
    """Whether the instances have an attribute that the class does not."""
    if hasattr(kind, attribute):
        return False
    try:
        return f"self.{attribute} " in textwrap.dedent(inspect.getsource(kind))
    except (OSError, TypeError):
        return False
