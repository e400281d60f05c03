"""The package's metadata agree with the package."""

import ast
import functools
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
import yaml

import magcal_ros

PACKAGE = Path(magcal_ros.__file__).resolve().parent
CHECKOUT = Path(__file__).resolve().parents[1]
MANIFEST = ElementTree.parse(CHECKOUT / "package.xml").getroot()

SYSTEM = {
    "matplotlib": "python3-matplotlib",
    "numpy": "python3-numpy",
    "rich": "python3-rich",
    "scipy": "python3-scipy",
    "yaml": "python3-yaml",
}
"""What rosdep calls a module that is no ROS package."""

NO_ROSDEP_KEY = {"pymavlink", "pyulog", "rosbags"}
"""Optional; the command that needs one says how to get it."""

NO_WHEEL = {"rosbag2_py"}
"""What only a robot has; elsewhere something else serves."""


@functools.cache
def imported():
    """List the foreign packages that any module imports, at its top or later."""
    found = set()
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {each.name.split(".")[0] for each in node.names}
            elif isinstance(node, ast.ImportFrom):
                found.add(node.module.split(".")[0])
    return frozenset(found) - {"magcal_ros"} - set(sys.stdlib_module_names)


def texts(tag):
    return [element.text for element in MANIFEST.findall(tag)]


def setup_call():
    """Return the arguments that setup.py gives, as it writes them."""
    tree = ast.parse((CHECKOUT / "setup.py").read_text(encoding="utf-8"))
    (call,) = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "setup"
    ]
    return {each.arg: ast.unparse(each.value).strip("'") for each in call.keywords}


def test_package_xml_names_exactly_the_imported_packages():
    needed = {SYSTEM.get(name, name) for name in imported() - NO_ROSDEP_KEY}
    launched = {"launch", "launch_ros"}
    assert set(texts("exec_depend")) == needed | launched


def test_the_wheels_of_each_distribution_hold_every_ros_package_that_is_imported():
    wheels = (CHECKOUT / "setup.py").read_text(encoding="utf-8")
    for name in imported() - NO_ROSDEP_KEY - NO_WHEEL - set(SYSTEM):
        for distribution in ("jazzy", "kilted"):
            assert f'"ros-{distribution}-{name.replace("_", "-")}==' in wheels


def test_all_metadata_agree_on_version_and_licence():
    given = setup_call()
    assert texts("version") == [given["version"]]
    assert texts("license") == [given["license"]]
    citation = yaml.safe_load((CHECKOUT / "CITATION.cff").read_text(encoding="utf-8"))
    assert [citation["version"]] == texts("version")
    assert [citation["license"]] == texts("license")
    assert citation["repository-code"] in texts("url")
    assert {"cff-version", "message", "title", "authors"} <= set(citation)


def test_no_address_has_an_impossible_host():
    made_up = re.compile(r"[\w.-]+\.(example|invalid|test|localhost)\b")
    for name in ("package.xml", "setup.py"):
        assert not made_up.search((CHECKOUT / name).read_text(encoding="utf-8"))


def test_the_changelog_has_the_form_for_release_tools():
    lines = (CHECKOUT / "CHANGELOG.rst").read_text(encoding="utf-8").splitlines()
    assert lines[1] == "Changelog for package magcal_ros"
    assert set(lines[0]) == set(lines[2]) == {"^"}
    assert len(lines[0]) == len(lines[2]) == len(lines[1])
    sections = [i for i, line in enumerate(lines) if line and set(line) == {"-"}]
    assert sections
    for i in sections:
        assert re.fullmatch(r"Forthcoming|\d+\.\d+\.\d+ \(\d{4}-\d\d-\d\d\)", lines[i - 1])
        assert len(lines[i]) == len(lines[i - 1])


def extras_of_setup():
    """Return the extras that setup.py declares."""
    (extras,) = re.findall(
        r"(?s)extras_require=\{(.*?)\n    \}", (CHECKOUT / "setup.py").read_text()
    )
    return set(re.findall(r'"([\w-]+)":', extras))


@pytest.mark.parametrize("name", ["noxfile.py", "Makefile"])
def test_only_existing_extras_are_required(name):
    text = (CHECKOUT / name).read_text(encoding="utf-8").replace("{extra}", "ros")
    groups = re.findall(r"(?:\.|magcal_ros)\[([\w,-]+)\]", text)
    asked = {each for group in groups for each in group.split(",")}
    assert asked
    assert asked <= extras_of_setup()


def test_tools_of_the_tests_have_a_key_in_every_distribution():
    assert set(texts("test_depend")) == {"python3-pytest", "python3-pytest-timeout"}


WITHOUT_HYPOTHESIS = """
import sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] == "hypothesis":
            raise ImportError(name)
sys.meta_path.insert(0, Absent())
import pytest
sys.exit(pytest.main(["-q", "--collect-only", "-p", "no:hypothesispytest", *sys.argv[1:]]))
"""


def test_the_tests_are_collected_without_hypothesis():
    folders = [
        str(CHECKOUT / "test" / name) for name in ("core/samples/test_units.py", "files/exporters")
    ]
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_HYPOTHESIS, *folders],
        capture_output=True,
        text=True,
        cwd=CHECKOUT,
    )
    assert done.returncode == 0, done.stdout[-2000:]
    assert "test_units.py" in done.stdout
    assert "test_exporters.py" not in done.stdout


@pytest.mark.parametrize("name", ["humble", "jazzy", "lyrical"])
def test_ci_tests_in_the_image_of_each_supported_distribution(name):
    jobs = yaml.safe_load((CHECKOUT / ".github/workflows/ci.yml").read_text())["jobs"]
    assert name in jobs["colcon"]["strategy"]["matrix"]["distribution"]
    steps = [step.get("run", "") for job in jobs.values() for step in job["steps"]]
    assert {"make test", "make matrix"} <= set(steps)
