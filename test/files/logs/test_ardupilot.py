"""ArduPilot's logs are read as raw fields; the calibration of MAG is removed."""

import re
import sys

import numpy as np
import pytest
from drives import drive
from log_writers import write_bin, write_text_log, write_tlog

from magcal_ros.core.samples import FieldSample, ImuSample, PositionSample, VelocitySample
from magcal_ros.files import FileError, logs, open_recording

pytest.importorskip("pymavlink", reason="needs pymavlink: pip install pymavlink")

SAMPLES = drive(60.0, hertz=50.0)
IMU = np.array([[*s.force, *s.rate] for s in SAMPLES if isinstance(s, ImuSample)])
FIELD = np.array([s.field for s in SAMPLES if isinstance(s, FieldSample)])
SOFT_IRON = np.array([[1.1, 0.05, 0.02], [0.05, 0.9, -0.03], [0.02, -0.03, 1.05]])


def read(path, **options):
    with open_recording(path, **options) as source:
        return source, list(source.readings())


def numbers(readings):
    imu = np.array([[*s.force, *s.rate] for s in readings if isinstance(s, ImuSample)])
    return imu, np.array([s.field for s in readings if isinstance(s, FieldSample)])


@pytest.mark.parametrize(("name", "write"), [("a.BIN", write_bin), ("a.log", write_text_log)])
def test_a_dataflash_log_gives_the_raw_measurements(tmp_path, name, write):
    path = write(tmp_path / name, SAMPLES, offsets=(120, -45, 300), matrix=SOFT_IRON)
    source, readings = read(path)
    imu, field = numbers(readings)
    assert imu == pytest.approx(IMU, abs=1e-5)
    assert field == pytest.approx(FIELD, abs=1.2e-7)  # a milligauss is 0.1 µT
    assert (source.imu_topic, source.field_topic) == ("IMU[0]", "MAG[0]")
    assert source.field_frame == "ardupilot_compass"


def test_stamps_are_converted_to_the_time_of_the_receiver(tmp_path):
    fixes = [(SAMPLES[0].stamp + 1.0, 48.1, 11.5, 3.0, 90.0)]
    source, readings = read(write_bin(tmp_path / "a.bin", SAMPLES, fixes=fixes))
    gaps = np.diff([s.stamp for s in readings if isinstance(s, ImuSample)])
    expected = np.diff([s.stamp for s in SAMPLES if isinstance(s, ImuSample)])
    assert gaps == pytest.approx(expected, abs=2e-6)
    assert 1.6e9 < source.first_stamp < 1.9e9
    assert source.place.latitude_deg == pytest.approx(48.1)
    place, moving = sorted(source.travel, key=lambda each: len(each))
    assert isinstance(place, PositionSample)
    assert isinstance(moving, VelocitySample)
    assert (moving.east, moving.north) == pytest.approx((3.0, 0.0), abs=1e-6)


def test_old_logs_have_the_sensor_number_in_the_message_name(tmp_path):
    imu, mag = "GyrX,GyrY,GyrZ,AccX,AccY,AccZ", "MagX,MagY,MagZ,OfsX,OfsY,OfsZ"
    lines = [
        "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns",
        f"FMT, 130, 31, IMU, Iffffff, TimeMS,{imu}",
        f"FMT, 131, 31, IMU2, Iffffff, TimeMS,{imu}",
        f"FMT, 132, 19, MAG2, Ihhhhhh, TimeMS,{mag}",
    ]
    for ms in (1000, 1100, 1200):
        lines += [f"{name}, {ms}, 0, 0, 0.1, 0, 0.0{ms}, -9.8" for name in ("IMU", "IMU2")]
        lines.append(f"MAG2, {ms}, {ms // 100}, 200, 300, 10, 20, 30")
    path = tmp_path / "old.log"
    path.write_text("\n".join(lines) + "\n")
    source, readings = read(path, imu="IMU[1]")
    assert (source.imu_topic, source.field_topic) == ("IMU[1]", "MAG[1]")
    assert np.diff([s.stamp for s in readings if isinstance(s, FieldSample)]) == pytest.approx(0.1)
    assert numbers(readings)[1][0] == pytest.approx([0.0, -18e-6, -27e-6], abs=1e-7)


def test_telemetry_is_read_and_unknown_offsets_are_reported(tmp_path):
    path = write_tlog(tmp_path / "a.tlog", SAMPLES, offsets=(120, -45, 300))
    source, readings = read(path)
    imu, field = numbers(readings)
    assert field == pytest.approx(FIELD, abs=1.2e-7)
    assert np.linalg.norm(imu[:, :3], axis=1) == pytest.approx(9.81, abs=0.3)
    assert not source.notes
    bare = write_tlog(tmp_path / "b.tlog", SAMPLES, with_parameters=False, raw=False)
    source, readings = read(bare)
    assert "COMPASS_OFS" in source.notes[0]
    assert numbers(readings)[1] == pytest.approx(FIELD, abs=1.2e-7)


def test_a_calibration_by_the_autopilot_is_removed_from_its_time_on(tmp_path):
    half, first = len(SAMPLES) // 2, SAMPLES[0].stamp
    one = write_text_log(tmp_path / "a.log", SAMPLES[:half], offsets=(120, -45, 300))
    options = {"offsets": (-20, 10, 30), "matrix": SOFT_IRON, "first": first}
    two = write_text_log(tmp_path / "b.log", SAMPLES[half:], **options)
    one.write_text(one.read_text() + two.read_text())
    assert numbers(read(one)[1])[1] == pytest.approx(FIELD, abs=1.2e-7)


def test_telemetry_continues_after_a_restart_of_the_autopilot(tmp_path):
    one = write_tlog(tmp_path / "a.tlog", SAMPLES, start=1.7e9)
    two = write_tlog(tmp_path / "b.tlog", SAMPLES, start=1.7e9 + 300.0)
    one.write_bytes(one.read_bytes() + two.read_bytes())
    _, readings = read(one)
    _, field = numbers(readings)
    assert field == pytest.approx(np.concatenate([FIELD, FIELD]), abs=1.2e-7)
    stamps = [s.stamp for s in readings if isinstance(s, FieldSample)]
    assert stamps[len(FIELD)] - stamps[0] == pytest.approx(300.0, abs=1e-3)


def two_compasses(sample):
    return {0: (1e-5, 0.0, 0.0), 1: sample.field}


def check_the_second_is_taken(path, fault):
    """Check that the log is read by MAG[1], and that MAG[0] is refused for its fault."""
    source, readings = read(path)
    assert source.field_topic == "MAG[1]"
    assert fault in source.notes[0]
    assert numbers(readings)[1] == pytest.approx(FIELD, abs=1.2e-7)
    with pytest.raises(FileError, match=re.escape(fault)):
        read(path, field="MAG[0]")


def test_the_first_working_compass_is_used_and_another_can_be_chosen(tmp_path):
    path = write_bin(tmp_path / "a.bin", SAMPLES, compasses=two_compasses)
    check_the_second_is_taken(path, "MAG[0] holds one value")
    with pytest.raises(FileError, match=r"no MAG\[7\]; it has: MAG\[0\], MAG\[1\]"):
        read(path, field="MAG[7]")


def both(sample):
    return {0: tuple(0.5 * np.array(sample.field)), 1: sample.field}


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"lane": (0, 1), "parameters": {"EK3_IMU_MASK": 2}}, "which the autopilot used"),
        ({"lane": (1, 1)}, "which the autopilot used"),
        (
            {"parameters": {"EK3_PRIMARY": 1, "COMPASS_PRIMARY": 1, "COMPASS_USE": 1}},
            "which the autopilot used",
        ),
        ({"parameters": {"COMPASS_USE": 0, "COMPASS_USE2": 1, "INS_USE": 0}}, "the first by"),
    ],
    ids=["mask", "lane", "primary", "switches"],
)
def test_the_sensors_used_by_the_autopilot_are_used(tmp_path, options, reason):
    path = write_bin(tmp_path / "a.bin", SAMPLES, compasses=both, imus=(0, 1), **options)
    source, readings = read(path)
    assert (source.imu_topic, source.field_topic) == ("IMU[1]", "MAG[1]")
    assert all(f"[1] is used, {reason}" in words for words in source.notes)
    imu, field = numbers(readings)
    assert field == pytest.approx(FIELD, abs=1.2e-7)
    assert imu == pytest.approx(IMU, abs=1e-5)
    source, readings = read(path, field="MAG[0]", imu="IMU[0]")
    assert not source.notes
    assert numbers(readings)[1] == pytest.approx(0.5 * FIELD, abs=1.2e-7)


@pytest.mark.parametrize("scale", [1.2, 0.0, 1.6])
def test_the_scale_is_removed_if_the_autopilot_applies_it(tmp_path, scale):
    applied = scale if 1.0 / 1.5 < scale < 1.5 else 1.0
    path = write_bin(
        tmp_path / "a.bin",
        SAMPLES,
        offsets=(120.7, -45.3, 300.2),
        matrix=SOFT_IRON,
        scale=applied,
        parameters={"COMPASS_SCALE": scale, "COMPASS_ORIENT": 6, "AHRS_ORIENTATION": 4},
    )
    # A cut number is off by half a milligauss at most, divided by matrix and scale.
    assert numbers(read(path)[1])[1] == pytest.approx(FIELD, abs=0.7e-7)


def test_motor_compensation_stays_in_the_field_and_is_reported(tmp_path):
    options = {"offsets": (120, -45, 300), "matrix": SOFT_IRON, "scale": 1.1}
    path = write_bin(
        tmp_path / "a.bin", SAMPLES, **options, motors=lambda t: (60.0 * np.sin(t), -20.0, 10.0)
    )
    source, readings = read(path)
    stamps = [s.stamp for s in SAMPLES if isinstance(s, FieldSample)]
    parts = np.array([(60.0 * np.sin(t), -20.0, 10.0) for t in stamps])
    stays = np.linalg.solve(1.1 * SOFT_IRON, parts.T).T * [1e-7, -1e-7, -1e-7]
    assert numbers(readings)[1] == pytest.approx(FIELD + stays, abs=1.1e-7)
    assert "compensation of the motors (COMPASS_MOT, up to 6." in source.notes[0]


def test_a_field_of_another_orientation_is_left_out(tmp_path):
    half, first = len(SAMPLES) // 2, SAMPLES[0].stamp
    turned = [
        s._replace(field=(-s.field[1], s.field[0], s.field[2])) if isinstance(s, FieldSample) else s
        for s in SAMPLES[:half]
    ]
    one = write_text_log(tmp_path / "a.log", turned, parameters={"COMPASS_ORIENT": 2})
    options = {"parameters": {"COMPASS_ORIENT": 0}, "first": first}
    two = write_text_log(tmp_path / "b.log", SAMPLES[half:], **options)
    one.write_text(one.read_text() + two.read_text())
    source, readings = read(one)
    expected = [s.field for s in SAMPLES[half:] if isinstance(s, FieldSample)]
    assert numbers(readings)[1] == pytest.approx(np.array(expected), abs=1.2e-7)
    assert "COMPASS_ORIENT was changed during the log" in source.notes[0]


def test_a_log_without_a_working_magnetometer_is_refused(tmp_path):
    dead = write_bin(tmp_path / "a.bin", SAMPLES, compasses=lambda _: {0: (0.0, 0.0, 0.0)})
    with pytest.raises(FileError, match=r"no working magnetometer.*COMPASS_ENABLE"):
        read(dead)
    without = write_bin(tmp_path / "b.bin", SAMPLES, compasses=lambda _: {})
    with pytest.raises(FileError, match="no MAG data: check COMPASS_ENABLE"):
        read(without)


def test_a_magnetometer_that_the_autopilot_calls_unhealthy_is_named_so(tmp_path):
    path = write_bin(tmp_path / "a.bin", SAMPLES, unhealthy=lambda *_: True)
    words = rf"calls MAG\[0\] unhealthy in all its {len(FIELD)} samples \(Health is 0\).*wiring"
    with pytest.raises(FileError, match=words):
        read(path)
    first = write_bin(
        tmp_path / "b.bin", SAMPLES, compasses=both, unhealthy=lambda number, _: number == 0
    )
    check_the_second_is_taken(first, "calls MAG[0] unhealthy in all")


def test_samples_that_are_left_out_as_unhealthy_are_counted(tmp_path):
    started = SAMPLES[0].stamp
    path = write_bin(tmp_path / "a.bin", SAMPLES, unhealthy=lambda _, stamp: stamp < started + 1.0)
    source, readings = read(path)
    left_out = len(FIELD) - len(numbers(readings)[1])
    assert 10 < left_out < len(FIELD)
    assert f"{left_out} of {len(FIELD)} samples of MAG[0] are left out" in source.notes[0]


def test_without_the_library_the_message_names_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pymavlink", None)
    with pytest.raises(FileError, match="pip install"):
        read(write_bin(tmp_path / "a.bin", SAMPLES))


@pytest.mark.faults
@pytest.mark.parametrize("name", ["a.bin", "a.log", "a.tlog", "a.ulg"])
def test_another_file_of_that_name_is_refused_with_the_reason(tmp_path, name):
    path = tmp_path / name
    path.touch()
    with pytest.raises(FileError, match="is empty"):
        read(path)
    for content in (b"\xa3\x95" + bytes(range(256)) * 30, b"FMT, 1\nFMT,", b"\0" * 9000):
        path.write_bytes(content)
        with pytest.raises(FileError, match=r"a\."):
            read(path)


@pytest.mark.faults
@pytest.mark.parametrize("content", [b"a letter, and no log\n" * 50, bytes(range(256)) * 50])
def test_another_file_is_refused_as_telemetry_without_imu(tmp_path, content):
    path = tmp_path / "a.tlog"
    path.write_bytes(content)
    with pytest.raises(FileError, match="is not a telemetry log"):
        read(path)


@pytest.mark.faults
def test_the_intact_part_of_a_damaged_log_is_read(tmp_path, capfd):
    path = write_bin(tmp_path / "a.bin", SAMPLES)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2] + b"\0" * 5000 + whole[len(whole) // 2 :])
    _, readings = read(path)
    assert len(readings) > 0.9 * len(SAMPLES)
    path.write_bytes(whole[: len(whole) // 2])
    assert len(read(path)[1]) > 0.4 * len(SAMPLES)
    assert capfd.readouterr() == ("", "")


@pytest.mark.faults
def test_size_and_time_are_limited(tmp_path, monkeypatch):
    path = write_bin(tmp_path / "a.bin", SAMPLES)
    monkeypatch.setattr(logs, "LONGEST_READING", 0.0)
    with pytest.raises(FileError, match="takes longer than 0 s"):
        read(path)
    with path.open("r+b") as handle:
        handle.truncate(logs.LARGEST_LOG + 1)
    with pytest.raises(FileError, match=r"has 1\.0 GiB"):
        read(path)
