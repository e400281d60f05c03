"""Self-calibration in the node, over real middleware."""

import errno
import os
from dataclasses import replace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from simulated.drive import Iron, Vehicle, simulated_drive
from simulated.legs import city
from simulated.travel import travel
from simulated.turns import measure, turn
from support import PATIENCE, REFERENCE, ROBOT, store_calibration, wait_until
from test_travel import Car

from magcal_ros.core import calibrate
from magcal_ros.core.self_calibration import Decision, DecisionKind, DriveResult
from magcal_ros.core.simulation import Robot
from magcal_ros.files import Origin, backup_files, read_calibration, write_calibration
from magcal_ros.ros.status import watch_diagnostic
from magcal_ros.ros.worker_process import WorkerStopped


def no_space(_):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.fixture
def known(tmp_path):
    """A file: its path, the calibration, and its origin."""
    path = store_calibration(tmp_path / "calibration.yaml")
    return path, *read_calibration(path)


class TestInTheNode:
    @pytest.fixture
    def house(self, start_node, known):
        """The node with a calibration in force."""
        path, *_ = known
        return start_node({**REFERENCE, "calibration_file": str(path)})

    def test_a_proposal_is_reported_accepted_and_the_old_one_kept(self, house, actor, known, capfd):
        path, calibration, _ = known
        before = path.read_bytes()
        stage = actor()
        # A sensor that is met while the other is known already would begin the drive anew.
        sensors = house._inputs.imu, house._inputs.field
        stage.run(
            PATIENCE,
            stop=lambda: stage.status["calibration"] and all(each.messages for each in sensors),
        )
        assert stage.status["self_calibration"]["mode"] == "propose"
        iron = calibration.correction.hard_iron + 1e-6
        proposed = replace(calibration, correction=replace(calibration.correction, hard_iron=iron))
        machine = house._self_calibration.machine
        machine.proposal = proposed
        machine.decisions.append(Decision(90.0, DecisionKind.PROPOSED, "it was better", proposed))
        stage.run(PATIENCE, stop=lambda: stage.status["self_calibration"]["proposal"])
        assert stage.status["self_calibration"]["decisions"][-1]["why"] == "it was better"
        answer = stage.answer(stage.call("accept"))
        assert answer.success
        assert "saved" in answer.message
        log = capfd.readouterr().err
        assert "~/accept on /imu/mag: a calibration by maximum_likelihood, predicted" in log
        assert f"In force and saved to {path}" in log
        kept = [before, None, None]
        assert [file.read_bytes() if file.exists() else None for file in backup_files(path)] == kept
        assert read_calibration(path)[0].evidence.accepted_by_user
        stage.run(PATIENCE, stop=lambda: stage.status["self_calibration"]["proposal"] is None)
        assert stage.status["self_calibration"]["proposal"] is None

    def test_accepting_repeatedly_loses_nothing(self, house, actor, known, monkeypatch):
        path, *_ = known
        before = path.read_bytes()
        robot = actor()
        robot.run(PATIENCE, stop=lambda: robot.status["calibration"])
        window = measure(ROBOT, turn(), np.random.default_rng(2))
        house._control.turn.last_outcome = calibrate(window, ROBOT.knowledge())
        with monkeypatch.context() as full:
            full.setattr(os, "fsync", no_space)
            for _ in range(3):
                refused = robot.answer(robot.call("accept"))
                assert not refused.success
                assert "In force until the node ends, but not saved" in refused.message
        assert path.read_bytes() == before
        assert not any(file.exists() for file in backup_files(path))
        for _ in range(4):
            assert robot.answer(robot.call("accept")).success
        kept = [file.read_bytes() if file.exists() else None for file in backup_files(path)]
        assert kept == [before, None, None]

    def test_the_newer_of_a_proposal_and_a_refused_turn_is_accepted(self, house, known):
        runner, turn_machine = house._self_calibration, house._control.turn
        wait_until(lambda: runner.machine._in_force)
        _, calibration, _ = known
        proposed = replace(calibration, noise_field=1e-6)
        made = Decision(90.0, DecisionKind.PROPOSED, "it was better", proposed)
        runner.machine.note = lambda _: [made]
        outcome = calibrate(measure(ROBOT, turn(), np.random.default_rng(2)), ROBOT.knowledge())
        turn_machine.last_outcome = outcome
        runner.machine.proposal = proposed
        runner._note(DriveResult(0.0))
        assert runner.proposal is proposed
        turn_machine.last_outcome = replace(outcome)  # of a later turn
        assert runner.proposal is None
        assert runner.facts()["proposal"] is None
        assert "later turn" in runner.facts()["doing"]
        house._magnetometers.accept(runner.proposal, lambda _: None)
        assert house._store.calibration.noise_field == outcome.calibration.noise_field
        assert runner.machine.proposal is None
        assert "later turn" not in runner.facts()["doing"]

    def test_a_failed_job_is_reported_and_repeated(self, house, monkeypatch):
        runner, printed = house._self_calibration, []
        runner._say = printed.append
        runner.machine.job(house._pipeline.current_settings().knowledge)
        runner._lost(OSError("no memory"))
        assert "no memory" in printed[0]
        assert runner.facts()["fits_lost"] == 1
        status = watch_diagnostic(runner)
        assert status.level == DiagnosticStatus.WARN
        assert "no memory" in status.message
        runner.machine.job(house._pipeline.current_settings().knowledge)
        runner._note(DriveResult(0.0))
        assert watch_diagnostic(runner).level == DiagnosticStatus.OK
        assert runner.facts()["fits_lost"] == 1

    def test_a_job_ended_by_the_node_is_not_reported(self, house):
        runner, printed = house._self_calibration, []
        runner._say = printed.append
        runner._lost(WorkerStopped())
        assert not printed
        assert runner.facts()["fits_lost"] == 0


@pytest.mark.nightly
def test_a_drive_puts_a_calibration_in_force(start_node, tmp_path):
    rng = np.random.default_rng(1)
    robot = Robot(strength=48e-6, inclination=np.radians(65.0), noise_force=0.05, noise_rate=2e-3)
    drive = simulated_drive(travel(city(rng, 400.0), rng, rate=25.0), rng, Vehicle(robot))
    path = tmp_path / "calibration.yaml"
    chosen = {"self_calibration": "apply", "report_folder": str(tmp_path / "reports")}
    car = Car(start_node({**REFERENCE, "calibration_file": str(path), **chosen}))
    car.drive(drive.samples())
    car.run(PATIENCE, stop=lambda: car.status.get("state") == "calibrated")
    assert car.status["state"] == "calibrated"
    assert car.status["calibration"]["method"] == "smoother"
    assert path.exists()
    car.run(20.0, stop=lambda: list(tmp_path.glob("reports/*/report.html")))
    page = next(tmp_path.glob("reports/*/report.html")).read_text()
    assert "<circle" in page
    assert "put in force" in page
    car.node.destroy_node()


@pytest.mark.nightly
@pytest.mark.parametrize(("added", "mode"), [(0.0, "propose"), (12e-6, "propose"), (12e-6, "off")])
def test_a_drive_shows_whether_the_calibration_holds(start_node, tmp_path, added, mode):
    rng = np.random.default_rng(2)
    robot = Robot(strength=48e-6, inclination=np.radians(65.0), noise_force=0.05, noise_rate=2e-3)
    irons = (Iron((added, 0.0, 0.0), 150.0),) if added else ()
    way = travel(city(rng, 400.0), rng, rate=25.0)
    drive = simulated_drive(way, rng, Vehicle(robot), irons=irons)
    known = calibrate(measure(robot, turn(), rng), robot.knowledge()).calibration
    path = tmp_path / "calibration.yaml"
    write_calibration(path, known, Origin.now("mag_link", "imu_link"))
    chosen = {"calibration_file": str(path), "self_calibration": mode}
    car = Car(start_node({**REFERENCE, **chosen}))
    car.run(PATIENCE, stop=lambda: car.status.get("calibration"))
    car.drive(drive.samples())
    words = "has not held" if added else "holds on the headings"
    car.run(PATIENCE, stop=lambda: words in car.status["watch"]["summary"])
    assert words in car.status["watch"]["summary"]
    assert car.status["watch"]["stale"] == bool(added)
    assert "heading_swing" in car.status["watch"]["findings"]
    car.node.destroy_node()
