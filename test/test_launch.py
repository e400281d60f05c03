"""Launch files and samples of configuration: they load, and every name in them exists.

`launch` has no wheels, so the files run with stand-ins that note what they are given; the real ones
run in the images of `.github/workflows/ci.yml`.
"""

import re
import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
import yaml

CHECKOUT = Path(__file__).resolve().parents[1]
LAUNCHES = sorted((CHECKOUT / "launch").glob("*.launch.py"))
SAMPLES = sorted((CHECKOUT / "config" / "sensors").glob("*.yaml"))
CONSUMERS = yaml.safe_load((CHECKOUT / "test" / "consumers.yaml").read_text())
FILTERS = CONSUMERS["robot_localization"]["parameters"]
EXECUTABLES = {"magcal_ros": {"calibrator"}, "robot_localization": set(FILTERS)}
HEARD = {
    "calibrator": {
        "imu/data_raw",
        "imu/mag",
        "imu/mag_2",
        "gps/fix",
        "gps/vel",
        "heading",
        "odom",
        "battery",
        "cmd_vel",
    },
    "ekf_node": {"imu/data_raw", "odom", "odometry/filtered"},
    "navsat_transform_node": {"imu", "gps/fix", "odometry/filtered"},
}
"""What may be remapped."""

STAND_INS = {
    "launch": ["LaunchDescription"],
    "launch.actions": ["DeclareLaunchArgument", "IncludeLaunchDescription", "OpaqueFunction"],
    "launch.launch_description_sources": ["PythonLaunchDescriptionSource"],
    "launch.substitutions": ["LaunchConfiguration", "PathJoinSubstitution"],
    "launch_ros.actions": ["Node"],
    "launch_ros.parameter_descriptions": ["ParameterValue"],
    "launch_ros.substitutions": ["FindPackageShare"],
}


class Made(SimpleNamespace):
    """The objects of one class that a launch file has created, with their arguments."""

    def perform(self, context):
        """Return what the user gave for an argument: nothing, unless the context has it."""
        return context.get(self.given[0], "")


@pytest.fixture
def stand_ins(monkeypatch):
    """Replace ROS's modules."""
    monkeypatch.setitem(sys.modules, "launch_ros", ModuleType("launch_ros"))
    for name, classes in STAND_INS.items():
        module = ModuleType(name)
        for each in classes:
            made = lambda *given, kind=each, **named: Made(kind=kind, given=given, named=named)  # noqa: E731
            setattr(module, each, made)
        monkeypatch.setitem(sys.modules, name, module)


def description_of(path, context):
    """Return the arguments and nodes of a launch file by name, as a user starts it."""
    (entities,) = runpy.run_path(str(path))["generate_launch_description"]().given
    made_later = [each for each in entities if each.kind == "OpaqueFunction"]
    entities = [each for each in entities if each.kind != "OpaqueFunction"]
    entities += [made for each in made_later for made in each.named["function"](context)]
    included = [each for each in entities if each.kind == "IncludeLaunchDescription"]
    entities = [each for each in entities if each.kind != "IncludeLaunchDescription"]
    arguments = {
        each.given[0]: each.named for each in entities if each.kind == "DeclareLaunchArgument"
    }
    nodes = {each.named["name"]: each.named for each in entities if each.kind == "Node"}
    assert len(arguments) + len(nodes) == len(entities)
    for each in included:
        # Arguments of the same name are passed on, and every one that the other file has.
        passed = dict(each.named["launch_arguments"])
        others, more = description_of(path_of(each.given[0].given[0]), context)
        assert set(passed) == set(others)
        assert all(value.given == (name,) for name, value in passed.items())
        nodes |= more
    return arguments, nodes


def path_of(substitution):
    """Return the file in the checkout that a substitution finds in the package's share."""
    package, *rest = substitution.given[0]
    assert package.given == ("magcal_ros",)
    return CHECKOUT.joinpath(*rest)


CALIBRATOR = CHECKOUT / "launch" / "calibrator.launch.py"
TEXTS = {"base_frame": "base_link", "calibration_file": "/somewhere/compass.yaml"}
PLACE = {"latitude": "48", "longitude": "-11.6"}


@pytest.fixture(params=LAUNCHES, ids=lambda path: path.name)
def described(request, stand_ins):
    """Return what a launch file describes with all arguments given, and its file of parameters."""
    arguments, nodes = description_of(request.param, TEXTS | PLACE)
    return arguments, nodes, path_of(arguments["params_file"]["default_value"])


def mentioned(value):
    """Return the names of all arguments that a value of a launch file refers to."""
    if isinstance(value, Made):
        return set(value.given) if value.kind == "LaunchConfiguration" else mentioned(value.given)
    if isinstance(value, dict):
        return mentioned(list(value.values()))
    return set().union(*map(mentioned, value)) if isinstance(value, list | tuple) else set()


def parameters_in(path):
    """Return the parameters of a file, dotted, by what stands before them."""

    def flat(tree, before=""):
        for key, value in tree.items():
            if isinstance(value, dict):
                yield from flat(value, f"{before}{key}.")
            else:
                yield f"{before}{key}", value

    document = yaml.safe_load(path.read_text())
    return {node: dict(flat(tree["ros__parameters"])) for node, tree in document.items()}


OURS = parameters_in(CHECKOUT / "config" / "calibrator.yaml")["/**"]


def test_every_argument_is_declared_used_and_explained(described):
    arguments, nodes, _ = described
    assert mentioned(nodes) == set(arguments) - set(PLACE)
    assert all(each["description"] for each in arguments.values())


def test_an_omitted_argument_leaves_the_parameter_to_the_file(stand_ins):
    _, nodes = description_of(CALIBRATOR, {})
    assert set(nodes["calibrator"]["parameters"][1]) == {"use_sim_time"}
    _, nodes = description_of(CALIBRATOR, TEXTS)
    assert set(nodes["calibrator"]["parameters"][1]) == {"use_sim_time", *TEXTS}
    assert set(TEXTS) <= set(OURS)


@pytest.mark.parametrize("path", LAUNCHES, ids=lambda path: path.name)
def test_a_given_place_is_a_number(stand_ins, path):
    """Without a point in it, too: the parameter refuses whole numbers."""
    _, nodes = description_of(path, PLACE)
    given = nodes["calibrator"]["parameters"][1]
    place = {"reference.latitude_deg": 48.0, "reference.longitude_deg": -11.6}
    assert {name: given.get(name) for name in place} == place
    assert all(isinstance(given[name], float) for name in place)
    assert set(place) <= set(OURS)


def test_the_example_gives_only_declared_arguments(stand_ins):
    page = (CHECKOUT / "doc" / "questions.md").read_text()
    (block,) = re.findall(r"(?ms)^```python\n(.*?)^```$", page)
    scope = {}
    exec(compile(block, "questions.md", "exec"), scope)
    ((entity,),) = scope["generate_launch_description"]().given
    (source,) = entity.given
    assert path_of(source.given[0]) == CALIBRATOR
    arguments, _ = description_of(CALIBRATOR, {})
    assert {name for name, _ in entity.named["launch_arguments"]} <= set(arguments)


def test_every_executable_and_remapped_topic_exists(described):
    _, nodes, _ = described
    for node in nodes.values():
        assert node["executable"] in EXECUTABLES[node["package"]]
        assert {old for old, _ in node["remappings"]} <= HEARD[node["executable"]]


def test_every_parameter_is_one_of_its_node(described):
    _, nodes, path = described
    for name, parameters in parameters_in(path).items():
        executable = nodes[name.rpartition("/")[2]]["executable"] if name != "/**" else "calibrator"
        known = OURS if executable == "calibrator" else FILTERS[executable]
        assert set(parameters) <= set(known), name


def test_the_filters_take_each_quantity_from_its_source():
    found = parameters_in(CHECKOUT / "config" / "robot_localization.yaml")
    yaw, yaw_rate = 5, 11
    taken = {}
    for name in ("ekf_filter_node_odom", "ekf_filter_node_map"):
        parameters = found[f"/**/{name}"]
        for key, value in parameters.items():
            if key.endswith("_config"):
                assert len(value) == 15
                source = parameters[key.removesuffix("_config")]
                taken[name, source] = [k for k, used in enumerate(value) if used]
    assert taken == {
        ("ekf_filter_node_odom", "odom"): [6, 7],
        ("ekf_filter_node_odom", "imu/data_raw"): [yaw_rate],
        ("ekf_filter_node_map", "odom"): [6, 7],
        ("ekf_filter_node_map", "odometry/gps"): [0, 1],
        ("ekf_filter_node_map", "imu/data_raw"): [yaw_rate],
        ("ekf_filter_node_map", "compass/true/enu/imu"): [yaw],
    }
    transform = found["/**/navsat_transform"]
    assert transform["magnetic_declination_radians"] == transform["yaw_offset"] == 0.0


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: path.stem)
def test_a_sample_for_a_sensor_sets_existing_parameters_and_names_known_faults(path):
    assert set(parameters_in(path)["/**"]) <= set(OURS)
    assert "# Notes\n# - " in path.read_text()


def test_launch_files_and_samples_are_installed():
    setup = (CHECKOUT / "setup.py").read_text()
    for folder in ("launch", "config", "config/sensors"):
        assert f'(f"share/{{NAME}}/{folder}", sorted(glob("{folder}/*.*")))' in setup
    assert "graft launch" in (CHECKOUT / "MANIFEST.in").read_text()
