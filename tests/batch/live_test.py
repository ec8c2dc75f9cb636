"""A camera's frames: the newest is taken, the others are counted, and all ends when it is told to."""

import threading
import time
from dataclasses import replace

import cv2
import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.batch.live import (
    LIVE_COLUMNS,
    LIVE_WIDTH,
    live_row,
    live_summary,
    reconstruct_live,
)
from endolab.io.video import write_video
from endolab.synthetic.scenes import Plane
from tests.tools.problems import moved_colon

BASE = datasets.load_calibration("simple", 64)
LIGHT = el.render(moved_colon(0), BASE.camera, BASE.photometry).photometry
UNKNOWN = el.Calibration(BASE.camera, replace(BASE.photometry, gain=None))
FEW = {"max_iterations": 2}


@pytest.fixture(scope="module")
def pictures():
    return [
        el.render(moved_colon(t), BASE.camera, LIGHT, bits=8).image for t in range(4)
    ]


def coming(pictures, count, every):
    """Frames of a camera, one after the other."""
    for number in range(count):
        yield f"{number:06d}", pictures[number % len(pictures)]
        time.sleep(every)


def readers():
    return [
        thread for thread in threading.enumerate() if thread.name == "endolab camera"
    ]


def patiently(named):
    """What comes of frames of a camera that waits until each is solved, so that all are taken."""
    solved = threading.Semaphore(0)
    steps = []

    def frames():
        for frame in named:
            yield frame
            solved.acquire()

    for step in reconstruct_live(frames(), UNKNOWN, **FEW):
        steps.append(step)
        solved.release()
    return steps


def test_a_slow_solver_takes_the_newest_and_counts_the_others(pictures):
    steps = []
    for step in reconstruct_live(coming(pictures, 60, 0.01), UNKNOWN, **FEW):
        steps.append(step)
        time.sleep(0.1)
    numbers = [step.index for step in steps]
    assert numbers == sorted(set(numbers))
    assert [step.dropped for step in steps] == list(np.diff([-1, *numbers]) - 1)
    assert sum(step.dropped for step in steps) >= 20
    assert numbers[-1] == 59  # the last is taken: nothing newer comes
    assert all(step.error == "" for step in steps)
    assert all(step.lag >= step.seconds > 0 for step in steps)
    assert live_summary([live_row(step) for step in steps], 2.0).startswith(
        f"taken {len(steps)} of 60"
    )
    assert not readers()


def test_a_fast_solver_takes_every_frame_as_a_sequence_would(pictures):
    named = [(str(n), picture) for n, picture in enumerate(pictures)]
    how = {"channel": "green", "regulariser": "second"} | FEW
    expected = el.reconstruct_sequence(named, UNKNOWN, **how)
    for a, b in zip(patiently(named), expected, strict=True):
        assert (a.name, a.dropped) == (b.name, 0)
        np.testing.assert_allclose(a.result.distance, b.result.distance, rtol=1e-6)


def test_it_ends_after_so_many_and_lets_the_camera_go(pictures):
    some = reconstruct_live(coming(pictures, 10**6, 0.01), UNKNOWN, limit=2, **FEW)
    assert len(list(some)) == 2
    assert not readers()
    endless = reconstruct_live(coming(pictures, 10**6, 0.01), UNKNOWN, **FEW)
    next(endless)
    endless.close()
    assert not readers()


def test_a_video_is_played_and_shrunk_and_lengths_go_with_it(tmp_path):
    large = datasets.load_calibration("simple", 400)
    seen = el.render(Plane(60, 0), large.camera, large.photometry, bits=8)
    write_video(tmp_path / "v.mkv", [seen.image] * 2)
    calibration = el.Calibration(large.camera, replace(large.photometry, gain=None))

    def first(**how):
        return next(
            reconstruct_live(tmp_path / "v.mkv", calibration, **how, **FEW)
        ).result

    result = first(known_distance=(60.0, 199.5, 149.5))  # straight ahead
    assert result.distance.shape == (240, LIVE_WIDTH)
    assert result.metric
    assert result.distance[120, 160] == pytest.approx(60, rel=0.01)
    mask = np.zeros((300, 400), np.uint8)
    mask[100:200, 100:300] = 255
    cv2.imwrite(str(tmp_path / "m.png"), mask)
    result = first(mask=tmp_path / "m.png", width=100)
    assert result.mask.shape == (75, 100)
    assert 0.9 < result.mask.sum() / (25 * 50) <= 1.1
    ends = first(known_diameter=(20, (100, 150), (300, 150))).points[120, [80, 240]]
    assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(20, rel=0.05)


def test_a_grey_camera_is_grey_and_a_broken_frame_is_named(pictures):
    grey = [picture[..., 1] for picture in pictures]
    steps = patiently([("a", grey[0]), ("small", grey[1][:30]), ("b", grey[2])])
    assert [step.error == "" for step in steps] == [True, False, True]
    rows = [live_row(step) for step in steps]
    assert "small is 64x30 px" in rows[1]["error"]
    assert "small" in live_summary(rows, 1.0)
    assert np.isnan(rows[1]["energy"])
    assert rows[2]["energy"] == steps[2].result.energy
    assert set(rows[2]) >= set(LIVE_COLUMNS)


def test_what_cannot_be_taken_is_one_sentence(pictures, tmp_path):
    with pytest.raises(ValueError, match="20x10 px"):
        next(reconstruct_live([("0", np.zeros((10, 20)))], UNKNOWN))
    with pytest.raises(ValueError, match="width"):
        next(reconstruct_live(coming(pictures, 1, 0), UNKNOWN, width=65))
    assert list(reconstruct_live([], UNKNOWN)) == []

    def unplugged():
        yield "0", pictures[0]
        plug.acquire()
        raise OSError("the camera was unplugged")

    plug = threading.Semaphore(0)
    steps = reconstruct_live(unplugged(), UNKNOWN, **FEW)
    assert next(steps).error == ""
    plug.release()
    with pytest.raises(OSError, match="unplugged"):
        next(steps)
    assert not readers()
