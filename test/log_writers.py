"""Logs of autopilots and phones, written by the public documents of their formats."""

import struct

import numpy as np

from magcal_ros.core.samples import FieldSample, ImuSample
from magcal_ros.files import rotation_of

FRD = np.diag([1.0, -1.0, -1.0])
MILLIGAUSS, GAUSS = 1e7, 1e4
BOOT_US, WEEK, LEAP = 5_000_000, 2300, 18
"""Of the log's first sample; GPS week of its time."""

FORMATS = {
    "FMT": (128, "BBnNZ", "Type,Length,Name,Format,Columns"),
    "PARM": (129, "QNf", "TimeUS,Name,Value"),
    "IMU": (130, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "MAG": (
        131,
        "QBhhhhhhhhhB",
        "TimeUS,I,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOX,MOY,MOZ,Health",
    ),
    "GPS": (
        132,
        "QBBIHBcLLeffffB",
        "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U",
    ),
    "ATT": (133, "QccccCC", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw"),
    "XKFS": (134, "QBBBBB", "TimeUS,C,MI,BI,GI,AI"),
    "XKF4": (135, "QBb", "TimeUS,C,PI"),
}  # fmt: skip
STRUCT = {"B": "B", "b": "b", "n": "4s", "N": "16s", "Z": "64s", "Q": "Q", "f": "f", "h": "h",
          "H": "H", "I": "I", "L": "i", "c": "h", "C": "H", "e": "i"}  # fmt: skip
SCALED = {"L": 1e7, "c": 100.0, "C": 100.0, "e": 100.0}


def logged(field, offsets, matrix, scale=1.0, motors=(0.0, 0.0, 0.0)):
    """The corrected field of ArduPilot, mG, of a raw one in tesla, forward-left-up.

    AP_Compass_Backend::correct_field: offsets, scale, matrix, then the part of the motors.
    """
    return matrix @ (scale * (MILLIGAUSS * FRD @ np.asarray(field) + offsets)) + np.asarray(motors)


def ardupilot_rows(
    samples,
    offsets=(0, 0, 0),
    matrix=None,
    compasses=None,
    fixes=(),
    yaws=(),
    first=None,
    slot="",
    scale=1.0,
    motors=None,
    parameters=(),
    lane=None,
    imus=(0,),
    unhealthy=lambda number, stamp: False,
):
    """Name and values of every message.

    `compasses` gives the fields of several by number, `yaws` stamp and compass bearing in degrees.
    `first` is the stamp at which the log began; None at the first sample. The calibration has the
    parameters of `slot`, `motors` gives its part of the motors (mG) by stamp. `parameters` are
    others. `lane` is the EKF's lane and its compass; of the IMUs the last one tells the truth.
    `unhealthy` says of a compass's number and a stamp whether its Health is 0.
    """
    matrix = np.eye(3) if matrix is None else matrix
    started = min(sample.stamp for sample in samples)
    first = started if first is None else first

    def at(stamp):
        return BOOT_US + round((stamp - first) * 1e6)

    named = [(f"COMPASS_OFS{slot}_{a}", v) for a, v in zip("XYZ", offsets, strict=True)]
    named += [(f"COMPASS_DIA{slot}_{a}", matrix[k, k]) for k, a in enumerate("XYZ")]
    pairs = zip("XYZ", ((0, 1), (0, 2), (1, 2)), strict=True)
    named += [(f"COMPASS_ODI{slot}_{a}", matrix[k]) for a, k in pairs]
    named += [(f"COMPASS_SCALE{slot}", scale), *dict(parameters).items()]
    yield from (("PARM", (at(started), name, float(value))) for name, value in named)
    if lane is not None:
        for number, compass in ((lane[0], lane[1]), (1 - lane[0], 1 - lane[1])):
            yield "XKFS", (at(started), number, compass, 0, 0, 0)
            yield "XKF4", (at(started), number, lane[0])
    for fix in fixes:  # stamp, latitude, longitude, speed, course (deg)
        stamp, latitude, longitude, speed, course = fix
        gms = round((stamp - first) * 1e3) + 100_000
        values = (at(stamp), 0, 3, gms, WEEK, 9, 1.0, latitude, longitude, 10.0, speed, course)
        yield "GPS", (*values, 0.0, 0.0, 1)
    for stamp, bearing in yaws:
        yield "ATT", (at(stamp), 0.0, 0.0, 0.0, 0.0, 0.0, bearing % 360.0)
    for sample in samples:
        if isinstance(sample, ImuSample):
            for k in imus:
                share = 1.0 if k == imus[-1] else 0.5
                rate, force = share * FRD @ np.asarray(sample.rate), FRD @ np.asarray(sample.force)
                yield "IMU", (at(sample.stamp), k, *rate, *force)
            continue
        fields = {0: sample.field} if compasses is None else compasses(sample)
        part = (0.0, 0.0, 0.0) if motors is None else motors(sample.stamp)
        for number, field in fields.items():
            milli = np.trunc(logged(field, offsets, matrix, scale, part)).astype(int)
            others = np.trunc([*offsets, *part]).astype(int)  # cut, not rounded, by a cast in C++
            health = int(not unhealthy(number, sample.stamp))
            yield "MAG", (at(sample.stamp), number, *milli, *others, health)


def _packed(name, values):
    kind, columns, _ = FORMATS[name]
    out = []
    for letter, value in zip(columns, values, strict=True):
        if letter in "nNZ":
            out.append(value.encode())
        else:
            value = round(value * SCALED[letter]) if letter in SCALED else value
            out.append(value if letter in "f" else int(value))
    form = "<" + "".join(STRUCT[letter] for letter in columns)
    return b"\xa3\x95" + bytes([kind]) + struct.pack(form, *out)


def _format_rows():
    for name, (kind, columns, labels) in FORMATS.items():
        size = 3 + struct.calcsize("<" + "".join(STRUCT[letter] for letter in columns))
        yield "FMT", (kind, size, name, columns, labels)


def write_bin(path, samples, **options):
    rows = [*_format_rows(), *ardupilot_rows(samples, **options)]
    path.write_bytes(b"".join(_packed(name, values) for name, values in rows))
    return path


def write_text_log(path, samples, **options):
    rows = [*_format_rows(), *ardupilot_rows(samples, **options)]
    lines = (", ".join([name, *map(str, values)]) for name, values in rows)
    path.write_text("\n".join(lines) + "\n")
    return path


def write_tlog(path, samples, offsets=(0, 0, 0), with_parameters=True, start=1.7e9, raw=True):
    """Write telemetry, in which SCALED_IMU repeats RAW_IMU; the latter may be missing."""
    from pymavlink.dialects.v20 import ardupilotmega as mavlink

    link = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    first = min(sample.stamp for sample in samples)
    out = []

    def send(stamp, message):
        micros = round((start + stamp - first) * 1e6)
        out.append(struct.pack(">Q", micros) + message.pack(link))

    if with_parameters:
        for axis, value in zip("XYZ", offsets, strict=True):
            name = f"COMPASS_OFS_{axis}".encode()
            send(first, mavlink.MAVLink_param_value_message(name, value, 9, 3, 0))
    imu = None
    for sample in samples:
        if isinstance(sample, ImuSample):
            imu = sample
        elif imu is not None:
            force = np.round(FRD @ np.asarray(imu.force) / 9.80665e-3).astype(int)
            rate = np.round(FRD @ np.asarray(imu.rate) * 1e3).astype(int)
            field = np.trunc(logged(sample.field, offsets, np.eye(3))).astype(int)
            micros = BOOT_US + round((sample.stamp - first) * 1e6)
            values = tuple(map(int, (*force, *rate, *field)))
            if raw:
                send(sample.stamp, mavlink.MAVLink_raw_imu_message(micros, *values))
            send(sample.stamp, mavlink.MAVLink_scaled_imu_message(micros // 1000, *values))
    path.write_bytes(b"".join(out))
    return path


def _message(kind, data):
    return struct.pack("<HB", len(data), ord(kind)) + data


def _parameter(name, value):
    is_whole = isinstance(value, int)
    key = f"{'int32_t' if is_whole else 'float'} {name}".encode()
    return _message("P", bytes([len(key)]) + key + struct.pack("<i" if is_whole else "<f", value))


ULOG_FORMATS = {
    "sensor_combined": "uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;",
    "sensor_mag": "uint64_t timestamp;uint32_t device_id;float x;float y;float z;",
    "vehicle_magnetometer": "uint64_t timestamp;uint32_t device_id;float[3] magnetometer_ga;",
    "vehicle_attitude": "uint64_t timestamp;float[4] q;",
    "vehicle_gps_position": "uint64_t timestamp;uint64_t time_utc_usec;int32_t lat;int32_t lon;"
    "int32_t alt;float vel_n_m_s;float vel_e_m_s;uint8_t fix_type;",
}
RARE_FORMATS = {
    "estimator_status": "uint64_t timestamp;uint32_t mag_device_id;",
    "magnetometer_bias_estimate": "uint64_t timestamp;float[4] bias_x;float[4] bias_y;"
    "float[4] bias_z;bool[4] valid;",
}
DEVICE = 3_000_000_123
"""Above the largest signed number, as devices on CAN are."""


def write_ulog(
    path,
    samples,
    offset=(0.0, 0.0, 0.0),
    scale=None,
    rotation=0,
    raw=True,
    fixes=(),
    bearings=(),
    every=0,
    other_rotation=None,
    changed=None,
    parameters=(),
    pose=None,
    bias=None,
    power=None,
    selected=None,
    switched=False,
):
    """Write a ULog whose first magnetometer has these CAL_MAG1 parameters, gauss.

    `fixes` are stamp, UTC (s), latitude, longitude, velocity north and east; `bearings` are stamp
    and degrees. With `every` the other topic of the field has one in so many samples. A second
    magnetometer has `other_rotation`. `changed` is a parameter and its value from half on.
    `parameters` are others, `pose` the rotation to the body that they make. `bias` (body, gauss) is
    taken off the corrected field from a third on, `power` (gauss, by stamp) is added to the raw
    one. `selected` is the device that is used. In a log that `switched` the corrected topic shows
    another device up to half.
    """
    scale = np.eye(3) if scale is None else scale
    pose = rotation_of(rotation) if pose is None else pose
    first = min(sample.stamp for sample in samples)
    out = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", BOOT_US), _message("B", bytes(40))]
    rare = {} if selected is None else {"estimator_status": 10}
    rare |= {} if bias is None else {"magnetometer_bias_estimate": 11}
    formats = ULOG_FORMATS | {name: RARE_FORMATS[name] for name in rare}
    out += [_message("F", f"{name}:{form}".encode()) for name, form in formats.items()]
    named = {"CAL_MAG1_ID": DEVICE - (1 << 32), "CAL_MAG1_ROT": rotation}
    for k, axis in enumerate("XYZ"):
        named[f"CAL_MAG1_{axis}OFF"] = float(offset[k])
        named[f"CAL_MAG1_{axis}SCALE"] = float(scale[k, k])
        named[f"CAL_MAG1_{axis}ODIAG"] = float(scale[((0, 1), (0, 2), (1, 2))[k]])
    out += [_parameter(*each) for each in {**named, **dict(parameters)}.items()]
    if other_rotation is not None:
        out += [_parameter("CAL_MAG0_ID", 77), _parameter("CAL_MAG0_ROT", other_rotation)]
    both = ("sensor_mag", "vehicle_magnetometer") if raw else ("vehicle_magnetometer", "sensor_mag")
    topics = ["sensor_combined", both[0], "vehicle_gps_position", "vehicle_attitude"]
    topics += [both[1]] * (every > 0)
    for number, name in enumerate(topics):
        out.append(_message("A", struct.pack("<BH", 0, number) + name.encode()))
    if other_rotation is not None:
        out.append(_message("A", struct.pack("<BH", 1, 9) + b"sensor_mag"))
    for name, number in rare.items():
        out.append(_message("A", struct.pack("<BH", 0, number) + name.encode()))
    if selected is not None:
        out.append(_message("D", struct.pack("<HQI", 10, BOOT_US, selected)))
    third, taken_off = samples[len(samples) // 3].stamp, np.zeros(3)
    fields = 0
    for count, sample in enumerate(samples):
        micros = BOOT_US + round((sample.stamp - first) * 1e6)
        if changed is not None and count == len(samples) // 2:
            out.append(_parameter(*changed))
        if isinstance(sample, FieldSample):
            if bias is not None and sample.stamp > third and not taken_off.any():
                taken_off = np.asarray(bias)
                rows = np.zeros((3, 4))
                rows[:, 0] = bias
                estimate = (*rows.ravel(), True, False, False, False)
                out.append(_message("D", struct.pack("<HQ12f4?", 11, micros, *estimate)))
            own = pose.T @ FRD @ np.asarray(sample.field) * GAUSS
            part = np.zeros(3) if power is None else np.asarray(power(sample.stamp))
            corrected = pose @ scale @ (own + part - np.asarray(offset)) - taken_off
            if switched and count < len(samples) // 2:
                other = struct.pack("<HQI3f", 1, micros, 77, 0.1, 0.2, 0.3)
                out.append(_message("D", other))
                continue
            shown, others = (own, corrected) if raw else (corrected, own)
            data = struct.pack("<HQI3f", 1, micros, DEVICE, *shown)
            fields += 1
            if every and fields % every == 0:
                out.append(_message("D", struct.pack("<HQI3f", 4, micros, DEVICE, *others)))
            if other_rotation is not None:
                out.append(_message("D", struct.pack("<HQI3f", 9, micros, 77, *own)))
        else:
            rate, force = FRD @ np.asarray(sample.rate), FRD @ np.asarray(sample.force)
            data = struct.pack("<HQ6f", 0, micros, *rate, *force)
        out.append(_message("D", data))
    for stamp, utc, latitude, longitude, *velocity in fixes:
        micros, place = BOOT_US + round((stamp - first) * 1e6), (latitude, longitude)
        whole = (round(1e7 * angle) for angle in place)
        numbers = (2, micros, round(utc * 1e6), *whole, 10_000, *velocity, 3)
        out.append(_message("D", struct.pack("<HQQ3i2fB", *numbers)))
    for stamp, bearing in bearings:
        micros, half = BOOT_US + round((stamp - first) * 1e6), np.radians(0.5 * bearing)
        quaternion = (np.cos(half), 0.0, 0.0, np.sin(half))
        out.append(_message("D", struct.pack("<HQ4f", 3, micros, *quaternion)))
    path.write_bytes(b"".join(out))
    return path


def phone_tables(samples):
    """Rows of acceleration, rate and field (µT) in a phone's axes: x right, y up, z out."""
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    imu = [each for each in samples if isinstance(each, ImuSample)]
    mag = [each for each in samples if isinstance(each, FieldSample)]
    return (
        np.array([[s.stamp, *turn @ s.force] for s in imu]),
        np.array([[s.stamp, *turn @ s.rate] for s in imu]),
        np.array([[s.stamp, *turn @ s.field * 1e6] for s in mag]),
    )


def write_sensor_logger(path, samples, ios=False):
    path.mkdir()
    force, rate, field = phone_tables(samples)
    tables = {"Gyroscope": rate, "MagnetometerUncalibrated": field}
    if ios:
        still = force.copy()
        still[:, 1:] = 0.0
        force[:, 1:] *= -1.0
        tables |= {"Accelerometer": still, "Gravity": force}
    else:
        tables |= {"TotalAcceleration": force}
    for name, table in tables.items():
        lines, rows = ["time,seconds_elapsed,z,y,x"], table.tolist()
        lines += [
            f"{round(t * 1e9)},{t - rows[0][0]!r},{z!r},{y!r},{x!r}"
            for t, x, y, z in table.tolist()
        ]
        (path / f"{name}.csv").write_text("\n".join(lines) + "\n")
    platform = "ios" if ios else "android"
    (path / "Metadata.csv").write_text(
        "version,device name,recording epoch time,platform,standardisation\n"
        f"3,Phone,1700000000000,{platform},false\n"
    )
    return path


def write_phyphox(path, samples, separator=",", point="."):
    path.mkdir()
    force, rate, field = phone_tables(samples)
    for name, what, unit, table in (
        ("Accelerometer", "Acceleration", "m/s^2", force),
        ("Gyroscope", "Gyroscope", "rad/s", rate),
        ("Magnetometer", "Magnetic field", "µT", field),
    ):
        head = ['"Time (s)"', *(f'"{what} {axis} ({unit})"' for axis in "xyz")]
        rows = [separator.join(f"{v:.9E}".replace(".", point) for v in row) for row in table]
        (path / f"{name}.csv").write_text("\n".join([separator.join(head), *rows]) + "\n")
    return path
