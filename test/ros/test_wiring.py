"""What doc/wiring.md tells people to take is there, under this name and of this type."""

import re
from pathlib import Path

import pytest
import yaml

TEXT = (Path(__file__).parents[2] / "doc" / "wiring.md").read_text()
ROW = re.compile(r"^\| [^|]+ \| `([\w/]+)` \| (\w+/msg/\w+) \|", re.MULTILINE)
ROWS = sorted(set(ROW.findall(TEXT)))


@pytest.fixture
def published(start_node):
    node = start_node({"reference.declination_deg": 3.0})
    found = node.get_publisher_names_and_types_by_node("calibrator", "/")
    return {name.lstrip("/"): kinds for name, kinds in found}


def test_every_topic_of_the_table_is_published_with_its_type(published):
    assert len(ROWS) == 4
    for topic, kind in ROWS:
        assert published[topic] == [kind]


def test_the_yaml_blocks_are_parameter_files_of_robot_localization():
    ekf, navsat = (
        next(iter(yaml.safe_load(block).values()))["ros__parameters"]
        for block in re.findall(r"```yaml\n(.*?)```", TEXT, re.DOTALL)
    )
    assert (ekf["imu0"], len(ekf["imu0_config"])) == ("compass/true/enu/imu", 15)
    # x, y, z, roll, pitch, yaw, their rates, accelerations: only the yaw.
    assert [k for k, used in enumerate(ekf["imu0_config"]) if used] == [5]
    assert navsat["magnetic_declination_radians"] == navsat["yaw_offset"] == 0.0
