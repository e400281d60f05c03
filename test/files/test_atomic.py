import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from long_form import rounds

from magcal_ros.files import LEFT_BEHIND, UNFINISHED, FileError, write_atomically

pytestmark = pytest.mark.faults

KILLS = rounds(15, 1000)

REWRITER = """
import sys
from pathlib import Path
from magcal_ros.files.disk import write_atomically
path = Path(sys.argv[1])
print("ready", flush=True)
while True:
    write_atomically(path, "a" * 200_000)
    write_atomically(path, "b" * 150_000)
"""

LIMITED = """
import resource, signal, sys
from pathlib import Path
from magcal_ros.files.disk import FileError, write_atomically
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
try:
    write_atomically(Path(sys.argv[1]), "n" * 100_000)
except FileError as trouble:
    print(trouble)
"""


@pytest.fixture
def umask():
    """Return what sets the umask for one test."""
    before = os.umask(0o022)
    yield os.umask
    os.umask(before)


@pytest.mark.parametrize(("mask", "mode"), [(0o022, 0o644), (0o077, 0o600), (0o002, 0o664)])
def test_the_whole_text_is_written_with_the_umask(tmp_path, umask, mask, mode):
    umask(mask)
    path = tmp_path / "deep" / "file.yaml"
    write_atomically(path, "größe\n")
    assert path.read_bytes() == "größe\n".encode()
    assert path.stat().st_mode & 0o777 == mode
    write_atomically(path, "x")
    assert path.read_text() == "x"
    assert os.listdir(path.parent) == ["file.yaml"]


def test_a_kill_at_any_time_leaves_the_old_or_the_new_file(tmp_path):
    path, chance = tmp_path / "file.yaml", random.Random(8)
    path.write_text("a" * 200_000)
    for _ in range(KILLS):
        before = path.stat().st_ino
        process = subprocess.Popen(
            [sys.executable, "-c", REWRITER, str(path)], stdout=subprocess.PIPE
        )
        try:
            assert process.stdout.readline() == b"ready\n"
            while path.stat().st_ino == before:
                time.sleep(0.001)
            time.sleep(chance.uniform(0.0, 0.03))
        finally:
            process.send_signal(signal.SIGKILL)
            process.wait()
            process.stdout.close()
        assert path.read_text() in ("a" * 200_000, "b" * 150_000)


def test_two_writers_of_one_file_never_mix(tmp_path):
    path = tmp_path / "file.yaml"
    path.write_text("a" * 200_000)
    command = [sys.executable, "-c", REWRITER, str(path)]
    writers = [subprocess.Popen(command, stdout=subprocess.PIPE) for _ in range(2)]
    try:
        for writer in writers:
            assert writer.stdout.readline() == b"ready\n"
        for _ in range(rounds(300, 30_000)):
            assert path.read_text() in ("a" * 200_000, "b" * 150_000)
    finally:
        for writer in writers:
            writer.kill()
            writer.communicate()


def test_temporary_files_of_killed_writers_are_removed(tmp_path):
    path = tmp_path / "[mag].yaml"
    old = tmp_path / f".[mag].yaml.abc{UNFINISHED}"
    fresh = tmp_path / f".[mag].yaml.def{UNFINISHED}"
    others = tmp_path / f".imu.yaml.abc{UNFINISHED}", tmp_path / ".[mag].yaml.swp"
    for left in (old, fresh, *others):
        left.write_text("half")
    long_ago = time.time() - 2 * LEFT_BEHIND
    for left in (old, *others):
        os.utime(left, (long_ago, long_ago))
    write_atomically(path, "whole")
    assert path.read_text() == "whole"
    assert not old.exists()
    assert all(left.exists() for left in (fresh, *others))


def test_an_impossible_folder_is_an_error_with_a_reason(tmp_path):
    blocker = tmp_path / "file"
    blocker.write_text("here")
    with pytest.raises(FileError, match="Choose a writable place") as caught:
        write_atomically(blocker / "sub" / "cal.yaml", "x")
    assert str(blocker / "sub" / "cal.yaml") in str(caught.value)
    assert blocker.read_text() == "here"


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="needs /proc")
def test_an_unwritable_folder_is_an_error():
    with pytest.raises(FileError, match="cannot write"):
        write_atomically(Path("/proc/self/cal.yaml"), "x")


def test_a_full_disk_leaves_only_the_old_file(tmp_path):
    path = tmp_path / "file.yaml"
    path.write_text("old")
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, str(path)], capture_output=True, text=True, check=True
    )
    assert "cannot write" in done.stdout
    assert "File too large" in done.stdout
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["file.yaml"]


def test_a_too_long_name_is_an_error(tmp_path):
    with pytest.raises(FileError, match="too long"):
        write_atomically(tmp_path / ("x" * 300), "x")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("failing", ["fsync", "replace", "fchmod"])
def test_a_failure_of_any_step_leaves_no_temporary_file(tmp_path, monkeypatch, failing):
    def fail(*_):
        raise OSError(28, "No space left on device")

    path = tmp_path / "file.yaml"
    path.write_text("old")
    monkeypatch.setattr(os, failing, fail)
    with pytest.raises(FileError, match="No space left on device"):
        write_atomically(path, "new")
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["file.yaml"]


def test_a_text_that_cannot_be_encoded_leaves_no_temporary_file(tmp_path):
    with pytest.raises(UnicodeEncodeError):
        write_atomically(tmp_path / "file.yaml", "\ud800")
    assert os.listdir(tmp_path) == []


def test_an_interrupt_leaves_no_temporary_file(tmp_path, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_atomically(tmp_path / "file.yaml", "x")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("mode", [0o640, 0o600, 0o666, 0o604])
def test_the_mode_of_the_old_file_is_kept(tmp_path, umask, mode):
    umask(0o022)
    path = tmp_path / "file.yaml"
    path.write_text("old")
    path.chmod(mode)
    write_atomically(path, "new")
    assert path.read_text() == "new"
    assert path.stat().st_mode & 0o777 == mode


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
def test_owner_and_group_of_the_old_file_are_kept(tmp_path):
    path = tmp_path / "file.yaml"
    path.write_text("old")
    os.chown(path, 1000, 1001)
    path.chmod(0o640)
    write_atomically(path, "new")
    about = path.stat()
    assert (about.st_uid, about.st_gid, about.st_mode & 0o777) == (1000, 1001, 0o640)


def test_if_the_group_cannot_be_kept_no_other_group_gets_its_rights(tmp_path, monkeypatch):
    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    path = tmp_path / "file.yaml"
    path.write_text("old")
    path.chmod(0o664)
    monkeypatch.setattr(os, "fchown", refuse)
    write_atomically(path, "new")
    assert path.stat().st_mode & 0o777 == 0o604


def test_a_symbolic_link_is_kept_and_its_target_replaced(tmp_path):
    target, link = tmp_path / "deep" / "true.yaml", tmp_path / "link.yaml"
    target.parent.mkdir()
    target.write_text("old")
    link.symlink_to(Path("deep") / "true.yaml")
    write_atomically(link, "new")
    assert link.is_symlink()
    assert target.read_text() == "new"
    assert os.listdir(target.parent) == ["true.yaml"]
    target.unlink()
    write_atomically(link, "anew")
    assert target.read_text() == "anew"


def test_a_link_to_itself_is_an_error(tmp_path):
    link = tmp_path / "link.yaml"
    link.symlink_to(link)
    with pytest.raises(FileError, match="cannot write"):
        write_atomically(link, "new")


def test_a_pipe_is_not_replaced(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(FileError, match="a device or a pipe"):
        write_atomically(pipe, "new")
    assert pipe.is_fifo()
