"""The topics in doc/wiring.md exist, and each row is based on the consumer's source."""

import re
from pathlib import Path

import pytest
import yaml

TEST = Path(__file__).parents[1]
TEXT = (TEST.parent / "doc" / "wiring.md").read_text()
CONSUMERS = yaml.safe_load((TEST / "consumers.yaml").read_text())
ROW = re.compile(r"^\| ([^|]+) \| `([\w/]+)` \| (\w+/msg/\w+) \| ([^|]+) \|$", re.MULTILINE)
ROWS = [list(row) for row in ROW.findall(TEXT)]
TAKEN = sorted({(topic, kind) for _, topic, kind, _ in ROWS})
BLOCKS = [yaml.safe_load(block) for block in re.findall(r"```yaml\n(.*?)```", TEXT, re.DOTALL)]


@pytest.fixture
def published(start_node):
    node = start_node({"reference.declination_deg": 3.0})
    found = node.get_publisher_names_and_types_by_node("calibrator", "/")
    return {name.lstrip("/"): kinds for name, kinds in found}


def test_every_topic_of_the_table_is_published_with_its_type(published):
    assert len(TAKEN) == 4
    for topic, kind in TAKEN:
        assert published[topic] == [kind]


def test_every_row_is_one_of_the_facts():
    known = [row for facts in CONSUMERS.values() for row in facts.get("rows", [])]
    own = ["a program that reads a number", "compass/yaw", "std_msgs/msg/Float64", "its own"]
    assert sorted(ROWS) == sorted([*known, own])


@pytest.mark.parametrize("name", CONSUMERS)
def test_the_page_names_version_and_date_of_the_sources(name):
    facts = CONSUMERS[name]
    cells = (name, facts["version"], facts["read"], facts["source"], facts["facts"])
    assert f"| {' | '.join(map(str, cells))} |" in TEXT


def parameters_of(block):
    """Return the parameters that a block of YAML sets."""
    return next(iter(block.values()))["ros__parameters"]


def test_the_yaml_blocks_name_parameters_that_their_consumer_has():
    declared = [set(names) for facts in CONSUMERS.values()
                for names in facts.get("parameters", {}).values()]  # fmt: skip
    assert len(BLOCKS) == 4
    for block in BLOCKS:
        assert any(set(parameters_of(block)) <= names for names in declared), block


def test_the_blocks_of_robot_localization_use_the_yaw_once():
    ekf, navsat = map(parameters_of, BLOCKS[:2])
    assert (ekf["imu0"], len(ekf["imu0_config"])) == ("compass/true/enu/imu", 15)
    # x, y, z, roll, pitch, yaw, their rates, accelerations: only the yaw.
    assert [k for k, used in enumerate(ekf["imu0_config"]) if used] == [5]
    assert navsat["magnetic_declination_radians"] == navsat["yaw_offset"] == 0.0


def test_the_field_is_corrected_once():
    compass, fusioncore = map(parameters_of, BLOCKS[2:])
    assert compass["subscribe_mag_unbiased"] is True
    assert compass["publish_mag_unbiased"] is False
    assert fusioncore["gnss.heading_topic"] == "compass/true/enu/imu"
    assert fusioncore["magnetometer.enabled"] is False
