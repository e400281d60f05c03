"""The documents agree with the code."""

import json
import re
import subprocess
import sys
from pathlib import Path

import yaml

CHECKOUT = Path(__file__).resolve().parents[2]


def test_generated_tables_agree_with_code_and_results():
    done = subprocess.run(
        [sys.executable, str(CHECKOUT / "doc" / "generate.py"), "--check"],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_readme_opens_with_the_two_commands():
    lines = (CHECKOUT / "README.md").read_text().splitlines()[:12]
    assert any(line.startswith("make demo") for line in lines)
    assert any(line.startswith("make test") for line in lines)


def test_the_documents_contain_no_path_of_a_machine():
    for name in ("README.md", "setup.py", "package.xml"):
        text = (CHECKOUT / name).read_text()
        assert "/home/" not in text
        assert "/tmp/" not in text


def test_the_layouts_show_the_topics_that_the_node_publishes():
    rviz = yaml.safe_load((CHECKOUT / "config" / "calibrator.rviz").read_text())
    displays = rviz["Visualization Manager"]["Displays"]
    (turn,) = [d for d in displays if d["Class"] == "rviz_default_plugins/MarkerArray"]
    assert turn["Topic"]["Value"] == "/calibrator/markers"
    assert turn["Topic"]["Durability Policy"] == "Transient Local"
    layout = json.loads((CHECKOUT / "config" / "foxglove.json").read_text())
    panels = layout["configById"]
    assert "/calibrator/markers" in panels["3D!turn"]["topics"]
    assert panels["Plot!yaw"]["paths"][0]["value"] == "/compass/yaw.data"
    used = json.dumps(layout["layout"])
    assert all(name in used for name in panels)


def test_the_table_of_faults_names_all_tests_of_faults():
    table = (CHECKOUT / "doc" / "faults.md").read_text()
    named = set(re.findall(r"`((?:test|benchmarks)/[\w/]+\.py)`", table))
    assert all((CHECKOUT / name).is_file() for name in named)
    marked = {
        str(path.relative_to(CHECKOUT))
        for path in (CHECKOUT / "test").rglob("test_*.py")
        if "pytestmark = pytest.mark.faults" in path.read_text().splitlines()
    }
    assert marked <= named
    assert "(doc/faults.md)" in (CHECKOUT / "README.md").read_text()
