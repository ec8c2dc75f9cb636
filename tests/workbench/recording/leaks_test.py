"""Many recordings leave no file, few threads and little memory behind."""

import gc
import shutil

import numpy as np
import psutil
import pytest

import endolab as el
from endolab.workbench.recording import show as embed
from tests.tools.problems import coloured_colon

RUNS = 25
FEW = 3  # after which all is loaded that stays
GROWTH = 2e6  # bytes for each run: what Rerun keeps of a layout


@pytest.fixture(scope="module")
def solved():
    problem, _ = coloured_colon(el.load_calibration("paper", width=48).camera)
    return el.Iterate.of(problem, problem.log_d0)


def run(iterate, folder):
    recorder = el.record(folder / "run.rrd")
    recorder(iterate)
    recorder.close()


def failed(iterate, folder):
    """A run whose file cannot be written in the end."""
    (folder / "gone").mkdir()
    recorder = el.record(folder / "gone" / "run.rrd")
    recorder(iterate)
    shutil.rmtree(folder / "gone")
    with pytest.raises(OSError, match=r"run\.rrd"):
        recorder.close()


def begun(iterate, folder):
    """A run that never comes to its first iterate."""
    el.record(folder / "run.rrd").close()


def dilate(action, count):
    """How many threads, files and bytes there are more, after that many more times."""
    me = psutil.Process()

    def state():
        gc.collect()
        files = me.num_fds() if hasattr(me, "num_fds") else 0
        return np.array([me.num_threads(), files, me.memory_info().rss])

    for _ in range(FEW):
        action()
    before = state()
    for _ in range(count):
        action()
    return state() - before


@pytest.mark.parametrize("action", [run, failed, begun], ids=lambda one: one.__name__)
def test_recordings_leave_nothing(action, solved, tmp_path):
    threads, files, memory = dilate(lambda: action(solved, tmp_path), RUNS)
    # Rerun keeps two idle threads for each layout that it was given, and no way to let them go.
    assert threads <= 2 * RUNS
    assert files == 0
    assert memory < GROWTH * RUNS


def test_reading_and_showing_leave_nothing(solved, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(embed, "front_end", lambda: False)
    monkeypatch.setattr(embed, "_display", lambda figure: None)
    run(solved, tmp_path)
    threads, files, memory = dilate(lambda: embed.show(tmp_path / "run.rrd"), 15)
    assert (threads, files) == (0, 0)
    assert memory < 15 * GROWTH  # with what Matplotlib keeps at first
