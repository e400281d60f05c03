"""A report whose process is killed: page and samples are complete or absent."""

import contextlib
import random
import threading
import time

import pytest
from long_form import rounds
from subjects import good

from magcal_ros.files import FileError, read_samples
from magcal_ros.report.write import write_to_the_end
from magcal_ros.ros.worker_process import WorkerLost, WorkerProcess

pytestmark = pytest.mark.faults


@pytest.mark.parametrize("attempt", range(rounds(1, 300)))
def test_a_kill_at_any_time_leaves_complete_files_or_none(tmp_path, attempt):
    subject, chance = good(), random.Random(attempt)
    worker = WorkerProcess()
    process = worker.start()

    def draw():
        with contextlib.suppress(WorkerLost):
            worker.run(write_to_the_end, tmp_path, subject)

    drawing = threading.Thread(target=draw)
    drawing.start()
    time.sleep(chance.uniform(0.3, 2.0))
    process.kill()
    drawing.join()
    samples, page = tmp_path / "samples.csv", tmp_path / "report.html"
    if samples.exists():
        assert len(read_samples(samples)) == len(subject.window)
    if page.exists():
        assert samples.exists()
        assert page.read_text().endswith("</html>\n")


def test_an_unwritable_page_is_reported(tmp_path):
    (tmp_path / "report.html").write_text("mine")
    worker = WorkerProcess()
    with pytest.raises(FileError, match="is not overwritten; choose another folder"):
        worker.run(write_to_the_end, tmp_path, good())
    worker.end()
    assert (tmp_path / "report.html").read_text() == "mine"
