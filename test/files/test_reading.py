import os
import socket
import threading
from pathlib import Path

import pytest

from magcal_ros.files import FileError, NotRegularFile, read_small, with_time_limit

pytestmark = pytest.mark.faults


def test_a_file_of_the_allowed_size_is_read_and_a_larger_one_is_not(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"x" * 100)
    assert read_small(path, 100) == b"x" * 100
    with pytest.raises(NotRegularFile, match="more than 99 bytes"):
        read_small(path, 99)


@pytest.mark.parametrize("path", ["/dev/zero", "/dev/null", "/dev/tty"])
def test_devices_are_not_read(path):
    with pytest.raises((NotRegularFile, OSError)):
        read_small(Path(path), 100)


def test_a_pipe_without_a_writer_is_not_waited_for(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(NotRegularFile, match="not a regular file"):
        read_small(pipe, 100)


def test_a_socket_and_a_folder_are_reported(tmp_path):
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "socket"))
        with pytest.raises((NotRegularFile, OSError)):
            read_small(tmp_path / "socket", 100)
    with pytest.raises(IsADirectoryError):
        read_small(tmp_path, 100)


@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="needs /proc")
def test_a_file_with_a_wrong_size_is_limited():
    with pytest.raises(NotRegularFile, match="more than 5 bytes"):
        read_small(Path("/proc/self/environ"), 5)


class TestPromptly:
    def test_result_and_exception_of_the_work_are_passed_on(self):
        assert with_time_limit(lambda: 5, Path("x")) == 5
        with pytest.raises(ZeroDivisionError):
            with_time_limit(lambda: 1 // 0, Path("x"))

    def test_a_disk_that_does_not_answer_is_an_error(self):
        answer = threading.Event()
        with pytest.raises(FileError, match=r"/gone/mag\.yaml does not answer within 0\.2 s"):
            with_time_limit(answer.wait, Path("/gone/mag.yaml"), 0.2)
        answer.set()
