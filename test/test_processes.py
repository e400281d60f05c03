"""Programs use one thread by default, and no code from the current folder."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from long_form import first_of

from magcal_ros import processes

SCRIPT = "import magcal_ros.cli.main, os; print(os.environ['{pool}'])"


@pytest.mark.parametrize(
    ("pool", "given"),
    [
        ("OMP_NUM_THREADS", None),
        pytest.param("OPENBLAS_NUM_THREADS", "3", marks=pytest.mark.nightly),
    ],
)
def test_the_command_takes_one_thread_unless_the_user_says_otherwise(pool, given):
    environment = {name: value for name, value in os.environ.items() if name != pool}
    if given is not None:
        environment[pool] = given
    answer = subprocess.run(
        [sys.executable, "-c", SCRIPT.format(pool=pool)],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert answer.stdout.strip() == (given or "1")


SHADOWS = ["select", "argparse", "subprocess", "multiprocessing", "selectors", "pickle", "rclpy"]
SHADOWS += ["importlib", "runpy", "geometry_msgs", "numpy", "magcal_ros"]


@pytest.fixture
def trap(tmp_path, monkeypatch):
    """Work in a folder whose modules record that they were run; returns the record."""
    for name in SHADOWS:
        betray = (
            f"open({str(tmp_path / 'was_run')!r}, 'a').write({name!r} + ' ')\nraise ImportError"
        )
        (tmp_path / f"{name}.py").write_text(betray)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    was_run = tmp_path / "was_run"
    return lambda: was_run.read_text() if was_run.exists() else ""


PATHS = ("", os.pathsep, f"/nowhere{os.pathsep}", f".{os.pathsep}/nowhere")


@pytest.mark.parametrize("path", first_of([*PATHS[1:], PATHS[0]]))
def test_processes_of_the_package_run_nothing_in_the_current_folder(trap, monkeypatch, path):
    monkeypatch.setenv("PYTHONPATH", path)
    process = processes.start("magcal_ros.cli.main", "--version", stdout=subprocess.PIPE)
    printed, _ = process.communicate()
    assert trap() == ""
    assert process.returncode == 0
    assert printed.startswith(b"magcal_ros ")


FIRST_WORDS = {"magcal": ["--version"], "calibrator": ["--ros-args", "--unknown-option"]}
"""What a command is given so that it ends at once, with all that it imports imported."""

LAUNCH = """
import sys
sys.path += {paths!r}
from magcal_ros.processes import {command}
sys.exit({command}())
"""


@pytest.mark.parametrize("command", FIRST_WORDS)
def test_commands_run_nothing_in_the_current_folder(trap, tmp_path, command):
    (tmp_path / "magcal_ros.py").unlink()
    for name in ("__future__", "collections", "pathlib", "typing", "threading"):
        (tmp_path / f"{name}.py").write_text((tmp_path / "select.py").read_text())
    root = os.path.dirname(os.path.dirname(processes.__file__))
    launcher = tmp_path / "elsewhere" / command
    launcher.parent.mkdir()
    # As a script of pip does; what an editable installation imports at Python's start is left out.
    launcher.write_text(LAUNCH.format(paths=[root, *sys.path[1:]], command=command))
    done = subprocess.run(
        [sys.executable, "-S", str(launcher), *FIRST_WORDS[command]],
        env={**os.environ, "PYTHONPATH": os.pathsep},
        capture_output=True,
        text=True,
    )
    assert trap() == ""
    assert done.returncode == {"magcal": 0, "calibrator": 2}[command], done.stderr


def test_commands_start_with_the_module_that_leaves_out_the_current_folder():
    setup = Path(__file__).parent.with_name("setup.py").read_text()
    for command in FIRST_WORDS:
        assert f'"{command} = magcal_ros.processes:{command}"' in setup


LATER = """
import json, os, sys
sys.path.insert(0, {root!r})
from magcal_ros import processes
sys.path.pop(0)
processes.leave_out_current_folder()
print(json.dumps(sys.path))
"""


@pytest.mark.parametrize("path", first_of(PATHS, 2))
def test_a_running_program_imports_nothing_from_the_current_folder(tmp_path, path):
    code = LATER.format(root=os.path.dirname(os.path.dirname(processes.__file__)))
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        check=True,
    )
    left = json.loads(done.stdout)
    assert not {"", str(tmp_path)} & set(left)
    assert ("/nowhere" in left) == ("/nowhere" in path)


def test_a_folder_with_an_absolute_path_is_used_anywhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", f"{os.pathsep}{tmp_path}")
    monkeypatch.setattr(sys, "path", ["/bin", str(tmp_path)])
    processes.leave_out_current_folder()
    assert sys.path == ["/bin", str(tmp_path)]


@pytest.mark.parametrize("how", ["SIGINT", "SIGTERM"])
@pytest.mark.parametrize(("program", "status"), [("magcal", 130), ("calibrator", 0)])
def test_a_signal_while_a_program_is_imported_leaves_no_traceback(tmp_path, program, status, how):
    """The imports take a second or two, in which a user may change their mind."""
    for name in ("argparse", "rclpy"):
        (tmp_path / f"{name}.py").write_text(f"import signal\nsignal.raise_signal(signal.{how})")
    code = f"import sys; from magcal_ros import processes; sys.exit(processes.{program}())"
    path = os.pathsep.join([str(tmp_path), str(Path(processes.__file__).parents[1])])
    environment = {**os.environ, "PYTHONPATH": path}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, check=False
    )
    assert (done.returncode, done.stderr) == (status, b"")
