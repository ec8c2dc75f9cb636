"""Detections that survive an interruption."""

from dataclasses import replace

import numpy as np
import pytest

from endolab.calibration.detection.detect import Detection
from endolab.calibration.targets import TARGETS
from endolab.io.detection_cache import Sightings
from endolab.io.images import write_image
from endolab.io.video import open_frames

TARGET = TARGETS["vicalib_small"]
FOUND = Detection(np.array([3, 5]), np.array([[1.25, 2.5], [100.0, 7.125]]))
NONE = Detection(np.zeros(0, int), np.zeros((0, 2)), "no dots")


@pytest.fixture
def frames(tmp_path):
    (tmp_path / "in").mkdir()
    for name in "abc":
        write_image(tmp_path / "in" / f"{name}.png", np.zeros((4, 4)))
    return open_frames(tmp_path / "in")


@pytest.fixture
def path(tmp_path, frames):
    with Sightings(tmp_path / "d.jsonl", frames, TARGET) as kept:
        kept.add("a.png", FOUND, (640, 480))
        kept.add("b.png", NONE, (640, 480))
    return tmp_path / "d.jsonl"


def test_what_was_found_comes_back(path, frames):
    kept = Sightings(path, frames, TARGET)
    assert list(kept.known) == ["a.png", "b.png"]
    assert kept.size == (640, 480)
    np.testing.assert_array_equal(kept.known["a.png"].ids, FOUND.ids)
    np.testing.assert_array_equal(kept.known["a.png"].pixels, FOUND.pixels)
    assert kept.known["b.png"].reason == "no dots"
    assert kept.known["b.png"].pixels.shape == (0, 2)


def test_a_line_that_was_cut_off_is_looked_for_again(path, frames):
    path.write_text(path.read_text()[:-5])
    with Sightings(path, frames, TARGET) as kept:
        assert list(kept.known) == ["a.png"]
        kept.add("b.png", NONE, (640, 480))
    assert list(Sightings(path, frames, TARGET).known) == ["a.png", "b.png"]


def test_an_interruption_keeps_what_was_done(path, frames):
    def interrupted():
        with Sightings(path, frames, TARGET) as kept:
            kept.add("c.png", FOUND, (640, 480))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert list(Sightings(path, frames, TARGET).known) == ["a.png", "b.png", "c.png"]


def test_another_target_or_other_frames_begin_anew(path, frames, tmp_path):
    assert Sightings(path, frames, replace(TARGET, spacing=5.0)).known == {}
    write_image(tmp_path / "in" / "a.png", np.ones((4, 4)))
    assert Sightings(path, open_frames(tmp_path / "in"), TARGET).known == {}


@pytest.mark.parametrize("content", [b"", b"\xff\xfe", b"[1]\n", b"{}\nnot json\n"])
def test_a_spoilt_file_begins_anew(path, frames, content):
    path.write_bytes(content)
    assert Sightings(path, frames, TARGET).known == {}


def test_a_place_that_cannot_be_written_is_named(frames, tmp_path):
    with (
        pytest.raises(OSError, match=r"cannot write .*d\.jsonl"),
        Sightings(tmp_path / "nowhere" / "d.jsonl", frames, TARGET),
    ):
        pass
