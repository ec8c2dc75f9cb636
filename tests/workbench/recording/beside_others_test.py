"""Recordings beside the user's own session of Rerun, and many of them: nobody loses what was logged."""

import gc

import psutil
import pytest
import rerun as rr

import endolab as el
from endolab.workbench.recording.stream import Sink
from tests.tools.problems import coloured_colon
from tests.tools.recorded import Recorded

RUNS = 20


@pytest.fixture(autouse=True)
def session():
    """No session of the user's before and after."""
    rr.set_global_data_recording(None)
    yield
    rr.disconnect()
    rr.set_global_data_recording(None)


def begin(folder):
    """Begin the user's session, which goes into a file."""
    rr.init("visitor")
    rr.save(folder / "user.rrd")


def log(number):
    """Log as the user does."""
    rr.set_time("iteration", sequence=number)
    rr.log("mine", rr.Scalars(float(number)))


def logged(path, entity="/mine"):
    values = Recorded(path).numbers(entity, "scalars")
    return [value.item() for _, value in sorted(values.items())]


def started(path):
    """A recording of ours that holds three numbers."""
    sink = Sink(path)
    for k in range(3):
        sink.at("iteration", k)
        sink.log({"ours": rr.Scalars(float(k))})
    return sink


def fail(sink):
    with pytest.raises(ValueError, match="as it happens"), sink:
        raise ValueError("as it happens")


@pytest.mark.parametrize(
    "end",
    [fail, Sink.close, lambda sink: sink.close(failed=True), lambda sink: gc.collect()],
)
@pytest.mark.parametrize("first", ["ours", "the user's"])
def test_the_users_session_outlives_ours(tmp_path, end, first):
    if first == "ours":
        sink = started(tmp_path / "ours.rrd")
        begin(tmp_path)
    else:
        begin(tmp_path)
        log(-1)
        sink = started(tmp_path / "ours.rrd")
    log(0)
    end(sink)
    log(1)
    assert rr.get_application_id() == "visitor"
    rr.disconnect()
    assert logged(tmp_path / "user.rrd")[-2:] == [0, 1]
    assert (tmp_path / "ours.rrd").exists() == (end is Sink.close)


@pytest.mark.parametrize("alone", [True, False])
def test_many_recordings_leave_no_file_few_threads_and_little_memory(tmp_path, alone):
    if not alone:
        begin(tmp_path)
    problem, _ = coloured_colon(el.load_calibration("paper", width=48).camera)
    iterate = el.Iterate.of(problem, problem.log_d0)
    me = psutil.Process()
    before = []
    for k in range(RUNS + 3):
        folder = tmp_path / str(k)
        folder.mkdir()
        el.record(folder / "begun.rrd").close()
        recorder = el.record(folder / "run.rrd")
        recorder(iterate)
        if k % 2:  # its file cannot be written
            folder.rmdir()
            with pytest.raises(OSError, match=r"run\.rrd"):
                recorder.close()
        else:
            recorder.close()
        if k == 2:  # all is loaded that stays
            gc.collect()
            before = [me.num_threads(), me.memory_info().rss, len(me.open_files())]
    gc.collect()
    assert me.num_threads() - before[0] <= 12
    assert me.memory_info().rss - before[1] < 2e6 * RUNS
    assert len(me.open_files()) == before[2]
