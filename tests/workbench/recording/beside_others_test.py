"""Recordings beside the user's own session of Rerun, and beside each other: nobody loses what was logged."""

import gc
import threading

import pytest
import rerun as rr

from endolab.workbench.recording.stream import Sink
from tests.tools.recorded import Recorded


@pytest.fixture(autouse=True)
def session():
    """No session of the user's before and after."""
    rr.set_global_data_recording(None)
    yield
    rr.disconnect()
    rr.set_global_data_recording(None)


@pytest.fixture
def begin(tmp_path):
    """Begin the user's session, which goes into a file."""

    def begin():
        rr.init("visitor")
        rr.save(tmp_path / "user.rrd")

    return begin


@pytest.fixture
def logged(tmp_path):
    """End the user's session, and return what it logged."""

    def logged():
        rr.disconnect()
        values = Recorded(tmp_path / "user.rrd").numbers("/mine", "scalars")
        return [value.item() for _, value in sorted(values.items())]

    return logged


def log(number):
    """Log as the user does."""
    rr.set_time("iteration", sequence=number)
    rr.log("mine", rr.Scalars(float(number)))


def started(path, count=3):
    """A recording of ours that holds so many numbers."""
    sink = Sink(path)
    for k in range(count):
        sink.at("iteration", k)
        sink.log("ours", rr.Scalars(float(k)))
    return sink


def count(path):
    return len(Recorded(path).numbers("/ours", "scalars"))


def fail(sink):
    with pytest.raises(ValueError, match="as it happens"), sink:
        raise ValueError("as it happens")


def leave(sink):
    with sink:
        pass


@pytest.mark.parametrize("end", [fail, leave, Sink.drop], ids=lambda end: end.__name__)
@pytest.mark.parametrize("when", ["before", "while it is open"])
def test_the_users_session_outlives_ours(begin, logged, tmp_path, end, when):
    if when == "before":
        begin()
        log(0)
    sink = started(tmp_path / "ours.rrd")
    if when == "while it is open":
        begin()
        log(0)
    log(1)
    end(sink)
    log(2)
    assert rr.get_application_id() == "visitor"
    assert logged() == [0, 1, 2]
    if end is leave:
        assert count(tmp_path / "ours.rrd") == 3
    else:
        assert [path.name for path in tmp_path.iterdir()] == ["user.rrd"]


def test_a_session_that_nobody_ends_outlives_one_of_ours_that_is_forgotten(
    begin, logged, tmp_path
):
    begin()
    started(tmp_path / "ours.rrd")
    gc.collect()
    log(0)
    assert logged() == [0]


def test_a_session_of_one_thread_stays_the_one_of_that_thread(tmp_path, logged):
    rr.set_thread_local_data_recording(rr.RecordingStream("the_thread"))
    rr.save(tmp_path / "user.rrd")
    log(0)
    started(tmp_path / "a.rrd").close()
    other = threading.Thread(target=lambda: started(tmp_path / "b.rrd").close())
    other.start()
    other.join()
    log(1)
    assert logged() == [0, 1]
    rr.set_thread_local_data_recording(None)


def test_two_at_once_are_whole_in_turns_and_in_threads_and_so_is_the_users(
    begin, logged, tmp_path
):
    begin()
    first, second = (started(tmp_path / f"{name}.rrd") for name in ("first", "second"))
    first.at("iteration", 3)
    first.log("ours", rr.Scalars(3.0))
    first.close()
    second.at("iteration", 3)
    second.log("ours", rr.Scalars(3.0))

    def many(name):
        for k in range(3):
            started(tmp_path / f"{name}{k}.rrd").close()

    threads = [threading.Thread(target=many, args=(name,)) for name in "ab"]
    for thread in threads:
        thread.start()
    for k in range(500):
        log(k)
    for thread in threads:
        thread.join()
    second.close()
    assert logged() == list(range(500))
    assert [count(tmp_path / f"{name}.rrd") for name in ("first", "second")] == [4, 4]
    assert [count(tmp_path / f"{name}{k}.rrd") for name in "ab" for k in range(3)] == [
        3
    ] * 6
