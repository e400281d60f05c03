"""Each turn gives a report, drawn outside the node (accepted turns: test_hostile_names)."""

import time

import pytest
from support import PATIENCE, REFERENCE


def wait_for(path, patience=PATIENCE):
    deadline = time.monotonic() + patience
    while not path.exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    return path.exists()


REPORTING = {**REFERENCE, "report_folder": ""}


@pytest.mark.nightly
def test_a_refused_turn_gives_a_report_and_nothing_is_overwritten(stage, ros_home):
    actor = stage(parameters={**REPORTING, "window.timeout_s": 2.0})
    for _ in range(2):
        assert not actor.calibrate(yaw_rate=0.0).success
    folders = list((ros_home / "magcal" / "reports").iterdir())
    assert len(folders) == 2
    assert all(wait_for(folder / "report.html") for folder in folders)


@pytest.mark.nightly
def test_reports_can_be_switched_off(stage, ros_home):
    actor = stage(parameters={**REFERENCE, "report_folder": "none"})
    assert "Report" not in actor.calibrate().message
    assert not (ros_home / "magcal" / "reports").exists()


@pytest.mark.nightly
def test_an_unwritable_folder_is_reported(stage):
    actor = stage(parameters={**REFERENCE, "report_folder": "/proc/nowhere"})
    answer = actor.calibrate()
    assert answer.success
    assert "No report" in answer.message
