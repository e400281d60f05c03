"""What participants of the network can and cannot make the node do."""

import os
import time
from pathlib import Path
from xml.etree import ElementTree

import pytest
from mobile_base import MobileBase
from rclpy.parameter import Parameter
from support import AT_ONCE, PATIENCE, REFERENCE, store_calibration

pytestmark = pytest.mark.faults

TURNING = {**REFERENCE, "rotate.enabled": True, "rotate.speed_rad_s": 0.8}


@pytest.fixture
def asked(start_node):
    """Return a function that starts a node and sets parameters as a request does."""

    def start(given=REFERENCE):
        node = start_node(given)

        def change(name, value):
            (result,) = node.set_parameters([Parameter(name, value=value)])
            return result.reason if not result.successful else ""

        return node, change

    return start


ELSEWHERE = [
    "{home}/magcal/../job",
    "{home}/magcal/sub/../../../job",
    "{home}/magcal_not/job",
    "{home}/magcal\0/job",
    "{home}",
    "{tmp}/cron.d/job",
    "~/job",
    "~nobody_of_this_name/job",
    "job",
    "/etc/cron.d/job",
    "none/job",
]


@pytest.mark.parametrize("name", ["calibration_file", "report_folder"])
def test_allowed_folders_are_chosen_at_the_start(asked, ros_home, tmp_path, name):
    given = tmp_path / "given"
    node, change = asked({**REFERENCE, name: str(given)})
    for text in ELSEWHERE:
        place = text.format(home=ros_home, tmp=tmp_path)
        assert change(name, place), place
        assert node.get_parameter(name).value == str(given)
    for place in (f"{ros_home}/magcal/mine.yaml", "", str(given)):
        assert change(name, place) == ""
    # A folder with the file's name would be in its way.
    is_allowed = name == "report_folder"
    assert (change(name, f"{given}/below.yaml") == "") is is_allowed
    assert "restart the node with it" in change(name, "/etc/cron.d/job")
    assert not (ros_home / "magcal").exists()
    assert not given.exists()


def test_without_a_folder_at_the_start_only_the_packages_own_is_allowed(asked, ros_home, tmp_path):
    _, change = asked(REFERENCE)
    assert change("calibration_file", str(tmp_path / "x.yaml"))
    assert change("calibration_file", "none")
    assert change("report_folder", str(tmp_path))
    assert change("report_folder", "none") == ""
    assert change("calibration_file", str(ros_home / "magcal" / "x.yaml")) == ""


def test_all_files_that_cannot_be_loaded_give_the_same_message(stage, graph, ros_home):
    actor = stage()
    (node,) = graph.calibrators
    folder = ros_home / "magcal"
    folder.mkdir(parents=True)
    store_calibration(folder / "other.yaml", frame="another_sensor")
    store_calibration(folder / "link_to.yaml")
    (folder / "notes.yaml").write_text("mine")
    (folder / "folder.yaml").mkdir()
    os.mkfifo(folder / "pipe.yaml")
    (folder / "link.yaml").symlink_to("/etc/passwd")
    names = ["missing.yaml", "notes.yaml", "folder.yaml", "pipe.yaml", "link.yaml", "other.yaml"]
    answers = set()
    actor.run(PATIENCE, stop=lambda: node._inputs.field.messages)
    for name in [*names, "missing/missing.yaml"]:
        chosen = str(folder / name)
        assert node.set_parameters([Parameter("calibration_file", value=chosen)])[0].successful
        refused = actor.answer(actor.call("load"))
        assert not refused.success
        answers.add(refused.message.replace(chosen, "X"))
        assert node._store.problem == refused.message
    assert len(answers) == 1
    chosen = str(folder / "link_to.yaml")
    assert node.set_parameters([Parameter("calibration_file", value=chosen)])[0].successful
    assert actor.answer(actor.call("load")).success


class TestWhetherTheRobotMayTurn:
    def test_rotation_cannot_be_enabled_from_the_network(self, asked):
        node, change = asked({**REFERENCE, "rotate.enabled": False})
        assert "started with rotate.may_be_enabled:=true" in change("rotate.enabled", True)
        assert "read when the node starts" in change("rotate.may_be_enabled", True)
        both = [Parameter(f"rotate.{name}", value=True) for name in ("may_be_enabled", "enabled")]
        assert not node.set_parameters_atomically(both).successful
        assert not node._table.settings.rotation.enabled

    def test_rotation_can_be_disabled_at_any_time_and_stays_disabled(self, asked):
        node, change = asked({**REFERENCE, "rotate.enabled": True})
        assert change("rotate.enabled", True) == ""
        assert change("rotate.enabled", False) == ""
        assert change("rotate.enabled", True)
        assert not node.get_parameter("rotate.enabled").value

    def test_rotation_can_be_enabled_again_if_it_was_enabled_at_the_start(self, asked):
        node, change = asked({**REFERENCE, "rotate.may_be_enabled": True})
        assert change("rotate.enabled", True) == ""
        deadline = time.monotonic() + AT_ONCE
        while not node._table.settings.rotation.enabled and time.monotonic() < deadline:
            time.sleep(0.01)
        assert node._table.settings.rotation.enabled

    def test_the_memory_limit_cannot_be_changed(self, asked):
        _, change = asked()
        assert "read when the node starts" in change("memory_limit_mb", 100_000)


POLICY = Path(__file__).parents[2] / "config" / "sros2_policy.xml"
KINDS = {
    "publish": "publisher",
    "subscribe": "subscriber",
    "reply": "service",
    "request": "client",
}


def allowed():
    """Return the full names that the policy allows the node, by kind."""
    found = {kind: set() for kind in KINDS.values()}
    (profile,) = ElementTree.parse(POLICY).iterfind(".//profile")
    assert profile.attrib == {"ns": "/", "node": "calibrator"}
    for rules in profile:
        for attribute in rules.attrib:
            assert rules.attrib[attribute] == "ALLOW"
            names = {rule.text.replace("~/", "/calibrator/") for rule in rules}
            found[KINDS[attribute]] |= {name if name[0] == "/" else f"/{name}" for name in names}
    return found


def opened(node, watched):
    found = {kind: set() for kind in KINDS.values()}
    for name, namespace in node.get_node_names_and_namespaces():
        for kind in KINDS.values() if name.startswith(watched) else ():
            names = getattr(node, f"get_{kind}_names_and_types_by_node")(name, namespace)
            found[kind] |= {each for each, _ in names}
    return found


def test_the_policy_allows_exactly_what_node_and_guard_open(start_node, actor):
    start_node({**TURNING, "base_frame": "base_link", "use_sim_time": True})
    robot = MobileBase(actor())
    future = robot.actor.call("calibrate")
    robot.live_until_moving()
    node = robot.actor.node
    both = opened(node, ("calibrator", "_magcal_guard"))
    guard = opened(node, "_magcal_guard")
    assert robot.actor.answer(robot.actor.call("cancel")).success
    robot.answer(future)
    assert guard == {
        "publisher": {"/cmd_vel"}, "subscriber": set(), "service": set(), "client": set()
    }  # fmt: skip
    spare = {
        "subscriber": {"/tf_static"},
        "publisher": {"/imu/mag_2_unbiased", "/imu/mag_2_bias"},
        "service": {"/calibrator/get_type_description"},
    }
    for kind, names in allowed().items():
        assert both[kind] <= names, f"{kind}: the policy lacks {both[kind] - names}"
        # tf2, the description of types and a second magnetometer are not everywhere.
        assert names - both[kind] <= spare.get(kind, set()), kind
