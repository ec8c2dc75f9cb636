"""A live view: what it shows, and that a viewer that is slow or gone stops nobody."""

import time

import numpy as np
import psutil
import pytest

import endolab as el
from endolab.recording import live as live_module
from endolab.recording.live import CURVES, LiveView
from endolab.recording.viewer import _servers, start_server
from tests.tools.recorded import Recorded


@pytest.fixture(scope="module")
def result():
    calibration = el.load_calibration("paper", width=64)
    scene = el.render(el.SCENES["tube"], calibration.camera, calibration.photometry)
    known = el.Calibration(scene.camera, scene.photometry)
    return el.reconstruct(el.Frame(scene.image, scene.mask), known, solver="facing")


def scalars(number):
    return dict(zip([name for (name,) in CURVES.values()], (15.0, 70.0, 1.0, 30.0 + number), strict=True))


def show(view, result, numbers):
    """Show frames, each as soon as the last is done."""
    for number in numbers:
        view(number, result, scalars(number))
        until = time.monotonic() + 20
        while view.shown < numbers.index(number) + 1 and time.monotonic() < until:
            time.sleep(0.005)


@pytest.fixture
def server():
    """A server that takes what a viewer takes, and its processes."""
    address = start_server()
    yield address, psutil.Process(_servers[-1].pid).children(recursive=True)
    for child in psutil.Process(_servers[-1].pid).children(recursive=True):
        child.resume()


def test_a_file_holds_pictures_surface_rate_lag_and_what_was_dropped(result, tmp_path):
    view = LiveView(tmp_path / "live.rrd")
    show(view, result, [0, 3, 4])
    view.close()
    view.close()
    file = Recorded(tmp_path / "live.rrd")
    plots = {f"/plots/{name}" for (name,) in CURVES.values()}
    scales = {"/scales/depth/bar", "/scales/depth/words"}
    maps = {"/input", "/depth", "/normals", "/world", "/world/camera", "/world/cloud"}
    assert file.entities == maps | plots | scales
    low, high = file.numbers("/depth", "depth_range")[0]
    labels = file.rows["/scales/depth/words"]["labels"][None].to_pylist()
    assert labels == [f"{value:.3g}" for value in (high, (low + high) / 2, low)]
    assert list(file.numbers("/depth", "buffer")) == [0, 3, 4]
    assert [value.item() for value in file.numbers("/plots/median_distance", "scalars").values()] == [
        30,
        33,
        34,
    ]
    values = file.numbers("/depth", "buffer")[3].astype(np.uint8).tobytes()
    stored = np.frombuffer(values, np.float32).reshape(result.distance.shape)
    assert np.array_equal(stored, result.distance.astype(np.float32), equal_nan=True)
    normals = file.picture("/normals", 4).astype(float)
    assert np.abs(normals - 255 * (result.normals + 1) / 2)[result.mask].mean() < 6  # grey levels, of a JPEG


def test_what_comes_too_fast_is_left_out_and_the_newest_is_shown(result, tmp_path):
    view = LiveView(tmp_path / "live.rrd")
    started = time.perf_counter()
    for number in range(300):
        view(number, result, scalars(number))
    assert time.perf_counter() - started < 0.5
    view.close()
    shown = list(Recorded(tmp_path / "live.rrd").numbers("/depth", "buffer"))
    assert shown[-1] == 299
    assert len(shown) == view.shown
    assert view.shown + view.left_out == 300
    assert view.left_out > 0


def test_a_file_has_an_end(result, tmp_path, monkeypatch):
    monkeypatch.setattr(live_module, "KEPT", 2)
    view = LiveView(tmp_path / "live.rrd")
    show(view, result, [0, 1])
    assert view.full
    view(2, result, scalars(2))
    view.close()
    assert list(Recorded(tmp_path / "live.rrd").numbers("/depth", "buffer")) == [0, 1]
    assert view.left_out == 1


def test_a_viewer_gets_the_frames(result, server):
    view = LiveView(address=server[0])
    show(view, result, [0, 1, 2])
    assert (view.shown, view.left_out, view.gone) == (3, 0, False)
    view.close()


def test_a_viewer_that_hangs_stops_nobody_and_fills_no_memory(result, server):
    """What the sockets between do not take waits, and of it the newest alone."""
    address, processes = server
    view = LiveView(address=address)
    show(view, result, [0])
    for process in processes:
        process.suspend()
    slowest = 0.0
    for number in range(1, 400):
        started = time.perf_counter()
        view(number, result, scalars(number))
        slowest = max(slowest, time.perf_counter() - started)
        time.sleep(0.005)
    before = psutil.Process().memory_info().rss
    for number in range(400, 800):
        view(number, result, scalars(number))
        time.sleep(0.005)
    assert slowest < 5  # else it would be for good
    assert view.shown < 400
    assert view.left_out > 300
    assert psutil.Process().memory_info().rss - before < 30e6
    for process in processes:
        process.resume()
    seen, until = view.shown, time.monotonic() + 20
    while view.shown == seen and time.monotonic() < until:
        view(900, result, scalars(900))
        time.sleep(0.05)
    assert view.shown > seen
    view.close()


def test_a_viewer_that_is_gone_is_said(result, server):
    address, processes = server
    view = LiveView(address=address)
    show(view, result, [0])
    for process in processes:
        process.kill()
    until = time.monotonic() + 20
    while not view.gone and time.monotonic() < until:
        view(1, result, scalars(1))
        time.sleep(0.05)
    assert view.gone
    started = time.monotonic()
    view.close()
    assert time.monotonic() - started < 10


def test_a_file_that_cannot_be_written_is_named(result, tmp_path):
    (tmp_path / "gone").mkdir()
    view = LiveView(tmp_path / "gone" / "live.rrd")
    show(view, result, [0])
    (tmp_path / "gone").rmdir()
    with pytest.raises(OSError, match=r"cannot write .*live\.rrd"):
        view.close()
