"""All waiting calls are answered, whatever fails during a turn."""

import errno
import math
import os
import resource
import time

import numpy as np
import pytest
from long_form import first_of
from remembered import remembered
from support import REFERENCE, ROBOT

from magcal_ros.core.samples import ImuSample, Streams
from magcal_ros.core.session import Conclusion, SelfTurn, Session, TurnState
from magcal_ros.core.simulation import Ride
from magcal_ros.ros import worker_process
from magcal_ros.ros.magnetometer import Control
from magcal_ros.ros.parameter_table import PARAMETERS
from magcal_ros.ros.parameters import Settings
from magcal_ros.ros.worker_process import WorkerProcess

NOBODY = 65534


class AtOnce:
    """Does all work immediately."""

    def run(self, work, then, otherwise):
        try:
            found = work()
        except Exception as error:
            otherwise(error)
        else:
            then(found)

    def finish_within(self, _):
        return True


class House:
    """The functions of a node for a turn, without an effect."""

    def __init__(self):
        self.errors, self.reporter, self.biases = [], self, []
        self.owner = self.pipeline = self.inputs = self.callback_errors = self
        self.streams = Streams(0.2)
        self.fits = self.files = AtOnce()
        self.travel = self.estimator = self.motors = self.up = self.store = self

    calibration = None

    def take_bias(self, found):
        self.biases.append(found)

    def use(self, _, tell):
        tell(Conclusion(True, "In force."))

    def report(self, *_):
        return ""

    def wheel_speed(self, _):
        return math.nan

    currents = ()
    gyro_at_rest = None

    def complaints(self):
        return ["/mag has been silent"]

    def turn_ended(self, _):
        pass

    def note(self, error):
        self.errors.append(error)


@remembered
def result_of(function, *arguments):
    return function(*arguments)


@pytest.fixture
def in_this_process(monkeypatch):
    """Fit without a process of its own, and the same samples once."""
    monkeypatch.setattr(WorkerProcess, "run", lambda _, *call: result_of(*call))


def no_room(*_, **__):
    raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))


def settings_of_a_turn():
    return Settings.of({**{s.name: s.default for s in PARAMETERS}, **REFERENCE})


def begun_in(house):
    """Return the control of an active turn."""
    streams, control = house.streams, Control(house, SelfTurn())
    assert control.start(settings_of_a_turn()).success
    ride = Ride(ROBOT, np.random.default_rng(3), start=1000.0, imu_rate=25.0, steps_per_field=2)
    for _ in range(400):
        for sample in ride.step(0.5):
            if isinstance(sample, ImuSample):
                streams.add_imu(sample)
            elif streams.add_field(sample):
                control.add(sample)
    return control


def turn_in(house):
    """Return the answers to two calls that wait for a turn."""
    control, reported = begun_in(house), []
    control.when_done(reported.append)
    control.when_done(reported.append)
    try:
        control.finish()
    except OSError as error:
        house.note(error)
    assert control.turn.state is TurnState.IDLE
    control.shut_down()
    first, second = reported
    assert first is second
    return first


def test_a_failed_start_of_the_fitting_process(monkeypatch):
    monkeypatch.setattr(worker_process, "start", no_room)
    answer = turn_in(House())
    assert not answer.success
    assert "cannot be started: Too many open files" in answer.message


def test_a_refused_start_of_a_process():
    """The limit of processes does not bind root, so a child gives up being root."""
    back, to = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            if os.getuid() == 0:
                os.setuid(NOBODY)
            resource.setrlimit(resource.RLIMIT_NPROC, (0, 0))
            answer = turn_in(House())
            os.write(to, f"{answer.success} {answer.message}".encode())
        except BaseException as error:  # the child of a test must not go on with the tests
            os.write(to, repr(error).encode())
        os._exit(0)
    os.close(to)
    with open(back, "rb") as line:
        words = line.read().decode()
    os.waitpid(child, 0)
    assert words.startswith("False ")
    assert "cannot be started: Resource temporarily unavailable" in words


def test_a_memory_error_of_the_report(in_this_process):
    house = House()
    house.report = no_room
    answer = turn_in(house)
    assert answer.success
    assert "No report: [Errno 24] Too many open files" in answer.message
    assert len(house.errors) == 1


def test_a_memory_error_when_the_calibration_is_put_in_force(in_this_process):
    house = House()
    house.use = no_room
    answer = turn_in(house)
    assert not answer.success
    assert "Too many open files" in answer.message
    assert len(house.errors) == 1


def test_a_memory_error_at_the_end_of_a_turn(in_this_process):
    house = House()
    house.turn_ended = no_room
    assert turn_in(house).success
    assert len(house.errors) == 1


@pytest.mark.parametrize("what", first_of(["progress", "window"]))
def test_a_memory_error_when_the_turn_is_checked(monkeypatch, what):
    """Python opens a file where numpy first computes a median."""
    house = House()
    control, reported = begun_in(house), []
    control.when_done(reported.append)
    monkeypatch.setattr(Session, what, no_room)
    with pytest.raises(OSError, match="Too many open files"):
        control.finish()
    assert control.turn.state is TurnState.IDLE
    (answer,) = reported
    assert not answer.success
    assert "stopped by an error ([Errno 24] Too many open files)" in answer.message
    monkeypatch.undo()
    assert control.start(settings_of_a_turn()).success
    control.shut_down()


def test_a_turn_that_fails_to_start_is_not_active(monkeypatch):
    house = House()
    control = Control(house, SelfTurn())
    monkeypatch.setattr(Session, "progress", no_room)
    with pytest.raises(OSError, match="Too many open files"):
        control.start(settings_of_a_turn())
    assert control.turn.state is TurnState.IDLE
    monkeypatch.undo()
    assert control.start(settings_of_a_turn()).success
    control.shut_down()


def test_a_verdict_without_a_caller_is_given_once_to_the_next_finish():
    control = begun_in(House())
    until = time.monotonic() + 60.0
    while control.turn.state is not TurnState.IDLE and time.monotonic() < until:
        control.tick()
    answer = control.finish()
    assert answer.success, answer.message
    assert answer.message.startswith("Calibrated")
    assert "~/start" in control.finish().message
    control.shut_down()


def test_up_gets_the_bias_of_the_gyro_by_a_turn_without_a_rest(in_this_process):
    house = House()
    assert turn_in(house).success
    (found,) = house.biases
    off = found.rate - ROBOT.gyro_bias
    assert off @ np.linalg.solve(found.covariance, off) < 16.0


@pytest.mark.nightly
def test_the_window_has_the_speed_of_the_wheels():
    house = House()
    house.wheel_speed = lambda stamp: 1e-3 * (stamp - 1000.0)
    control = begun_in(house)
    control.finish()
    window = control.turn.last_window
    np.testing.assert_allclose(window.speed, 1e-3 * (window.time - 1000.0))
    control.shut_down()


@pytest.mark.nightly
def test_the_window_has_the_current_of_the_battery():
    class Holding(House):
        """A robot whose battery reports another current with every sample."""

        @property
        def currents(self):
            self.reported += 1
            return ((999.0 + 0.1 * self.reported, -1.0 - 0.01 * self.reported),)

    house = Holding()
    house.reported = 0
    control = begun_in(house)
    control.finish()
    battery = control.turn.last_window.battery
    assert len(battery.time) > 50
    np.testing.assert_allclose(battery.current, -1.0 - 0.1 * (battery.time - 999.0))
    control.shut_down()
