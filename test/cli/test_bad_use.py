"""Wrong input of any kind gives one line and the documented exit status."""

import os
import subprocess
import sys
from types import SimpleNamespace

import pytest
from drives import drive, write_csv

from magcal_ros.cli import check
from magcal_ros.cli.common import Exit
from magcal_ros.cli.main import main

COMMAND = [sys.executable, "-m", "magcal_ros.cli.main"]
LONG = "x" * 5000


def run(*arguments, **options):
    given = {"capture_output": True, "timeout": 120, "check": False, **options}
    return subprocess.run([*COMMAND, *arguments], **given)


@pytest.fixture
def call(capfdbinary):
    """Run a command in this process; returns what a shell would see."""

    def run_here(*arguments):
        try:
            status = main([os.fsdecode(each) for each in arguments])
        except SystemExit as left:
            status = left.code
        printed = capfdbinary.readouterr()
        return SimpleNamespace(returncode=status, stdout=printed.out, stderr=printed.err)

    return run_here


def is_one_line(done):
    lines = done.stderr.decode(errors="replace").splitlines()
    return len(lines) == 1 and lines[0].startswith("magcal: ")


@pytest.fixture
def folder(tmp_path):
    return write_csv(tmp_path / "csv", drive(60.0))


def rewrite(path, row, column, value):
    lines = path.read_text().splitlines()
    cells = lines[row].split(",")
    cells[column] = value
    lines[row] = ",".join(cells)
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize(
    "arguments",
    [
        ["fit", LONG], ["check", LONG, "--calibration", "x"], ["check", "x", "--calibration", LONG],
        ["export", LONG, "--to", "px4"], ["replay", LONG],
    ],
)  # fmt: skip
def test_a_too_long_name_is_a_file_error(call, arguments):
    done = call(*arguments)
    assert done.returncode == Exit.FILE_TROUBLE
    assert is_one_line(done)
    assert len(done.stderr) < 6000


@pytest.mark.parametrize("table", ["imu.csv", "mag.csv"])
@pytest.mark.parametrize("command", ["fit", "replay"])
def test_an_endless_device_as_a_table_is_not_read(call, folder, table, command):
    (folder / table).unlink()
    (folder / table).symlink_to("/dev/zero")
    done = call(command, str(folder))
    assert done.returncode == Exit.FILE_TROUBLE
    assert b"not a regular file" in done.stderr
    assert is_one_line(done)


def test_a_line_without_end_is_damage(call, folder):
    (folder / "mag.csv").write_text("t,mx,my,mz\n" + "1" * 50_000)
    done = call("fit", str(folder))
    assert done.returncode == Exit.FILE_TROUBLE
    assert b"a line has 10000 characters or more" in done.stderr


@pytest.mark.skipif(os.geteuid() == 0, reason="root may go anywhere")
def test_a_folder_without_permission_is_a_file_error(call, folder):
    folder.chmod(0o600)
    done = call("fit", str(folder))
    folder.chmod(0o700)
    assert done.returncode == Exit.FILE_TROUBLE
    assert is_one_line(done)


@pytest.mark.parametrize("stamp", ["1e300", "-1e300", "1e12"])
@pytest.mark.parametrize("command", ["fit", "replay"])
def test_stamps_that_are_not_times_are_damage(call, folder, stamp, command):
    rewrite(folder / "mag.csv", 5, 0, stamp)
    done = call(command, str(folder))
    assert done.returncode == Exit.FILE_TROUBLE
    assert b"must be seconds" in done.stderr
    assert is_one_line(done)


@pytest.mark.parametrize("stamp", ["nan", "inf", "4e9"])
def test_stamps_out_of_range_are_not_replayed(call, folder, stamp):
    rewrite(folder / "imu.csv", 7, 0, stamp)
    done = call("replay", str(folder))
    assert done.returncode == Exit.FILE_TROUBLE
    assert b"sample 7 has the stamp" in done.stderr
    assert is_one_line(done)


@pytest.mark.parametrize("option", ["--imu-frame", "--mag-frame"])
def test_a_frame_that_is_not_text_is_a_usage_error(call, folder, option):
    done = call("replay", str(folder), option, b"\xff\xfe")
    assert done.returncode == Exit.USAGE
    assert b"is not UTF-8 text" in done.stderr


@pytest.mark.parametrize("rate", ["nan", "inf", "0", "-1", "fast"])
def test_an_invalid_rate_is_a_usage_error(call, folder, rate):
    assert call("replay", str(folder), f"--rate={rate}").returncode == Exit.USAGE


@pytest.mark.parametrize("command", ["fit", "doctor", "drive"])
def test_a_span_that_ends_before_it_begins_is_a_usage_error(
    call, folder, tmp_path, monkeypatch, command
):
    monkeypatch.chdir(tmp_path)
    done = call(command, str(folder), "--from", "9", "--to", "3")
    assert done.returncode == Exit.USAGE
    assert b"--from 9 must come before --to 3" in done.stderr
    assert is_one_line(done)


class TestRos:
    @pytest.fixture(autouse=True)
    def ros(self):
        pytest.importorskip("rclpy")

    @pytest.mark.parametrize(
        "arguments",
        [["-r", "a b:=c"], ["--params-file", "/nowhere.yaml"], ["-r", "__ns:=no space"]],
    )
    def test_bad_ros_arguments_are_a_usage_error(self, call, folder, arguments):
        done = call("replay", str(folder), "--wait", "0", "--ros-args", *arguments)
        assert done.returncode == Exit.USAGE
        assert b"magcal: ROS does not start: " in done.stderr
        assert b"Traceback" not in done.stderr

    def test_a_domain_that_is_not_a_number_is_a_usage_error(self, folder):
        done = run("replay", str(folder), "--wait", "0", env={**os.environ, "ROS_DOMAIN_ID": "x"})
        assert done.returncode == Exit.USAGE
        assert b"ROS_DOMAIN_ID" in done.stderr
        assert b"Traceback" not in done.stderr


def test_a_closed_pipe_ends_the_command_silently(folder):
    read, write = os.pipe()
    os.close(read)
    done = run(
        "doctor", str(folder),
        capture_output=False, stdout=write, stderr=subprocess.PIPE,
    )  # fmt: skip
    os.close(write)
    assert done.returncode == Exit.PIPE_CLOSED
    assert done.stderr == b""


@pytest.mark.parametrize("name", ["turn.mcap", "turn.db3", "turn.bag", "turn/turn_0.mcap"])
def test_a_pipe_instead_of_a_bag_is_not_waited_for(call, tmp_path, name):
    pipe = tmp_path / name
    if pipe.parent != tmp_path:
        pipe.parent.mkdir()
        (pipe.parent / "metadata.yaml").write_text("rosbag2_bagfile_information:\n")
    os.mkfifo(pipe)
    done = call("fit", pipe if pipe.parent == tmp_path else pipe.parent)
    assert done.returncode == Exit.FILE_TROUBLE
    assert is_one_line(done)
    assert b"not a regular file" in done.stderr


def test_an_empty_table_is_reported_without_a_python_warning(call, folder):
    for header in ("t,latitude,longitude\n", "t,latitude,longitude\n\n# nothing\n"):
        (folder / "gps.csv").write_text(header)
        done = call("fit", folder)
        assert done.returncode == Exit.FILE_TROUBLE
        assert is_one_line(done)
        assert b"gps.csv holds no samples" in done.stderr


EVIL = "a\x1b[31mb\x9b2Jc\u202ed"


def test_names_of_files_cannot_control_the_terminal(call, folder, tmp_path):
    for arguments in (("fit", folder, "--output", tmp_path / EVIL), ("fit", tmp_path / EVIL)):
        done = call(*arguments)
        printed = (done.stdout + done.stderr).decode()
        assert "a?[31mb?2Jc?d" in printed, arguments
        assert all(letter.isprintable() or letter == "\n" for letter in printed), arguments


def test_arguments_cannot_control_the_terminal(call, folder):
    # As `magcal doctor *` passes them for a folder with such names.
    for arguments in (("doctor", folder, EVIL), (EVIL,), ("fit", f"--output={EVIL}", f"--{EVIL}")):
        printed = call(*arguments).stderr.decode()
        assert all(letter.isprintable() or letter == "\n" for letter in printed), arguments


def test_a_missing_recording_is_reported_in_one_line(call, tmp_path):
    done = call("replay", str(tmp_path / "nowhere"))
    assert done.returncode == Exit.FILE_TROUBLE
    assert done.stderr.startswith(b"magcal: cannot read")
    assert is_one_line(done)


@pytest.mark.parametrize("name", ["bag/metadata.yaml", "bag.mcap"])
def test_a_bag_to_replay_is_left_to_the_command_that_plays_it(call, tmp_path, name):
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_text("rosbag2_bagfile_information:\n")
    done = call("replay", path if path.parent == tmp_path else path.parent)
    assert done.returncode == Exit.FILE_TROUBLE
    assert is_one_line(done)
    assert b"ros2 bag play" in done.stderr


def test_a_wrong_command_is_a_usage_error(call):
    assert call("dance").returncode == Exit.USAGE


def test_the_demo_replaces_no_file_of_another_program(call, tmp_path):
    path = tmp_path / "robot_params.yaml"
    path.write_text("mine: 1\n")
    done = call("demo", "--output", str(path))
    assert done.returncode == Exit.FILE_TROUBLE
    assert b"is not a calibration of magcal_ros" in done.stderr
    assert path.read_text() == "mine: 1\n"


def test_an_internal_error_is_reported_with_its_traceback(monkeypatch, capsys, tmp_path):
    def fail(_):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(check, "read_calibration", fail)
    assert main(["check", "x", "--calibration", "y"]) == Exit.FAULT
    errors = capsys.readouterr().err
    assert "Traceback" in errors
    assert "ZeroDivisionError: a bug" in errors
    assert "is an error in magcal_ros" in errors
    assert "Please report it" in errors


def test_a_full_disk_behind_the_output_is_a_file_error(folder):
    with open("/dev/full", "wb") as full:
        streams = {"capture_output": False, "stdout": full, "stderr": subprocess.PIPE}
        done = run("doctor", str(folder), "--json", **streams)
    assert done.returncode == Exit.FILE_TROUBLE
    assert done.stderr == b"magcal: cannot print the result: No space left on device\n"


def test_an_os_error_without_a_file_name_is_internal(monkeypatch, capsys):
    errors = iter([OSError(12, "Cannot allocate memory"), PermissionError(13, "Denied", "/secret")])

    def fail(_):
        raise next(errors)

    monkeypatch.setattr(check, "read_calibration", fail)
    assert main(["check", "x", "--calibration", "y"]) == Exit.FAULT
    capsys.readouterr()
    assert main(["check", "x", "--calibration", "y"]) == Exit.FILE_TROUBLE
    assert capsys.readouterr().err == "magcal: cannot use /secret: Denied\n"


@pytest.mark.parametrize("name", ["", "/", "/x//y", "x\x1b[2J", "a b", "/x/", "1a", "x" * 5000])
def test_an_invalid_node_name_is_reported(name, capsys):
    with pytest.raises(SystemExit, match=f"{Exit.USAGE:d}"):
        main(["calibrate", "--node", name])
    printed = capsys.readouterr().err
    assert "is not the name of a node" in printed
    assert "\x1b" not in printed
