import ast
import functools
import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

import magcal_ros

ROOT = Path(magcal_ros.__file__).resolve().parent
FILES = sorted(ROOT.rglob("*.py"))
CORE_FILES = sorted((ROOT / "core").rglob("*.py"))
TESTS = Path(__file__).resolve().parent
TEST_FILES = sorted(TESTS.rglob("*.py"))
LONGEST_FILE, LONGEST_FUNCTION = 400, 60

MAY_IMPORT = {
    "core": {"core", "numpy", "scipy"},
    "files": {
        "core",
        "files",
        "magcal_ros",
        "numpy",
        "pymavlink",
        "pyulog",
        "rosbag2_py",
        "rosbags",
        "yaml",
    },
}
"""Beyond the standard library; a room of the package by its own name."""

FORBIDDEN_ROOMS = {"core": {"ros", "cli", "report", "files"}, "files": {"ros", "cli", "report"},
                   "report": {"ros", "cli"}, "ros": {"cli"}}  # fmt: skip

LOAD_ALL = """
import importlib, pkgutil, sys
for room in ("core", "files"):
    package = importlib.import_module(f"magcal_ros.{room}")
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        importlib.import_module(module.name)
print("\\n".join(sys.modules))
"""


def room_of(path):
    parts = path.relative_to(ROOT).parts
    return parts[0] if len(parts) > 1 else ""


@functools.cache
def nodes_of(path):
    """The syntax tree of a file."""
    return tuple(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


def imported_modules(path):
    for node in nodes_of(path):
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively"
            yield node.module
            if node.module == "magcal_ros":
                yield from (f"magcal_ros.{n.name}" for n in node.names if n.name[0] != "_")


def source_of(module):
    """A room of the package, or a foreign top-level package."""
    parts = module.split(".")
    return parts[1] if parts[0] == "magcal_ros" and len(parts) > 1 else parts[0]


def test_core_and_files_load_neither_ros_nor_optional_packages_nor_scipy_before_it_is_needed():
    done = subprocess.run(
        [sys.executable, "-c", LOAD_ALL], capture_output=True, text=True, check=True
    )
    loaded = set(done.stdout.split())
    assert {"magcal_ros.core.methods.smoother", "magcal_ros.files.recording"} <= loaded
    tops = {name.split(".")[0] for name in loaded}
    assert not tops & {
        "rclpy",
        "scipy",
        "matplotlib",
        "sensor_msgs",
        "std_msgs",
        "rcl_interfaces",
        "rosbags",
        "pymavlink",
        "pyulog",
    }
    assert not {"magcal_ros.ros", "magcal_ros.cli", "magcal_ros.report"} & loaded


def where_not(finds, paths=FILES):
    """Return what is found in which files; nothing where all is well."""
    return {str(path.relative_to(ROOT)): found for path in paths if (found := finds(path))}


def test_rooms_import_only_lower_rooms():
    def foreign(path):
        room = room_of(path)
        sources = {source_of(module) for module in imported_modules(path)}
        allowed = MAY_IMPORT.get(room, sources) | set(sys.stdlib_module_names)
        return sources & FORBIDDEN_ROOMS.get(room, set()) | sources - allowed

    assert where_not(foreign) == {}


def module_of(path):
    parts = path.relative_to(ROOT.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(path) for path in FILES}


def needed_modules(path):
    """Modules of the package that a file imports anywhere, also inside of functions."""
    known = MODULES
    for node in nodes_of(path):
        if isinstance(node, ast.ImportFrom):
            inner = {f"{node.module}.{name.name}" for name in node.names}
            yield from inner & known or {node.module} & known
        elif isinstance(node, ast.Import):
            yield from {name.name for name in node.names} & known


def test_there_are_no_circular_imports():
    needs = {module_of(path): set(needed_modules(path)) for path in FILES}
    # Modules that import none of the rest are removed; a cycle remains.
    while free := {module for module, needed in needs.items() if not needed & set(needs)}:
        needs = {module: needed for module, needed in needs.items() if module not in free}
    assert needs == {}


MAY_SIMULATE = {"cli/demo.py", "ros/rehearsal.py"}


def test_only_the_demo_and_the_rehearsal_import_the_simulation():
    def simulates(path):
        return {name for name in imported_modules(path) if "core.simulation" in name}

    inside = {str(path.relative_to(ROOT)) for path in (ROOT / "core/simulation").rglob("*.py")}
    assert set(where_not(simulates)) - inside == MAY_SIMULATE


def test_tests_import_nothing_from_the_benchmarks():
    checkout = Path(__file__).resolve().parents[1]
    scripts = {path.stem for path in (checkout / "benchmarks").glob("*.py")}
    helpers = {path.stem for path in (checkout / "test").rglob("*.py")}
    tests = [*(checkout / "test").rglob("*.py"), *(checkout / "cases").glob("*.py")]
    imports = re.compile(r"(?m)^ *(?:from|import) (\w+)")
    found = {
        str(path): wrong
        for path in tests
        if (wrong := {*imports.findall(path.read_text(encoding="utf-8"))} & scripts - helpers)
    }
    assert found == {}


def test_what_is_tested_while_ros_is_installed_needs_none():
    needs = re.compile(r"(?m)^ *(?:from|import) rclpy|importorskip\(.rclpy")
    for room in ("core", "files", "report"):
        for path in (TESTS / room).rglob("*.py"):
            assert not needs.search(path.read_text(encoding="utf-8")), path


def test_the_core_reads_no_clock_and_prints_nothing():
    def unlike_core(path):
        names = {node.id for node in nodes_of(path) if isinstance(node, ast.Name)}
        used = names & {"print", "open", "input"}
        return used | {"time", "datetime", "logging"} & set(imported_modules(path))

    assert where_not(unlike_core, CORE_FILES) == {}


def test_only_one_module_starts_processes():
    """It leaves out the current folder, which Python would take modules from."""

    def starts(path):
        names = {ast.unparse(node) for node in nodes_of(path) if isinstance(node, ast.Attribute)}
        kinds = {"sys.executable", "subprocess.run", "subprocess.call", "os.system", "os.fork"}
        called = {ast.unparse(node.func) for node in nodes_of(path) if isinstance(node, ast.Call)}
        found = names & kinds | called & {"subprocess.Popen"}
        return found | {"multiprocessing", "concurrent.futures"} & set(imported_modules(path))

    assert set(where_not(starts)) == {"processes.py"}


def test_files_and_functions_are_short():
    def long(path):
        kinds = (ast.FunctionDef, ast.AsyncFunctionDef)
        functions = [node for node in nodes_of(path) if isinstance(node, kinds)]
        sizes = {each.name: each.end_lineno - each.lineno + 1 for each in functions}
        found = {name: size for name, size in sizes.items() if size > LONGEST_FUNCTION}
        lines = len(path.read_text(encoding="utf-8").splitlines())
        return found | ({"lines": lines} if lines > LONGEST_FILE else {})

    assert where_not(long) == {}


ORDER_OF_ROOMS = (
    "lazy_names",
    "errors",
    "geometry",
    "samples",
    "knowledge",
    "calibration",
    "assessment",
    "earth_field",
    "up",
    "driving",
    "simulation",
    "heading",
    "smoother",
    "doctor",
    "methods",
    "multi_turn",
    "calibrate",
    "session",
    "monitoring",
    "self_calibration",
)
"""The rooms of core from the ground up: each imports only what lies below it."""

SAME_MEANING = {"Options", "fit", "__init__"}
"""What every method has: its options and its fit."""


def core_room_of(path):
    return path.relative_to(ROOT / "core").parts[0].removesuffix(".py")


def test_the_rooms_of_core_are_in_one_order():
    rooms = {core_room_of(path) for path in CORE_FILES} - {"__init__"}
    assert rooms == set(ORDER_OF_ROOMS)
    rank = {room: number for number, room in enumerate(ORDER_OF_ROOMS)}
    upwards = {
        (room, module.split(".")[2])
        for path in CORE_FILES
        if (room := core_room_of(path)) != "__init__"
        for module in imported_modules(path)
        if module.startswith("magcal_ros.core.") and rank[module.split(".")[2]] > rank[room]
    }
    assert upwards == set()


def test_no_room_of_core_imports_from_the_public_names_of_core():
    assert not [path for path in CORE_FILES if "magcal_ros.core" in imported_modules(path)]


def twice(names):
    return {name for name in names if names.count(name) > 1} - SAME_MEANING


def test_no_name_in_core_has_two_meanings():
    assert repeated(CORE_FILES) == set()


def repeated(paths):
    classes = [
        node.name for path in paths for node in nodes_of(path) if isinstance(node, ast.ClassDef)
    ]
    return twice(classes) | twice([path.stem for path in paths])


FACE = """
import importlib
importlib.import_module("magcal_ros.core.calibrate")
import magcal_ros.core as core
from magcal_ros.core import calibrate
assert calibrate.__name__ == "calibrate" and callable(calibrate), calibrate
from magcal_ros.core.calibrate import judged
assert core.calibrate is calibrate
for name in core.__all__:
    assert getattr(core, name) is not None and name in dir(core), name
try:
    core.no_such_name
except AttributeError as error:
    assert "no_such_name" in str(error)
else:
    raise AssertionError("a name that is not there was found")
"""


def test_core_exports_the_names_that_it_lists():
    subprocess.run([sys.executable, "-c", FACE], check=True)


FACES = [
    f"magcal_ros.{room}"
    for room in ("files", *sorted(f"core.{p.parent.name}" for p in ROOT.glob("core/*/__init__.py")))
]


@pytest.mark.parametrize("face", FACES)
def test_each_room_exports_the_names_that_it_lists(face):
    room = importlib.import_module(face)
    for name in room.__all__:
        assert getattr(room, name) is not None
        assert name in dir(room)
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = room.no_such_name


def test_tests_import_public_names_from_the_room():
    offered = {face: set(importlib.import_module(face).__all__) for face in FACES}
    deep = [
        f"{path.name}: {name.name} of {node.module}"
        for path in TEST_FILES
        for node in nodes_of(path)
        if isinstance(node, ast.ImportFrom) and node.module not in offered
        for name in node.names
        if name.name in offered.get((node.module or "").rpartition(".")[0], ())
    ]
    assert deep == []


def test_core_loads_nothing_before_a_name_is_used():
    script = "import sys, magcal_ros.core; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert not {"numpy", "scipy"} & set(done.stdout.split())
