"""Names from the network are never a path, markup or a terminal command."""

import json

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import String
from support import PATIENCE, REFERENCE, calibrate_quickly, wait_until

from magcal_ros.cli.live_view import progress_of, status_of
from magcal_ros.files import LONGEST_FRAME, read_calibration, read_samples
from magcal_ros.report.write import OURS
from magcal_ros.ros.preflight import SensorTopic, _describe
from magcal_ros.ros.sensor_frames import LATCHED

pytestmark = pytest.mark.faults

PROGRESS = {
    "stage": "collecting", "arc_deg": 90.0, "filled": "##..", "advice": "turn left", "samples": 5,
    "elapsed_s": 1.0, "turn_rate_deg_s": 20.0, "heading_sigma_deg": None,
}  # fmt: skip


@pytest.mark.parametrize(
    "frame",
    [
        "../../../../escaped",
        pytest.param(
            "<script>alert(1)</script>\x1b]0;owned\x07[red]" + "x" * 1_000_000,
            marks=pytest.mark.nightly,
        ),
    ],
    ids=["parent", "enormous markup"],
)
def test_a_frame_is_not_used_as_a_path_or_markup(stage, ros_home, frame):
    actor = stage(parameters={**REFERENCE, "report_folder": ""}, speed=8.0)
    actor.source._field.header.frame_id = frame
    actor.source._imu.header.frame_id = frame
    answer = calibrate_quickly(actor)
    assert answer.success, answer.message
    assert answer.message.isprintable()
    (path,) = (ros_home / "magcal").glob("*.yaml")
    assert f"saved to {path}" in answer.message
    _, origin = read_calibration(path)
    assert origin.magnetometer_frame[:LONGEST_FRAME] == frame[:LONGEST_FRAME]
    loaded = actor.answer(actor.call("load"))
    assert loaded.success, loaded.message
    (folder,) = (ros_home / "magcal" / "reports").iterdir()
    assert f"Report: {folder}/report.html." in answer.message
    wait_until((folder / "report.html").exists)
    page = (folder / "report.html").read_text()
    assert "/imu/mag and /imu/data_raw" in page
    assert "<svg" in page
    assert "<script" not in page
    assert len(read_samples(folder / "samples.csv")) > 80
    assert len(page) < 1_000_000
    inside = {p for p in ros_home.rglob("*") if p.is_file() and p.suffix != ".log"}
    left = ("report.html", "samples.csv", "in_force.txt", OURS)
    assert inside == {path, *(folder / name for name in left)}


ENORMOUS = 300_000 * "x"
MOVING = f"""<robot name="mule"><joint name="{ENORMOUS}j" type="continuous">
<parent link="base_link"/><child link="{ENORMOUS}i"/></joint></robot>"""


def test_a_very_long_frame_is_cut_in_every_output(stage, capfd):
    actor = stage(parameters={**REFERENCE, "base_frame": "base_link"})
    actor.source._field.header.frame_id = f"{ENORMOUS}m"
    actor.source._imu.header.frame_id = f"{ENORMOUS}i"
    printed = []
    actor.node.create_subscription(DiagnosticArray, "/diagnostics", printed.append, 10)

    def words():
        return str(printed[-1]) if printed else ""

    actor.run(PATIENCE, stop=lambda: "no robot_description came" in words())
    assert "no robot_description came" in words()
    assert len(words()) < 20_000
    out = actor.node.create_publisher(String, "robot_description", LATCHED)
    out.publish(String(data=MOVING))
    actor.run(PATIENCE, stop=lambda: "moves (continuous)" in words())
    assert "moves (continuous)" in words()
    assert len(words()) < 20_000
    assert len(json.dumps(actor.status)) < 20_000
    log = capfd.readouterr()
    assert len(log.out + log.err) < 20_000


def test_the_preflight_prints_a_frame_without_control_characters():
    from rclpy.serialization import serialize_message
    from sensor_msgs.msg import Imu

    received = SensorTopic("/imu", "sensor_msgs/msg/Imu")
    for k in range(100):
        message = Imu()
        message.header.frame_id = f"{k}\x1b[2J\n" + "x" * 1000
        received.note(serialize_message(message))
    line = _describe(received, 1.0)
    assert line.isprintable()
    assert len(line) < 2000


@pytest.mark.parametrize(
    "text",
    [
        "", "{", "[]", "null", "7", '"x"', "{}", '{"state": "collecting"}', "[" * 100_000,
        '{"state": "collecting", "progress": null}', '{"state": ["collecting"], "progress": {}}',
        *(
            json.dumps({"state": "collecting", "progress": {**PROGRESS, name: bad}})
            for name, bad in (
                ("arc_deg", float("nan")), ("elapsed_s", float("inf")), ("samples", "many"),
                ("turn_rate_deg_s", None), ("samples", float("inf")), ("heading_sigma_deg", []),
            )
        ),
    ],
)  # fmt: skip
def test_an_invalid_status_is_ignored(text):
    assert progress_of(status_of(text)) is None


def test_texts_of_a_status_cannot_control_the_terminal():
    evil = {**PROGRESS, "advice": "\x1b]0;owned\x07[red]", "filled": "#\x1b[2J", "stage": "\r\n"}
    shown = progress_of({"state": "collecting", "progress": evil})
    assert all(value.isprintable() for value in shown.values() if isinstance(value, str))
    assert progress_of({"state": "calibrated", "progress": PROGRESS}) is None
