"""Videos, sweeps and cameras on the command line: they go on where they were, and Ctrl-C ends a live view."""

import csv
import os
import signal
import time
from dataclasses import replace

import cv2
import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.cli import main as cli
from endolab.io.images import write_image
from endolab.io.video import write_video
from tests.tools.problems import moved_colon
from tests.tools.recorded import Recorded


class Camera:
    """A camera of OpenCV's that sees these pictures, and whose user presses Ctrl-C after so many."""

    def __init__(self, pictures, end):
        self.pictures = pictures
        self.end = end
        self.count = 0

    def isOpened(self):
        return True

    def set(self, what, value):
        return True

    def read(self):
        time.sleep(0.2)
        self.count += 1
        if self.count == self.end:
            os.kill(os.getpid(), signal.SIGINT)
        return True, np.round(255 * self.pictures[self.count % 3]).astype(np.uint8)[
            ..., ::-1
        ]

    def release(self):
        pass


@pytest.fixture(scope="module")
def pictures():
    base = datasets.load_calibration("simple", 48)
    lit = el.render(moved_colon(0), base.camera, base.photometry).photometry
    return [el.render(moved_colon(t), base.camera, lit, bits=8).image for t in range(3)]


@pytest.fixture
def here(tmp_path, monkeypatch, pictures):
    """A folder with a film and its calibration."""
    base = datasets.load_calibration("simple", 48)
    el.write_calibration(
        el.Calibration(base.camera, replace(base.photometry, gain=None)),
        tmp_path / "cal.json",
    )
    (tmp_path / "film").mkdir()
    for number, picture in enumerate(pictures):
        write_image(tmp_path / f"film/{number}.png", picture)
    write_video(tmp_path / "v.mkv", pictures * 2, rate=8.0)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def call(here, capsys):
    """Run a command; its exit code, and what it said on stdout and stderr."""

    def run(words):
        return cli.main(
            [*words.split(), "--calibration", "cal.json"]
        ), *capsys.readouterr()

    return run


def rows(path):
    with open(path, newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_a_video_goes_on_and_tells_what_became_of_it(call, here):
    assert call("reconstruct film --out o --limit 1 --solver facing")[0] == 0
    (here / "film/2.png").write_bytes(b"broken")
    code, output, error = call("reconstruct film --out o --solver facing")
    assert (code, error) == (0, "")
    for words in ("2 of 3", "earlier call: 1", "not done: 2.png", "relative", ".rrd"):
        assert words in output
    assert len(rows(here / "o/frames.csv")) == 3
    code, _, error = call("reconstruct film --out o --solver facing --lam 3")
    assert (code, error.count("\n"), "--overwrite" in error) == (2, 1, True)
    assert (
        call("reconstruct v.mkv --out w --every 4 --solver facing --width 32")[0] == 0
    )
    assert [row["frame"] for row in rows(here / "w/frames.csv")] == ["000000", "000004"]


def test_a_sweep_goes_on_and_tells_what_became_of_it(call, here):
    code, output, _ = call(
        "sweep film/0.png film/1.png --lam 0.1,1 --xi d --max-iterations 3"
    )
    assert (code, "4 of 4 rows" in output) == (0, True)
    code, output, _ = call(
        "sweep film/0.png none.png --lam 1,10 --xi d --max-iterations 3"
    )
    assert code == 0
    for words in ("2 of 4 rows", "not done: none.png", "earlier call: 1"):
        assert words in output
    assert len(rows(here / "sweep.csv")) == 7


def test_ctrl_c_ends_a_live_view_with_its_files_written(
    call, here, monkeypatch, pictures
):
    monkeypatch.setattr(cv2, "VideoCapture", lambda *which: Camera(pictures, 6))
    # a shell in the background ignores it.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        code, output, error = call("reconstruct 0 --out o --max-iterations 2")
    finally:
        signal.signal(signal.SIGINT, before)
    assert (code, error) == (0, "")
    assert "taken " in output
    table = rows(here / "o/frames.csv")
    assert sum(1 + int(row["dropped"]) for row in table) <= 6
    with np.load(here / "o/depth.npz", allow_pickle=False) as depth:
        middle = np.median(depth["distance"][depth["mask"]])
    assert middle == pytest.approx(float(table[-1]["median_distance"]), rel=1e-6)
    lags = Recorded(here / "o/recording.rrd").numbers("/plots/lag", "scalars")
    assert list(map(str, lags)) == [row["index"] for row in table]


def test_a_video_is_played_live(call, here):
    started = time.monotonic()
    code, output, _ = call(
        "reconstruct v.mkv --live --out o --max-iterations 2 --limit 100"
    )
    assert (code, time.monotonic() - started > 5 / 8) == (0, True)
    assert "of 6 frames" in output
    # It is endolab's own.
    code, output, _ = call("reconstruct v.mkv --live --out o --max-iterations 2")
    assert code == 0


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("reconstruct 0 --live --every 2", "--every"),
        ("reconstruct film --out o --mesh", "--mesh"),
        ("reconstruct film 0.png --out o", "sweep"),
        ("reconstruct 99 --out o", "camera 99"),
        ("reconstruct nothing://x --out o", "nothing://x"),
        ("reconstruct film --live --out o", "film"),
        ("sweep film/0.png --out cal.json", "cal.json"),
    ],
)
def test_what_cannot_be_done_is_one_sentence_and_writes_nothing(
    call, here, words, named
):
    before = sorted(here.rglob("*"))
    code, _, error = call(words)
    assert (code, error.count("\n"), named in error) == (2, 1, True), error
    assert sorted(here.rglob("*")) == before
