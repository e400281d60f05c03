import math
import struct

import numpy as np
import pytest
from by_message import field_sample, imu_sample
from drives import FIELD, IMU, STORE1, STORE2, drive, message, write_bag

from magcal_ros.core.samples import FieldSample, ImuSample
from magcal_ros.files import open_recording, wire

IMU_SAMPLE, FIELD_SAMPLE = drive(10.0)[:2]


def packed(store, content, kind, **options):
    serialize = store.serialize_ros1 if store is STORE1 else store.serialize_cdr
    return bytes(serialize(content, kind, **options))


@pytest.mark.parametrize("frame", ["", "a", "imu", "imu_link", "ä" * 7, "x" * 101])
@pytest.mark.parametrize(("store", "form"), [(STORE1, wire.ROS1), (STORE2, wire.CDR)])
def test_bytes_by_the_library_are_read(store, form, frame):
    imu, field = message(store, IMU_SAMPLE, frame), message(store, FIELD_SAMPLE, frame)
    data = packed(store, imu, IMU)
    assert form.imu(data) == (frame, imu_sample(imu), data[4:12])
    data = packed(store, field, FIELD)
    covariance = field.magnetic_field_covariance.tobytes()
    assert form.field(data) == (frame, field_sample(field), data[4:12], covariance)


def test_marks_of_absence_are_understood():
    parse = wire.CDR.imu
    gyroless = message(STORE2, IMU_SAMPLE._replace(rate=(math.nan,) * 3))
    assert all(math.isnan(value) for value in parse(packed(STORE2, gyroless, IMU)).sample.rate)
    gyroless.linear_acceleration_covariance = np.r_[-1.0, np.zeros(8)]
    assert parse(packed(STORE2, gyroless, IMU)).sample is None


def test_truncated_bytes_are_an_error():
    data = packed(STORE2, message(STORE2, FIELD_SAMPLE), FIELD)
    for size in range(len(data)):
        with pytest.raises((struct.error, IndexError)):
            wire.CDR.field(data[:size])


def test_the_other_byte_order_is_read_by_the_library(tmp_path, monkeypatch):
    little, usual = STORE2.serialize_cdr, drive(10.0)
    monkeypatch.setattr(
        STORE2, "serialize_cdr", lambda content, kind: little(content, kind, little_endian=False)
    )
    path = write_bag(tmp_path / "bag", usual)
    with open_recording(path) as source:
        readings = list(source.readings())
    assert [r[1:] for r in readings] == [s[1:] for s in usual]
    assert {type(r) for r in readings} == {ImuSample, FieldSample}
    assert (source.imu_frame, source.field_frame) == ("imu_link", "mag_link")
