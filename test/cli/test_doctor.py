import json
import re

import numpy as np
import pytest
import yaml
from axes_cases import cheap_robot, wrong_case
from drives import write_bag
from imu_faults_cases import good_case
from long_form import first_of
from scipy.spatial.transform import Rotation

from magcal_ros.cli.doctor import write_parameters
from magcal_ros.cli.main import main
from magcal_ros.core.doctor import SensorReport
from magcal_ros.core.geometry import signed_permutations
from magcal_ros.core.samples import FieldSample, ImuSample

NED = np.diag([1.0, -1.0, -1.0])


def record(folder, axes, scale=1.0, every=2):
    window, knowledge = wrong_case(axes, np.random.default_rng(2), "lift")
    window = window.take(np.arange(0, len(window), every))
    folder.mkdir()
    # Without the bias of this robot's gyro, which the turn shows, too.
    rate = window.angular_rate - cheap_robot(np.random.default_rng(2), axes).gyro_bias
    imu = np.column_stack([window.time + 1.0, window.specific_force, rate])
    mag = np.column_stack([window.time + 1.0, scale * window.field])
    for name, rows, head in (
        ("imu.csv", imu, "t,ax,ay,az,gx,gy,gz"),
        ("mag.csv", mag, "t,mx,my,mz"),
    ):
        np.savetxt(folder / name, rows, delimiter=",", header=head, comments="", fmt="%.12g")
    inclination = np.degrees(knowledge.reference.inclination.value)
    return [str(folder), "--reference-inclination-deg", f"{inclination:.2f}"]


def test_good_sensors_have_no_fault(tmp_path, capsys):
    file = tmp_path / "params.yaml"
    assert main(["doctor", *record(tmp_path / "bag", np.eye(3)), "--write", str(file)]) == 0
    printed = capsys.readouterr().out
    assert "No file is written: no fault was found that a parameter corrects." in printed
    assert not file.exists()
    assert "x forward, y left, z up" in printed
    assert "wrong" not in printed
    assert "What to do" not in printed


def test_a_wrong_unit_is_reported_once_in_published_numbers(tmp_path, capsys):
    assert main(["doctor", *record(tmp_path / "bag", np.eye(3), scale=1e6)]) == 4
    printed = capsys.readouterr().out
    assert printed.count("looks like microtesla published as tesla") == 1
    assert re.search(r"field: unit +\d\d\.\d ± [\d.]+ T as published, without", printed)
    assert "e+" not in printed


def test_the_orientation_in_a_bag_is_compared_with_the_field(tmp_path, capsys):
    log = good_case(np.random.default_rng(3), "turn").log
    turned = Rotation.from_rotvec([0.0, 0.0, 2.0]) * Rotation.from_quat(log.orientation)
    rows = zip(log.imu_time, log.force, log.rate, turned.as_quat(), strict=True)
    samples = [ImuSample(t, *(tuple(values.tolist()) for values in row)) for t, *row in rows]
    samples += [FieldSample(*row) for row in zip(log.field_time, log.field, strict=True)]
    path = write_bag(tmp_path / "bag", sorted(samples, key=lambda sample: sample.stamp))
    assert main(["doctor", str(path)]) == 0
    printed = capsys.readouterr().out
    assert re.search(r"look  IMU: orientation +its yaw is \+11\d ± \d° off .* BNO08x", printed), (
        printed
    )


def test_the_parameter_to_change_is_printed_and_written(tmp_path, capsys, axes_alone):
    file = tmp_path / "\x1b[31mparams.yaml"
    assert main(["doctor", *record(tmp_path / "bag", NED), "--write", str(file)]) == 4
    printed = capsys.readouterr().out
    assert "mount_rpy_deg: [180.0, 0.0, 0.0]" in printed
    assert (
        f"Written: {tmp_path}/?[31mparams.yaml. Start the calibrator with `--params-file" in printed
    )
    assert "(after `--ros-args`), and calibrate again." in printed
    content = yaml.safe_load(file.read_text())
    assert content["/**"]["ros__parameters"] == {"mount_rpy_deg": [180.0, 0.0, 0.0]}


def test_a_fault_that_no_mounting_corrects_is_not_written(tmp_path, capsys, axes_alone):
    file = tmp_path / "params.yaml"
    arguments = record(tmp_path / "bag", signed_permutations()[24])
    assert main(["doctor", *arguments, "--json", "--write", str(file)]) == 4
    printed = json.loads(capsys.readouterr().out)
    assert printed["mount_rpy_deg"] is None
    assert any("mirrored" in finding["remedy"] for finding in printed["findings"])
    assert not file.exists()


def test_an_existing_file_is_not_overwritten(tmp_path, capsys, axes_alone):
    file = tmp_path / "params.yaml"
    file.write_text("mine")
    assert main(["doctor", *record(tmp_path / "bag", NED), "--write", str(file)]) == 5
    assert file.read_text() == "mine"


def test_too_little_data_is_reported(tmp_path, capsys):
    arguments = record(tmp_path / "bag", NED)
    assert main(["doctor", *arguments, "--to", "0.5"]) == 3
    assert "Too little data" in capsys.readouterr().out


@pytest.mark.parametrize("value", ["nan", "0"])
@pytest.mark.parametrize(("name", "sensor"), [("imu", "IMU"), ("mag", "field")])
def test_a_sensor_without_any_value_is_wrong(tmp_path, capsys, name, sensor, value):
    arguments = record(tmp_path / "bag", np.eye(3))
    path = tmp_path / "bag" / f"{name}.csv"
    first, *rows = path.read_text().splitlines()
    rows = [",".join([row.split(",")[0]] + [value] * first.count(",")) for row in rows]
    path.write_text("\n".join([first, *rows]) + "\n")
    assert main(["doctor", *arguments]) == 4
    printed = capsys.readouterr().out
    assert f"{sensor}: values" in printed
    assert f"0 of {len(rows)} samples hold a value" in printed
    assert "the driver reads nothing: check the wiring" in printed


def test_a_recording_excludes_the_live_option(tmp_path, capsys):
    assert main(["doctor", *record(tmp_path / "bag", np.eye(3)), "--live"]) == 2
    assert "leave out --live" in capsys.readouterr().err


def test_the_given_direction_of_the_turn_is_used(tmp_path, capsys):
    # All sensors agree on the direction of the turn: the user may have turned the other way.
    arguments = record(tmp_path / "bag", np.eye(3))
    printed = []
    for side in ("left", "right"):
        assert main(["doctor", *arguments, "--json", "--turned", side]) == 0
        printed.append("z of all sensors points down" in capsys.readouterr().out)
    assert sorted(printed) == [False, True]


def test_known_gains_are_written_with_the_mounting(tmp_path):
    report = SensorReport((), (180, 0, 0))
    file = tmp_path / "params.yaml"
    assert write_parameters(file, report, np.array([1.0, 1.05, 0.98])) == str(file)
    content = yaml.safe_load(file.read_text())["/**"]["ros__parameters"]
    assert content == {"mount_rpy_deg": [180.0, 0.0, 0.0], "soft_iron_gains": [1.0, 1.05, 0.98]}
    assert write_parameters(tmp_path / "other.yaml", SensorReport(()), None) is None
    assert not (tmp_path / "other.yaml").exists()


def test_bursts_are_reported_once_with_the_mean_rate(tmp_path, capsys):
    arguments = record(tmp_path / "csv", np.eye(3))
    for name in ("imu.csv", "mag.csv"):
        head, *rows = (tmp_path / "csv" / name).read_text().splitlines()
        stamps = np.array([float(row.partition(",")[0]) for row in rows])
        read = (stamps // 0.9 + 1.0) * 0.9 + 0.02 * (stamps % 0.9)
        late = [
            f"{stamp:.6f},{row.partition(',')[2]}" for stamp, row in zip(read, rows, strict=True)
        ]
        (tmp_path / "csv" / name).write_text("\n".join([head, *late]) + "\n")
    rate = (len(read) - 1) / (read[-1] - read[0])
    assert main(["doctor", *arguments]) == 4
    printed = capsys.readouterr().out
    assert f"{rate:.1f} Hz in bursts" in printed
    assert printed.count("the stamps come in bursts") == 1
    assert "IMU: stamps and field: stamps: the stamps come in bursts" in printed
    assert "look  recording" not in printed


@pytest.mark.parametrize("method", first_of(["design_tip", "maximum_likelihood"]))
def test_the_option_named_by_a_refused_fit_corrects_it(tmp_path, capsys, monkeypatch, method):
    monkeypatch.chdir(tmp_path)
    arguments = [*record(tmp_path / "bag", NED, every=3), "--method", method]
    assert main(["fit", *arguments, "--output", "refused"]) == 4
    (option,) = set(
        re.findall(r"repeat with `(--[^`]*)`", " ".join(capsys.readouterr().out.split()))
    )
    assert option == "--mount-rpy-deg 180 0 0"
    assert main(["fit", *arguments, *option.split(), "--output", "mended"]) == 0
