"""Where compass_interfaces is installed, the yaw is published as its Azimuth, too."""

import math
import struct
import sys
from types import ModuleType, SimpleNamespace

import pytest
from std_msgs.msg import Header

from magcal_ros.core import Belief, ReferenceField
from magcal_ros.core.heading import CompassReading, Heading
from magcal_ros.ros.outputs import HeadingOutput
from magcal_ros.ros.wire import azimuth_message

HEADING = Heading(0.0, 0.0, 1.0, 1e-4, 4e-4, 0.0, 0.0)
DECLINATION = math.radians(7.0)
PLACE = ReferenceField(Belief(48e-6, 1e-6), Belief(1.1, 0.01), DECLINATION, 0.01)


class Azimuth:
    """The layout of compass_interfaces 3.0.6."""

    UNIT_RAD, UNIT_DEG = 0, 1
    ORIENTATION_ENU, ORIENTATION_NED = 0, 1
    REFERENCE_MAGNETIC, REFERENCE_GEOGRAPHIC, REFERENCE_UTM = 0, 1, 2

    def __init__(self):
        self.header = Header()
        self.azimuth = self.variance = math.nan
        self.unit = self.orientation = self.reference = 255


@pytest.fixture
def installed(monkeypatch):
    module = ModuleType("compass_interfaces.msg")
    module.Azimuth = Azimuth
    monkeypatch.setitem(sys.modules, "compass_interfaces", ModuleType("compass_interfaces"))
    monkeypatch.setitem(sys.modules, "compass_interfaces.msg", module)


def topics_of_outputs():
    """Return what the outputs publish, type by topic, and what they published."""
    published, kinds = [], {}

    def create(kind, topic, qos):
        kinds[topic] = kind
        return SimpleNamespace(
            get_subscription_count=lambda: int(topic.endswith("/rad")),
            publish=lambda message: published.append((topic, message)),
        )

    view = SimpleNamespace(heading=lambda heading: heading)
    sensor_frames = SimpleNamespace(view=view, frame=lambda frame: frame)
    return HeadingOutput(SimpleNamespace(create_publisher=create), sensor_frames), kinds, published


def arrived(outputs, reference):
    moment = CompassReading(12.0, (0.0, 0.0, 0.0), None, HEADING, None)
    outputs.publish(moment, struct.pack("<iI", 12, 34), "imu_link", reference)


def test_without_the_package_there_is_no_such_topic():
    assert not [topic for topic in topics_of_outputs()[1] if topic.endswith("/rad")]


def test_both_norths_are_published_if_the_declination_is_known(installed):
    outputs, kinds, published = topics_of_outputs()
    assert kinds["compass/mag/enu/rad"] is kinds["compass/true/enu/rad"] is Azimuth
    arrived(outputs, PLACE)
    magnetic, true = (dict(published)[f"compass/{north}/enu/rad"] for north in ("mag", "true"))
    assert (magnetic.reference, true.reference) == (0, 1)
    assert magnetic.azimuth == pytest.approx(1.0)
    assert true.azimuth == pytest.approx(1.0 - DECLINATION)
    assert true.header.frame_id == "imu_link"
    assert (true.header.stamp.sec, true.header.stamp.nanosec) == (12, 34)


def test_without_a_declination_there_is_no_true_azimuth(installed):
    outputs, _, published = topics_of_outputs()
    arrived(outputs, ReferenceField())
    assert [topic for topic, _ in published] == ["compass/mag/enu/rad"]


def test_the_variance_contains_that_of_the_declination():
    stamp = struct.pack("<iI", 0, 0)
    assert azimuth_message(Azimuth, stamp, "", HEADING).variance == pytest.approx(4e-4)
    assert azimuth_message(Azimuth, stamp, "", HEADING, PLACE).variance == pytest.approx(5e-4)
