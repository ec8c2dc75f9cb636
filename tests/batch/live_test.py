"""A camera's frames: the newest is taken, the others are counted, and all ends when it is told to."""

import threading
import time
from dataclasses import replace

import cv2
import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.batch.live import LIVE_WIDTH, Newest, Tally, live_row, reconstruct_live
from endolab.io.video import write_video
from endolab.preprocessing.frame import shrunk_bytes
from tests.tools.problems import moved_colon

BASE = datasets.load_calibration("simple", 64)
LIGHT = el.render(moved_colon(0), BASE.camera, BASE.photometry).photometry
UNKNOWN = el.Calibration(BASE.camera, replace(BASE.photometry, gain=None))
FEW = {"max_iterations": 2}


@pytest.fixture(scope="module")
def pictures():
    return [el.render(moved_colon(t), BASE.camera, LIGHT, bits=8).image for t in range(4)]


def coming(pictures, count, every):
    """Frames of a camera, one after the other."""
    for number in range(count):
        yield f"{number:06d}", pictures[number % len(pictures)]
        time.sleep(every)


def readers():
    return [thread for thread in threading.enumerate() if thread.name == "endolab camera"]


def test_only_the_newest_is_kept():
    gate, seen = threading.Semaphore(0), threading.Semaphore(0)

    def frames():
        for number in range(6):
            gate.acquire()
            yield str(number), np.full((2, 2), number / 10)
            seen.release()  # asked for the next, it has kept this one

    newest = Newest(frames())
    for batch, last in ((1, 0), (3, 3), (2, 5)):
        for _ in range(batch):
            gate.release()
            seen.acquire()
        shot = newest.take()
        assert (shot.count, shot.name, shot.picture[0, 0]) == (last, str(last), last / 10)
    assert newest.take() is None
    newest.close()
    assert not readers()


def test_a_slow_solver_drops_frames_and_counts_them(pictures):
    steps, tally = [], Tally()
    for step in reconstruct_live(coming(pictures, 60, 0.01), UNKNOWN, **FEW):
        steps.append(step)
        tally.add(step)
        time.sleep(0.1)
    numbers = [step.index for step in steps]
    assert numbers == sorted(set(numbers))
    assert [step.dropped for step in steps] == list(np.diff([-1, *numbers]) - 1)
    assert sum(step.dropped for step in steps) >= 20
    assert numbers[-1] == 59  # the last is taken: nothing newer comes
    assert all(step.error == "" for step in steps)
    assert all(step.lag >= step.seconds > 0 for step in steps)
    assert str(tally).startswith(f"taken {len(steps)} of 60 frames, ")
    assert 0 < tally.rate < 10
    assert not readers()


def test_a_fast_solver_takes_every_frame_as_a_sequence_would(pictures):
    named = [(str(n), picture) for n, picture in enumerate(pictures)]
    live = patiently(named)
    expected = el.reconstruct_sequence(named, UNKNOWN, channel="green", regulariser="second", **FEW)
    for a, b in zip(live, expected, strict=True):
        assert (a.name, a.dropped) == (b.name, 0)
        np.testing.assert_array_equal(a.result.distance, b.result.distance)


def patiently(named):
    """What comes of frames of a camera that waits until each is solved, so that all are taken."""
    solved, steps = threading.Semaphore(0), []

    def frames():
        for frame in named:
            yield frame
            solved.acquire()

    for step in reconstruct_live(frames(), UNKNOWN, **FEW):
        steps.append(step)
        solved.release()
    return steps


def test_it_ends_after_so_many_and_lets_the_camera_go(pictures):
    assert len(list(reconstruct_live(coming(pictures, 10**6, 0.01), UNKNOWN, limit=2, **FEW))) == 2
    assert not readers()
    endless = reconstruct_live(coming(pictures, 10**6, 0.01), UNKNOWN, **FEW)
    next(endless)
    endless.close()
    assert not readers()


def test_wide_pictures_are_shrunk_by_light_as_frames_are(rng):
    stored = rng.integers(0, 256, (60, 80, 3), dtype=np.uint8)
    whole = np.ones((60, 80), dtype=bool)
    expected = el.Frame(stored / 255, whole).resize(32, 24, 2.2).image
    np.testing.assert_allclose(shrunk_bytes(stored, 32, 24, 2.2), expected, atol=2e-6)


def test_a_video_is_played_and_shrunk_and_lengths_go_with_it(tmp_path):
    large = datasets.load_calibration("simple", 400)
    seen = el.render(el.Plane(60, 0), large.camera, large.photometry, bits=8)
    write_video(tmp_path / "v.mkv", [seen.image] * 2)
    known = {"known_distance": (60.0, 199.5, 149.5)}  # straight ahead
    calibration = el.Calibration(large.camera, replace(large.photometry, gain=None))
    step = next(reconstruct_live(tmp_path / "v.mkv", calibration, **known, **FEW))
    assert step.result.distance.shape == (240, LIVE_WIDTH)
    assert step.result.metric
    assert step.result.distance[120, 160] == pytest.approx(60, rel=0.01)
    mask = np.zeros((300, 400), np.uint8)
    mask[100:200, 100:300] = 255
    cv2.imwrite(str(tmp_path / "m.png"), mask)
    how = {"mask": tmp_path / "m.png", "width": 100}
    step = next(reconstruct_live(tmp_path / "v.mkv", calibration, **how, **FEW))
    assert step.result.mask.shape == (75, 100)
    assert 0.9 < step.result.mask.sum() / (25 * 50) <= 1.1
    known = {"known_diameter": (20, (100, 150), (300, 150))}
    step = next(reconstruct_live(tmp_path / "v.mkv", calibration, **known, **FEW))
    ends = step.result.points[120, [80, 240]]
    assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(20, rel=0.05)


def test_a_grey_camera_is_grey_and_a_broken_frame_is_named(pictures):
    grey = [picture[..., 1] for picture in pictures]
    steps = patiently([("a", grey[0]), ("small", grey[1][:30]), ("b", grey[2])])
    assert [step.error == "" for step in steps] == [True, False, True]
    assert "small is 64x30 px, but the calibration is for 64x48 px" in steps[1].error
    tally = Tally()
    for step in steps:
        tally.add(step)
    assert "1 could not be used, such as small is 64x30 px" in str(tally)
    assert np.isnan(live_row(steps[1])["energy"])
    assert live_row(steps[2])["energy"] == steps[2].result.energy


def test_what_cannot_be_taken_is_one_sentence(pictures, tmp_path):
    with pytest.raises(ValueError, match="0 is 20x10 px, but the calibration is for 64x48 px"):
        next(reconstruct_live([("0", np.zeros((10, 20)))], UNKNOWN))
    with pytest.raises(ValueError, match="width must be at most the picture's 64 px, got 65"):
        next(reconstruct_live(coming(pictures, 1, 0), UNKNOWN, width=65))
    with pytest.raises(ValueError, match="limit"):
        next(reconstruct_live(coming(pictures, 1, 0), UNKNOWN, limit=0))
    with pytest.raises(FileNotFoundError, match="there is no such video"):
        next(reconstruct_live(tmp_path / "none.mkv", UNKNOWN))
    assert list(reconstruct_live([], UNKNOWN)) == []

    def unplugged():
        yield "0", pictures[0]
        plug.acquire()
        raise OSError("the camera was unplugged")

    plug = threading.Semaphore(0)
    steps = reconstruct_live(unplugged(), UNKNOWN, **FEW)
    assert next(steps).error == ""
    plug.release()
    with pytest.raises(OSError, match="the camera was unplugged"):
        next(steps)
    assert not readers()
