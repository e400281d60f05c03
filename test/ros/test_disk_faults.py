"""A node that calibrates with a full, read-only or unusable disk."""

import os
import subprocess
from types import SimpleNamespace

import pytest
import yaml
from support import PATIENCE, REFERENCE, store_calibration

from magcal_ros.files import FileError
from magcal_ros.ros.calibration_store import CalibrationStore

pytestmark = pytest.mark.faults


@pytest.fixture
def small_disk(tmp_path):
    """Return a file system of its own with a megabyte."""
    place = tmp_path / "disk"
    place.mkdir()
    mounting = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(place)]
    if os.geteuid() or subprocess.run(mounting, capture_output=True, check=False).returncode:
        pytest.skip("a file system of its own needs the right to mount one")
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)


def fill(place):
    with (place / "filler").open("wb", buffering=0) as filler:
        try:
            while True:
                filler.write(b"x" * 4096)
        except OSError:
            pass


def test_a_full_or_read_only_disk_keeps_the_old_file_and_is_reported(stage, small_disk):
    path = store_calibration(small_disk / "calibration.yaml")
    before = path.read_bytes()
    actor = stage(
        parameters={
            **REFERENCE,
            "calibration_file": str(path),
            "report_folder": str(small_disk / "reports"),
        },
        speed=8.0,
    )
    fill(small_disk)
    answer = actor.calibrate()
    assert not answer.success
    saved = f"In force until the node ends, but not saved: cannot write {path}: No space left"
    assert answer.message.startswith(saved)
    assert "Then call ~/save. Calibrated, " in answer.message
    assert path.read_bytes() == before
    actor.run(PATIENCE, stop=lambda: actor.yaws)
    assert actor.yaws
    (small_disk / "filler").unlink()
    subprocess.run(["mount", "-o", "remount,ro", str(small_disk)], check=True)
    refused = actor.answer(actor.call("save"))
    assert not refused.success
    assert "Read-only file system" in refused.message
    assert path.read_bytes() == before
    subprocess.run(["mount", "-o", "remount,rw", str(small_disk)], check=True)
    assert actor.answer(actor.call("save")).success
    assert path.read_bytes() != before
    assert not list(small_disk.glob(".*"))


@pytest.mark.parametrize(
    "chosen", ["~nobody_of_this_name/cal.yaml", "/tmp/" + "x" * 300 + ".yaml", "/proc/self/mem/x"]
)
def test_an_impossible_path_does_not_delay_the_start(stage, chosen):
    actor = stage(parameters={**REFERENCE, "calibration_file": chosen, "report_folder": chosen})
    assert actor.status["state"] == "uncalibrated"
    for service in ("load", "save"):
        assert not actor.answer(actor.call(service)).success


@pytest.mark.parametrize("entry", ["hard_iron", "correction_matrix", "covariance"])
def test_a_file_with_impossible_numbers_is_not_put_in_force(tmp_path, entry):
    path = store_calibration(tmp_path / "calibration.yaml")
    document = yaml.safe_load(path.read_text())
    if entry == "hard_iron":
        document[entry] = [1e300, 0.0, 0.0]
        document |= {"magnetometer_bias_x": 1e300, "magnetometer_bias_y": 0.0}
        document["magnetometer_bias_z"] = 0.0
    else:
        document[entry][0][0] = 1e300
    path.write_text(yaml.safe_dump(document))
    applied = []
    chosen = str(path)
    node = SimpleNamespace(get_logger=lambda: None)
    store = CalibrationStore(node, None, lambda *what: applied.append(what), lambda: chosen)
    with pytest.raises(FileError, match=f"{entry} .*1e\\+300"):
        store.read(str(path), "mag_link")
    assert not applied
