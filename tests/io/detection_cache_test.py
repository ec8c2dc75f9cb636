"""Detections that survive an interruption."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from endolab.calibration import session
from endolab.calibration.detection.detect import Detection
from endolab.calibration.targets import TARGETS
from endolab.datasets.known_endoscopes import load_calibration
from endolab.io.detection_cache import MARK, DetectionCache, detect_cached
from endolab.io.images import write_image
from endolab.io.video import Frames, open_frames

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
    with DetectionCache(tmp_path / "d.jsonl", frames, TARGET) as kept:
        kept.add("a.png", FOUND, (4, 4))
        kept.add("b.png", NONE, (4, 4))
    return tmp_path / "d.jsonl"


def test_what_was_found_comes_back(path, frames):
    kept = DetectionCache(path, frames, TARGET)
    assert (list(kept.known), kept.size) == (["a.png", "b.png"], (4, 4))
    np.testing.assert_array_equal(kept.known["a.png"].ids, FOUND.ids)
    np.testing.assert_array_equal(kept.known["a.png"].pixels, FOUND.pixels)
    assert (kept.known["b.png"].reason, kept.known["b.png"].pixels.shape) == ("no dots", (0, 2))


def test_a_line_that_was_cut_off_is_looked_for_again(path, frames):
    path.write_text(path.read_text()[:-5])
    with DetectionCache(path, frames, TARGET) as kept:
        assert list(kept.known) == ["a.png"]
        kept.add("b.png", NONE, (4, 4))
    assert list(DetectionCache(path, frames, TARGET).known) == ["a.png", "b.png"]


@pytest.mark.parametrize(
    "wrong", [b"3", b"{}", b"[" * 5000, b'["a.png", [4, 4], [], [], "", 1]', b"\xff\xfe"]
)
def test_a_damaged_line_is_looked_for_again_and_the_others_are_kept(path, frames, wrong):
    lines = path.read_bytes().split(b"\n")
    for spoilt in (wrong, lines[1].replace(b"7.125", b"8.125")):
        path.write_bytes(b"\n".join([lines[0], spoilt, *lines[2:]]))
        assert list(DetectionCache(path, frames, TARGET).known) == ["b.png"]


@pytest.fixture
def looked(monkeypatch):
    """A detector that finds nothing, and gives up at its second picture; the pictures it was shown."""
    shown = []

    def detect(image, target):
        shown.append(image)
        if len(shown) == 2:
            raise KeyboardInterrupt
        return NONE

    monkeypatch.setattr(session, "detect", detect)
    return shown


def test_an_interrupted_search_goes_on_where_it_was(looked, frames, tmp_path):
    said, told = [], []
    with pytest.raises(KeyboardInterrupt, match="interrupted; 1 of 3 frames are searched and kept"):
        detect_cached(frames, TARGET, tmp_path / "d.jsonl")
    for _ in range(2):  # the second time there is nothing left to do
        found, size = detect_cached(
            frames, TARGET, tmp_path / "d.jsonl", say=said.append, progress=lambda *what: told.append(what)
        )
        assert list(found) == ["a.png", "b.png", "c.png"]
        assert size == (4, 4)
    assert len(looked) == 2 + 2
    assert told == [("detecting", 1, 2), ("detecting", 2, 2)]
    assert said == [f"{n} of 3 frames were searched before; going on from there" for n in (1, 3)]


def test_a_search_for_a_camera_of_another_size_ends_at_once_and_leaves_nothing(looked, frames, tmp_path):
    camera = load_calibration("paper", width=32).camera
    with pytest.raises(ValueError, match=r"the camera is for 32x\d+ px, but the frames are 4x4 px"):
        detect_cached(frames, TARGET, tmp_path / "d.jsonl", camera=camera)
    assert looked == []
    assert not (tmp_path / "d.jsonl").exists()


def test_a_video_that_ends_early_says_so_of_its_last_frames_only(looked, frames, monkeypatch, tmp_path):
    looked += [None, None]
    monkeypatch.setattr(Frames, "is_video", True)
    monkeypatch.setattr(Frames, "stamp", [])
    pictures = {"a.png": None, "b.png": np.zeros((4, 4)), "c.png": None}
    monkeypatch.setattr(Frames, "read", lambda self, names: ((name, pictures[name]) for name in names))
    found, _ = detect_cached(frames, TARGET, tmp_path / "d.jsonl")
    assert [one.reason for one in found.values()] == [
        "it cannot be read",
        "no dots",
        "the video ends before it",
    ]


def test_another_target_or_other_frames_begin_anew(path, frames, tmp_path):
    assert DetectionCache(path, frames, replace(TARGET, spacing=5.0)).known == {}
    write_image(tmp_path / "in" / "a.png", np.ones((4, 4)))
    assert DetectionCache(path, open_frames(tmp_path / "in"), TARGET).known == {}


@pytest.mark.parametrize("content", [b"\xff\xfe", b"1}\nnot json\n", b"1}\nnull\n"])
def test_a_spoilt_file_begins_anew(path, frames, content):
    path.write_bytes(MARK + content)
    assert DetectionCache(path, frames, TARGET).known == {}
    head = path.read_bytes().split(b"\n")[0]
    for line in (b"null", b"[1, 2]", b'["a.png", [4, 4], [null], [], ""]'):
        path.write_bytes(head + b"\n" + line + b"\n")
        assert DetectionCache(path, frames, TARGET).known == {}


@pytest.mark.parametrize("content", [b"", b"\xff\xfe", b"[1]\n", b"my own notes"])
def test_the_file_of_another_is_not_replaced_unasked(path, frames, content):
    path.write_bytes(content)
    with pytest.raises(FileExistsError, match=r"d\.jsonl is there already"):
        DetectionCache(path, frames, TARGET)
    assert path.read_bytes() == content
    assert DetectionCache(path, frames, TARGET, overwrite=True).known == {}


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no full disk here")
def test_a_full_disk_is_said_in_one_sentence(path, frames):
    said = pytest.raises(OSError, match=r"^cannot write .*d\.jsonl: No space left on device$")
    kept = DetectionCache(path, frames, TARGET)
    with said, kept:
        kept._stream.close()
        kept._stream = Path("/dev/full").open("wb", buffering=0)  # noqa: SIM115
        kept.add("c.png", FOUND, (4, 4))


def test_a_place_that_cannot_be_written_is_named(frames, tmp_path):
    with (
        pytest.raises(OSError, match=r"cannot write .*d\.jsonl"),
        DetectionCache(tmp_path / "nowhere" / "d.jsonl", frames, TARGET),
    ):
        pass
