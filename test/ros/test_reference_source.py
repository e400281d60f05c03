"""A receiver on gps/fix, or a place by parameter, over real middleware."""

import math
import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Imu, NavSatFix
from support import PATIENCE, REFERENCE

from magcal_ros.core.earth_field import decimal_year, model_field
from magcal_ros.core.earth_field.wmm import Place
from magcal_ros.core.geometry import wrap_angle

HOME = Place(48.14, 11.58, 520.0)
AT_HOME = {"reference.latitude_deg": 48.14, "reference.longitude_deg": 11.58}
NEW_YORK = Place(40.7, -74.0)


class Receiver:
    """A GPS driver in addition to the actor."""

    def __init__(self, actor):
        self.actor = actor
        self.out = actor.node.create_publisher(NavSatFix, "gps/fix", qos_profile_sensor_data)
        actor.run(PATIENCE, stop=lambda: self.out.get_subscription_count() > 0)

    def say(self, place=HOME, times=1, status=0, stamp=None, **wrong):
        message = NavSatFix()
        message.status.status = status
        message.header.stamp.sec = int(time.time() if stamp is None else stamp)
        spot = (place.latitude_deg, place.longitude_deg, place.altitude)
        message.latitude, message.longitude, message.altitude = spot
        for name, value in wrong.items():
            setattr(message, name, value)
        for _ in range(times):
            self.out.publish(message)
            self.actor.run(0.1)
        return self.reference(lambda _: True)

    def reference(self, is_there, patience=PATIENCE):
        """Wait until the status has a text on the reference, and return it."""
        self.actor.run(patience, stop=lambda: is_there(self.actor.status["reference"]))
        return self.actor.status["reference"]


@pytest.fixture
def receive(start_node, actor):
    """Return a function that starts node, robot and receiver."""

    def set_up(parameters):
        node = start_node(parameters)
        return node, Receiver(actor())

    return set_up


def complains(words):
    return lambda reference: words in " ".join(reference["complaints"])


def is_from(words):
    return lambda reference: words in reference["source"]


@pytest.mark.nightly
def test_a_fix_gives_the_reference_and_true_north_with_its_variance(receive):
    _, receiver = receive({})
    actor = receiver.actor
    received = {}
    for name in ("true", "mag"):
        received[name] = []
        actor.node.create_subscription(Imu, f"compass/{name}/enu/imu", received[name].append, 10)
    assert actor.status["reference"]["source"] == "unknown"
    receiver.say()
    reference = receiver.reference(is_from("World Magnetic Model 2025 at 48.14°N 11.58°E"))
    model = model_field(HOME, decimal_year(time.time()))
    assert reference["strength_ut"] == pytest.approx(model.strength.value * 1e6, abs=0.1)
    assert reference["strength_sigma_ut"] == pytest.approx(1.506, abs=1e-3)
    declination = math.degrees(model.declination.value)
    assert reference["declination_deg"] == pytest.approx(declination, abs=0.05)
    assert actor.status["north"] == "true"
    assert actor.calibrate().success
    # Had the fit not heard of the reference, it would say so.
    assert "reference field" not in " ".join(actor.status["verdict"]["not_shown"])
    actor.run(0.5)
    for messages in received.values():
        messages.clear()
    actor.run(1.0)
    magnetic = {m.header.stamp.nanosec: m for m in received["mag"]}
    both = [(magnetic[m.header.stamp.nanosec], m) for m in received["true"] if
            m.header.stamp.nanosec in magnetic]  # fmt: skip
    assert len(both) > 5
    sigma = math.radians(reference["declination_sigma_deg"])
    for mag, true in both:
        turned = float(wrap_angle(yaw(mag) - yaw(true)))
        assert turned == pytest.approx(math.radians(reference["declination_deg"]), abs=1e-4)
        added = true.orientation_covariance[8] - mag.orientation_covariance[8]
        assert added == pytest.approx(sigma**2, rel=1e-2)
        assert true.orientation_covariance[0] == mag.orientation_covariance[0]


def yaw(message):
    q = message.orientation
    return float(Rotation.from_quat([q.x, q.y, q.z, q.w]).as_euler("ZYX")[0])


def test_given_numbers_and_a_given_place_have_priority(receive):
    node, receiver = receive({**AT_HOME, "reference.declination_deg": 4.0})
    reference = receiver.reference(is_from("declination given, the rest from"))
    assert reference["declination_deg"] == 4.0
    assert "48.14°N 11.58°E" in reference["source"]
    assert not reference["complaints"]
    receiver.say(NEW_YORK)
    reference = receiver.reference(complains("from the given position 48.14°N 11.58°E"))
    assert "gps/fix says 40.70°N 74.00°W" in reference["complaints"][0]
    assert "48.14°N 11.58°E" in reference["source"]
    node.set_parameters([Parameter("reference.declination_deg", value=math.nan)])
    reference = receiver.reference(lambda r: r["declination_deg"] != 4.0)
    assert reference["declination_deg"] == pytest.approx(4.4, abs=0.2)


def test_bad_fixes_are_ignored_and_reported(receive):
    _, receiver = receive({})
    receiver.say(status=-1)
    receiver.say(latitude=math.nan)
    receiver.say(longitude=1e300)
    receiver.say(Place(0.0, 0.0))
    reference = receiver.reference(lambda r: len(r["complaints"]) == 4)
    assert reference["source"] == "unknown"
    words = " ".join(reference["complaints"])
    for part in ("there is no fix", "not finite", "lie outside", "0° N 0° E"):
        assert part in words
    receiver.say(altitude=math.nan)
    reference = receiver.reference(is_from("World Magnetic Model"))
    assert not reference["complaints"]


def test_a_confirmed_far_place_is_used_and_reported(receive):
    _, receiver = receive({})
    received = []
    receiver.actor.node.create_subscription(DiagnosticArray, "/diagnostics", received.append, 10)
    receiver.say()
    receiver.reference(is_from("48.14°N"))
    receiver.say(NEW_YORK)
    assert "48.14°N" in receiver.reference(lambda _: False, patience=0.5)["source"]
    receiver.say(NEW_YORK, times=4)
    reference = receiver.reference(is_from("40.70°N 74.00°W"))
    assert reference["declination_deg"] == pytest.approx(-12.5, abs=1.0)
    assert "gps/fix has moved by 64" in reference["complaints"][0]
    received.clear()
    receiver.actor.run(PATIENCE, stop=lambda: bool(received))
    field = next(s for s in received[-1].status if s.name == "calibrator: Field")
    assert field.level == DiagnosticStatus.WARN
    assert "gps/fix has moved by 64" in field.message
    values = {pair.key: pair.value for pair in field.values}
    assert "declination -12" in values["reference"]


def test_given_numbers_of_another_place_are_reported_and_used(receive):
    _, receiver = receive(REFERENCE)
    assert not receiver.actor.status["reference"]["complaints"]
    receiver.say(Place(-33.87, 151.21))
    reference = receiver.reference(complains("the inclination is given as 65.0°"))
    assert reference["inclination_deg"] == 65.0
    assert reference["source"].startswith("strength and inclination given, the rest from")


def test_a_replayed_drive_has_the_date_of_its_fixes_unless_it_is_in_the_future(receive):
    _, receiver = receive({})
    receiver.say(stamp=1.55e9)
    reference = receiver.reference(is_from("World Magnetic Model 2015"))
    assert reference["source"].endswith("2019.1")
    receiver.say(stamp=2**31 - 1)
    # The heartbeat looks again.
    receiver.reference(is_from("World Magnetic Model 2025"))
    assert str(round(decimal_year(time.time()), 1)) in receiver.actor.status["reference"]["source"]


def test_half_a_place_is_reported(receive):
    _, receiver = receive({"reference.latitude_deg": 48.0})
    reference = receiver.reference(complains("both, or neither"))
    assert complains("both, or neither")(reference)
    assert reference["source"] == "unknown"


@pytest.mark.nightly
def test_a_changed_place_is_used_by_the_next_turn(receive):
    node, receiver = receive({})
    move(node, HOME)
    assert receiver.actor.calibrate().success
    strength = receiver.actor.status["calibration"]["reference_strength_ut"]
    expected = model_field(HOME, decimal_year(time.time())).strength.value * 1e6
    assert np.isclose(strength, expected, atol=1.5)
    assert not receiver.reference(lambda _: True)["complaints"]
    move(node, Place(-33.87, 151.21))
    assert receiver.reference(complains("if it was made elsewhere, calibrate"))["complaints"]


def move(node, place):
    """Change the place that is given by hand."""
    spot = {"latitude": place.latitude_deg, "longitude": place.longitude_deg}
    node.set_parameters([Parameter(f"reference.{n}_deg", value=spot[n]) for n in spot])


def test_the_first_fix_with_a_calibration_in_force_is_logged(loaded, capfd, graph):
    receiver = Receiver(loaded(parameters={}))
    receiver.say(times=3)
    receiver.reference(lambda reference: reference["declination_deg"] is not None)
    node = graph.calibrators[0]
    assert "compass/yaw refers to true north from now on" in capfd.readouterr().err
    assert node.callback_errors.total == 0
