import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from long_form import rounds

from magcal_ros.files.atomic import LEFT_BEHIND, UNFINISHED, FileTrouble, write_atomically

pytestmark = pytest.mark.faults

KILLS = rounds(40, 1000)

REWRITER = """
import sys
from pathlib import Path
from magcal_ros.files.atomic import write_atomically
path = Path(sys.argv[1])
print("ready", flush=True)
while True:
    write_atomically(path, "a" * 200_000)
    write_atomically(path, "b" * 150_000)
"""

LIMITED = """
import resource, signal, sys
from pathlib import Path
from magcal_ros.files.atomic import FileTrouble, write_atomically
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
try:
    write_atomically(Path(sys.argv[1]), "n" * 100_000)
except FileTrouble as trouble:
    print(trouble)
"""


def test_the_whole_text_is_written_readable_for_all(tmp_path):
    path = tmp_path / "deep" / "file.yaml"
    write_atomically(path, "größe\n")
    assert path.read_bytes() == "größe\n".encode()
    assert path.stat().st_mode & 0o777 == 0o644
    write_atomically(path, "x")
    assert path.read_text() == "x"
    assert os.listdir(path.parent) == ["file.yaml"]


def test_killed_at_any_moment_it_leaves_the_old_or_the_new_one(tmp_path):
    path, chance = tmp_path / "file.yaml", random.Random(8)
    seen = set()
    path.write_text("a" * 200_000)
    for _ in range(KILLS):
        process = subprocess.Popen(
            [sys.executable, "-c", REWRITER, str(path)], stdout=subprocess.PIPE
        )
        try:
            assert process.stdout.readline() == b"ready\n"
            time.sleep(chance.uniform(0.0, 0.03))
        finally:
            process.send_signal(signal.SIGKILL)
            process.wait()
            process.stdout.close()
        content = path.read_text()
        assert content in ("a" * 200_000, "b" * 150_000)
        seen.add(content[0])
    assert seen == {"a", "b"}


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


def test_what_killed_writers_left_is_swept_away_when_nobody_writes_it_any_more(tmp_path):
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


def test_a_folder_that_cannot_be_is_trouble_in_words(tmp_path):
    blocker = tmp_path / "file"
    blocker.write_text("here")
    with pytest.raises(FileTrouble, match="Choose a writable place") as caught:
        write_atomically(blocker / "sub" / "cal.yaml", "x")
    assert str(blocker / "sub" / "cal.yaml") in str(caught.value)
    assert blocker.read_text() == "here"


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="needs /proc")
def test_a_folder_that_takes_no_files_is_trouble():
    with pytest.raises(FileTrouble, match="cannot write"):
        write_atomically(Path("/proc/self/cal.yaml"), "x")


def test_a_full_disk_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "file.yaml"
    path.write_text("old")
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, str(path)], capture_output=True, text=True, check=True
    )
    assert "cannot write" in done.stdout
    assert "File too large" in done.stdout
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["file.yaml"]


def test_a_name_too_long_is_trouble(tmp_path):
    with pytest.raises(FileTrouble, match="too long"):
        write_atomically(tmp_path / ("x" * 300), "x")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("failing", ["fsync", "replace", "chmod"])
def test_whichever_step_fails_no_temporary_file_stays(tmp_path, monkeypatch, failing):
    def fail(*_):
        raise OSError(28, "No space left on device")

    path = tmp_path / "file.yaml"
    path.write_text("old")
    monkeypatch.setattr(os, failing, fail)
    with pytest.raises(FileTrouble, match="No space left on device"):
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
