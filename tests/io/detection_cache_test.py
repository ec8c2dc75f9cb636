"""Detections that survive an interruption."""

from dataclasses import replace

import numpy as np
import pytest

from endolab.calibration import session
from endolab.calibration.detection.detect import Detection
from endolab.calibration.targets import TARGETS
from endolab.io.detection_cache import detect_cached
from endolab.io.images import write_image
from endolab.io.video import open_frames

TARGET = TARGETS["vicalib_small"]
FOUND = Detection(np.array([3, 5]), np.array([[1.25, 2.5], [100.0, 7.125]]))


@pytest.fixture
def looked(monkeypatch):
    """A detector that gives up at its second picture; the pictures it was shown."""
    shown = []

    def detect(image, target):
        shown.append(image)
        if len(shown) == 2:
            raise KeyboardInterrupt
        return FOUND

    monkeypatch.setattr(session, "detect", detect)
    return shown


@pytest.fixture
def search(looked, tmp_path):
    """A search of three frames that was interrupted at the second."""
    (tmp_path / "in").mkdir()
    for name in "abc":
        write_image(tmp_path / "in" / f"{name}.png", np.zeros((4, 4)))

    def search(target=TARGET, **how):
        return detect_cached(
            open_frames(tmp_path / "in"), target, tmp_path / "d.jsonl", **how
        )

    with pytest.raises(KeyboardInterrupt, match="1 of 3 frames"):
        search()
    return search


def test_an_interrupted_search_goes_on_where_it_was(search, looked):
    messages = []
    for _ in range(2):  # the second time there is nothing left to do
        found, size = search(say=messages.append)
        assert (list(found), size) == (["a.png", "b.png", "c.png"], (4, 4))
        np.testing.assert_array_equal(found["a.png"].ids, FOUND.ids)
        np.testing.assert_array_equal(found["a.png"].pixels, FOUND.pixels)
    assert len(looked) == 2 + 2
    assert len(messages) == 2


@pytest.mark.parametrize(
    "line", ["", "null", "[" * 5000, '["a.png", [4, 4], [null], [], ""]', "\udcff"]
)
def test_a_line_that_is_cut_off_or_damaged_is_looked_for_again(
    search, looked, tmp_path, line
):
    head = (tmp_path / "d.jsonl").read_text().split("\n")[0]
    (tmp_path / "d.jsonl").write_text(f"{head}\n{line}\n", errors="surrogateescape")
    assert len(search()[0]) == 3
    assert len(looked) == 2 + 3


def test_another_target_or_other_frames_begin_anew(search, looked, tmp_path):
    search(replace(TARGET, spacing=5.0))
    assert len(looked) == 2 + 3
    search()
    assert len(looked) == 2 + 3 + 3
    write_image(tmp_path / "in" / "a.png", np.ones((4, 4)))
    search()
    assert len(looked) == 2 + 3 + 3 + 3


@pytest.mark.parametrize("content", [b"", b"\xff\xfe", b"my own notes"])
def test_the_file_of_another_is_not_replaced_unasked(search, tmp_path, content):
    (tmp_path / "d.jsonl").write_bytes(content)
    with pytest.raises(FileExistsError, match=r"d\.jsonl"):
        search()
    assert (tmp_path / "d.jsonl").read_bytes() == content
    assert len(search(overwrite=True)[0]) == 3


def test_what_is_left_out_is_neither_read_nor_taken_for_the_others_size(
    search, looked, tmp_path
):
    """A first picture of another size, which an earlier call had searched."""
    for name in "bc":
        write_image(tmp_path / "in" / f"{name}.png", np.zeros((6, 8)))
    (tmp_path / "in" / "d.png").write_bytes(b"no picture")
    with pytest.raises(ValueError, match=r"differ in size.*4x4.*8x6.*--leave-out"):
        search()
    found, size = search(leave_out=["a.png", "d.png"])
    assert size == (8, 6)
    assert [found[name].reason for name in ("a.png", "d.png")] == [
        session.LEFT_OUT_REASON
    ] * 2
    assert len(found["c.png"].ids)
