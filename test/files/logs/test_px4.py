"""PX4's logs are read as raw fields in the body's axes."""

import itertools

import numpy as np
import pytest
from drives import drive
from log_writers import DEVICE, write_ulog
from scipy.spatial.transform import Rotation

from magcal_ros.core.samples import FieldSample, ImuSample, VelocitySample
from magcal_ros.files import RIGHT_ANGLES, FileError, mounting_of, open_recording, rotation_of

pytest.importorskip("pyulog", reason="needs pyulog: pip install pyulog")

SAMPLES = drive(60.0, hertz=50.0)
IMU = np.array([[*s.force, *s.rate] for s in SAMPLES if isinstance(s, ImuSample)])
FIELD = np.array([s.field for s in SAMPLES if isinstance(s, FieldSample)])
SCALE = np.array([[1.1, 0.05, 0.02], [0.05, 0.9, -0.03], [0.02, -0.03, 1.05]])


@pytest.mark.parametrize("raw", [True, False], ids=["raw", "corrected"])
@pytest.mark.parametrize("rotation", [0, 6, 28])
def test_a_ulog_gives_the_raw_measurements_with_any_calibration(tmp_path, raw, rotation):
    options = {"offset": (0.1, -0.2, 0.05), "scale": SCALE, "rotation": rotation, "raw": raw}
    path = write_ulog(tmp_path / "a.ulg", SAMPLES, **options)
    with open_recording(path) as source:
        readings = list(source.readings())
    imu = np.array([[*s.force, *s.rate] for s in readings if isinstance(s, ImuSample)])
    field = np.array([s.field for s in readings if isinstance(s, FieldSample)])
    assert imu == pytest.approx(IMU, abs=1e-5)
    assert field == pytest.approx(FIELD, abs=1e-10)
    assert source.field_frame == f"px4_mag1_rot{rotation}"


def field_of(path):
    with open_recording(path) as source:
        return np.array([s.field for s in source.readings() if isinstance(s, FieldSample)]), source


@pytest.mark.parametrize("raw", [True, False], ids=["raw", "corrected"])
def test_the_topic_with_more_samples_is_used(tmp_path, raw):
    """By default PX4 logs the raw field once a second, and the corrected one twice."""
    options = {"offset": (0.1, -0.2, 0.05), "scale": SCALE, "raw": raw, "every": 2}
    field, _ = field_of(write_ulog(tmp_path / "a.ulg", SAMPLES, **options))
    assert field == pytest.approx(FIELD, abs=1e-10)
    changed = write_ulog(tmp_path / "b.ulg", SAMPLES, **options, changed=("CAL_MAG1_XOFF", 0.3))
    field, _ = field_of(changed)
    expected = FIELD if raw else FIELD[1::2]
    assert field == pytest.approx(expected, abs=1e-10)


def test_a_second_magnetometer_of_unknown_rotation_is_left_out(tmp_path):
    field, source = field_of(write_ulog(tmp_path / "a.ulg", SAMPLES, other_rotation=77))
    assert field == pytest.approx(FIELD, abs=1e-10)
    assert "left out: sensor_mag[1]: the rotation 77" in source.notes[0]


CALIBRATION = {"offset": (0.1, -0.2, 0.05), "scale": SCALE}
LEVEL = {"SENS_BOARD_X_OFF": 2.5, "SENS_BOARD_Y_OFF": -1.5, "SENS_BOARD_Z_OFF": 0.5}
CUSTOM = {"CAL_MAG1_ROLL": 10.0, "CAL_MAG1_PITCH": -20.0, "CAL_MAG1_YAW": 30.0}


@pytest.mark.parametrize("raw", [True, False], ids=["raw", "corrected"])
@pytest.mark.parametrize(("rotation", "own"), [(6, (0.0, 0.0, 270.0)), (100, (10.0, -20.0, 30.0))])
def test_board_levelling_and_custom_angles_rotate_the_field(tmp_path, raw, rotation, own):
    level = Rotation.from_euler("xyz", (2.5, -1.5, 0.5), degrees=True).as_matrix()
    pose = level @ Rotation.from_euler("xyz", own, degrees=True).as_matrix()
    path = write_ulog(
        tmp_path / "a.ulg",
        SAMPLES,
        **CALIBRATION,
        raw=raw,
        pose=pose,
        parameters={**LEVEL, **CUSTOM, "CAL_MAG1_ROT": rotation},
    )
    field, source = field_of(path)
    # The frame holds hundredths of a degree.
    assert field == pytest.approx(FIELD, abs=1e-8)
    slot, mounting, name = mounting_of(source.field_frame)
    assert (slot, name[:3]) == (1, "rpy")
    assert mounting == pytest.approx(pose, abs=2e-4)


def test_the_estimate_of_the_bias_is_not_taken_for_the_field(tmp_path):
    options = {**CALIBRATION, "raw": False, "every": 2, "bias": (0.05, -0.1, 0.2)}
    field, _ = field_of(write_ulog(tmp_path / "a.ulg", SAMPLES, **options))
    assert field == pytest.approx(FIELD, abs=1e-10)


@pytest.mark.parametrize("every", [0, 2], ids=["raw", "both"])
def test_power_compensation_stays_in_the_field_if_px4_logs_it(tmp_path, every):
    compensated = {"CAL_MAG_COMP_TYP": 2, "CAL_MAG1_XCOMP": 3.0}
    options = {**CALIBRATION, "every": every, "power": lambda t: (0.05 * np.sin(t), 0.0, 0.0)}
    path = write_ulog(tmp_path / "a.ulg", SAMPLES, **options, parameters=compensated)
    field, source = field_of(path)
    stamps = np.array([s.stamp for s in SAMPLES if isinstance(s, FieldSample)])
    part = np.outer(5e-6 * np.sin(stamps), (1.0, 0.0, 0.0))
    expected = (FIELD + part)[1::2] if every else FIELD
    assert field == pytest.approx(expected, abs=1e-10)
    assert ("do not change it" if every else "the raw field only") in source.notes[0]


def test_the_selected_magnetometer_is_used(tmp_path):
    path = write_ulog(tmp_path / "a.ulg", SAMPLES, other_rotation=0, selected=77)
    _, source = field_of(path)
    assert source.field_topic == "sensor_mag[1]"
    assert "sensor_mag[1] is used, which PX4 selected" in source.notes[0]
    priorities = {"CAL_MAG0_PRIO": 75, "CAL_MAG1_PRIO": 50}
    _, source = field_of(
        write_ulog(tmp_path / "b.ulg", SAMPLES, other_rotation=0, parameters=priorities)
    )
    assert source.field_topic == "sensor_mag[1]"
    path = write_ulog(tmp_path / "c.ulg", SAMPLES, other_rotation=0, selected=DEVICE)
    assert field_of(path)[1].field_topic == "sensor_mag[0]"


def test_devices_that_share_a_topic_are_not_mixed(tmp_path):
    path = write_ulog(tmp_path / "a.ulg", SAMPLES, **CALIBRATION, raw=False, switched=True)
    rest = [s.field for s in SAMPLES[len(SAMPLES) // 2 :] if isinstance(s, FieldSample)]
    assert field_of(path)[0] == pytest.approx(np.array(rest), abs=1e-10)


def test_the_log_gives_time_place_course_and_the_yaw_of_the_autopilot(tmp_path):
    first = SAMPLES[0].stamp
    path = write_ulog(
        tmp_path / "a.ulg",
        SAMPLES,
        fixes=[(first + 1.0, 1.7e9, 48.1, 11.5, 0.0, 3.0)],
        bearings=[(first + 1.0, 90.0), (first + 1.5, np.nan), (first + 2.0, 0.0)],
    )
    with open_recording(path) as source:
        assert source.first_stamp == pytest.approx(1.7e9 - 1.0, abs=1e-3)
        assert source.place.latitude_deg == pytest.approx(48.1)
        moving = [each for each in source.travel if isinstance(each, VelocitySample)]
        assert [(each.east, each.north) for each in moving] == [(3.0, 0.0)]
        assert source.yaw[:, 1] == pytest.approx([0.0, np.pi / 2.0], abs=1e-6)


def test_rotations_are_those_of_mavlink():
    enums = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega").enums
    for number, angles in enumerate(RIGHT_ANGLES):
        words = enums["MAV_SENSOR_ORIENTATION"][number].name.split("_")
        named = dict.fromkeys(("ROLL", "PITCH", "YAW"), 0)
        named |= {a: int(b) for a, b in itertools.pairwise(words) if a in named}
        assert tuple(named.values()) == angles


def test_an_unknown_rotation_is_an_error():
    with pytest.raises(FileError, match="rotation 77"):
        rotation_of(77)


def test_a_log_without_a_working_magnetometer_is_refused(tmp_path):
    hanging = [
        s._replace(field=(1e-5, 2e-5, 3e-5)) if isinstance(s, FieldSample) else s for s in SAMPLES
    ]
    with (
        pytest.raises(FileError, match=r"no working magnetometer.*SYS_HAS_MAG"),
        open_recording(write_ulog(tmp_path / "a.ulg", hanging)),
    ):
        pass


@pytest.mark.faults
def test_the_intact_part_of_a_damaged_log_is_read_or_it_is_refused(tmp_path, capsys):
    path = write_ulog(tmp_path / "a.ulg", SAMPLES)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with open_recording(path) as source:
        assert len(list(source.readings())) > 0.4 * len(SAMPLES)
    path.write_bytes(whole[:300] + b"\xff" * 3000)
    with pytest.raises(FileError, match=r"a\.ulg"), open_recording(path):
        pass
    assert capsys.readouterr() == ("", "")
