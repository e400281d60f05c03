"""A bag larger than memory is streamed: memory does not grow with its length."""

import shutil
import subprocess
import sys

import numpy as np
import pytest
from drives import STORE2, drive, message
from long_form import first_of, rounds
from rosbags.rosbag2 import StoragePlugin, Writer

pytestmark = pytest.mark.faults

MEGABYTE = 1_000_000
PICTURES = rounds(70, 10_000)
"""Of a megabyte each, between the sensors' messages."""

READ = """
import resource, sys
from pathlib import Path
from magcal_ros.files.sources import open_recording
import rosbags.highlevel, rosbags.typesys
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
with open_recording(Path(sys.argv[1])) as source:
    count = sum(1 for _ in source.readings())
print(count, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


def write_long_bag(path, samples, plugin):
    kinds = STORE2.types
    picture = kinds["sensor_msgs/msg/Image"]
    pixels = np.random.default_rng(1).integers(0, 256, MEGABYTE, dtype=np.uint8)
    with Writer(path, version=8, storage_plugin=plugin) as writer:
        connections = {
            kind: writer.add_connection(topic, kind, typestore=STORE2)
            for topic, kind in (
                ("/imu/data_raw", "sensor_msgs/msg/Imu"),
                ("/imu/mag", "sensor_msgs/msg/MagneticField"),
                ("/camera", "sensor_msgs/msg/Image"),
            )
        }
        written = 0
        for number, sample in enumerate(samples):
            stamp = round(sample.stamp * 1e9)
            content = message(STORE2, sample)
            kind = content.__msgtype__
            writer.write(connections[kind], stamp, STORE2.serialize_cdr(content, kind))
            while written < PICTURES * (number + 1) // len(samples):
                image = picture(content.header, 1000, 1000, "mono8", 0, 1000, pixels)
                data = STORE2.serialize_cdr(image, image.__msgtype__)
                writer.write(connections[image.__msgtype__], stamp, data)
                written += 1


@pytest.mark.parametrize("plugin", first_of([StoragePlugin.MCAP, StoragePlugin.SQLITE3]))
def test_memory_does_not_grow_with_the_bag(tmp_path, plugin):
    samples = drive(400.0)
    path = tmp_path / "bag"
    write_long_bag(path, samples, plugin)
    assert sum(file.stat().st_size for file in path.iterdir()) > PICTURES * MEGABYTE
    done = subprocess.run(
        [sys.executable, "-c", READ, str(path)], capture_output=True, text=True, check=True
    )
    count, kilobytes = map(int, done.stdout.split())
    assert count == len(samples)
    assert kilobytes < 50_000
    shutil.rmtree(path)
