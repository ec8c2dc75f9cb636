"""A camera on the command line: `endolab reconstruct 0 --live`, which Ctrl-C ends with a summary."""

import csv
import time
from dataclasses import replace

import cv2
import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.batch import live
from endolab.cli import main as cli
from endolab.cli.streams import ONCE
from endolab.io.surfaces import read_depth
from endolab.io.video import write_video
from endolab.recording import live as live_module
from tests.tools.problems import moved_colon
from tests.tools.recorded import Recorded


class Camera:
    """A camera of OpenCV's that sees these pictures, one every so many seconds, and then fails as told."""

    def __init__(self, pictures, every=0.05, then=None):
        self.pictures = iter(pictures)
        self.every, self.then = every, then

    def isOpened(self):
        return True

    def set(self, what, value):
        return True

    def read(self):
        time.sleep(self.every)
        stored = next(self.pictures, None)
        return stored is not None, stored

    def release(self):
        pass


@pytest.fixture(scope="module")
def pictures():
    base = datasets.load_calibration("simple", 48)
    lit = el.render(moved_colon(0), base.camera, base.photometry).photometry
    return [el.render(moved_colon(t), base.camera, lit, bits=8).image for t in range(3)]


@pytest.fixture
def calibration(tmp_path):
    base = datasets.load_calibration("simple", 48)
    el.Calibration(base.camera, replace(base.photometry, gain=None)).save(tmp_path / "cal.json")
    return tmp_path / "cal.json"


@pytest.fixture
def call(calibration, capsys):
    """Run the command on a source; its exit code, and what it said on stdout and stderr.

    But for that it compiles, which it does where no other test has done so.
    """

    def run(source, *options):
        command = ["reconstruct", source, "--calibration", calibration, "--max-iterations", 2, *options]
        code, (said, complaint) = cli.main([str(word) for word in command]), capsys.readouterr()
        return code, said, complaint.removeprefix(f"{ONCE}\n")

    return run


@pytest.fixture
def camera(monkeypatch, pictures):
    """Put a camera there that sees so many frames."""

    def put(count, **how):
        stored = [np.round(255 * pictures[n % 3]).astype(np.uint8)[..., ::-1] for n in range(count)]
        monkeypatch.setattr(cv2, "VideoCapture", lambda *which: Camera(stored, **how))

    return put


class Shown:
    """In place of the view on a screen."""

    def __init__(self, after=None, failure=None):
        self.numbers, self.after, self.failure = [], after, failure
        self.left_out, self.full, self.closed = 0, False, 0

    @property
    def gone(self):
        return self.failure is None and self.after is not None and len(self.numbers) >= self.after

    def __call__(self, number, result, scalars):
        self.numbers.append(number)
        assert set(scalars) == {"rate", "lag", "dropped", "median_distance"}
        if self.failure is not None and len(self.numbers) == self.after:
            raise self.failure

    def close(self):
        self.closed += 1


@pytest.fixture
def screen(monkeypatch):
    """Show live views here."""

    def put(view):
        real = live_module.LiveView
        monkeypatch.setattr(live_module, "LiveView", lambda path=None: view if path is None else real(path))
        return view

    return put


def rows(out):
    with open(out / "frames.csv", newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_a_camera_becomes_a_folder(call, camera, tmp_path):
    camera(4, every=0.5)
    status, said, complaint = call(0, "--out", tmp_path / "out")
    assert (status, complaint) == (0, "")
    told = said.splitlines()
    assert told[0] == "live: 48 px wide, channel green (--width, --channel); Ctrl-C ends it"
    assert told[1].startswith("taken ")
    assert " of 4 frames, " in told[1]
    assert "frames/s, lag " in told[1]
    what = "depth.npz (the last frame's), frames.csv (a row for each frame taken), "
    assert told[-1] == f"written to {tmp_path / 'out'}: {what}recording.rrd (the surfaces)"
    table = rows(tmp_path / "out")
    depth = read_depth(tmp_path / "out" / "depth.npz")
    known = depth["distance"][depth["mask"]]
    assert np.median(known) == pytest.approx(float(table[-1]["median_distance"]), rel=1e-6)
    assert (depth["distance"].shape[1], bool(depth["metric"])) == (48, False)
    assert sum(1 + int(row["dropped"]) for row in table) == 4
    shown = Recorded(tmp_path / "out" / "recording.rrd").numbers("/plots/lag", "scalars")
    assert {row["index"] for row in table} >= set(map(str, shown))
    again, _, complaint = call(0, "--out", tmp_path / "out")  # made by endolab, so it may be replaced
    assert (again, complaint) == (0, "")


def test_without_a_surface_there_is_no_depth(call, camera, monkeypatch, tmp_path):
    camera(3, every=0.2)
    real = live.LiveStep
    nothing = {"result": None, "error": "it is dark"}
    monkeypatch.setattr(live, "LiveStep", lambda **seen: real(**seen | nothing))
    status, said, complaint = call(0, "--out", tmp_path / "out")
    assert (status, complaint) == (0, "")
    assert "could not be used, such as it is dark" in said
    assert not (tmp_path / "out" / "depth.npz").exists()
    assert "depth.npz" not in said


def test_ctrl_c_is_how_a_live_view_ends(call, camera, screen):
    view = screen(Shown(3, KeyboardInterrupt()))
    camera(10**4)
    status, said, complaint = call(0, "--live")
    assert (status, complaint, view.closed) == (0, "", 1)
    assert "taken 3 of " in said
    assert "written" not in said


def test_closing_the_window_ends_it_too_and_what_was_to_be_written_is(call, camera, screen, tmp_path):
    view = screen(Shown(2))
    camera(10**4)
    assert call(0, "--live")[0] == 0
    assert len(view.numbers) == 2
    screen(Shown(2, KeyboardInterrupt()))
    camera(10**4)
    status, said, _ = call(0, "--live", "--out", tmp_path / "out")
    assert status == 0
    assert [len(rows(tmp_path / "out")), "taken 2 of" in said] == [2, True]
    assert (tmp_path / "out" / "recording.rrd").exists()


def test_a_video_is_played_live(call, screen, pictures, tmp_path):
    view = screen(Shown())
    write_video(tmp_path / "v.mkv", pictures * 4, rate=8.0)
    started = time.monotonic()
    status, said, _ = call(tmp_path / "v.mkv", "--live", "--limit", 100)
    assert status == 0
    assert time.monotonic() - started > 11 / 8
    assert f"taken {len(view.numbers)} of 12 frames" in said


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["0"], "the following arguments are required: --out"),
        (["0", "--live", "--every", "2"], "--every is not of a camera, whose frames are taken as they come"),
        (["0", "--live", "--mesh"], "--mesh is not of a camera"),
        (["99", "--out", "o"], "camera 99 cannot be opened"),
        (["nothing://x", "--out", "o"], "nothing://x cannot be opened"),
        (["none.mp4", "--live", "--out", "o"], "none.mp4: there is no such video"),
        ([".", "--live", "--out", "o"], "endolab: .: there is no such video, camera or stream"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_what_cannot_be_followed_is_one_sentence_and_writes_nothing(
    call, options, sentence, tmp_path, monkeypatch, screen, capsys
):
    monkeypatch.chdir(tmp_path)
    screen(Shown())
    try:
        status, _, complaint = call(*options)
    except SystemExit as end:  # of argparse
        status, complaint = end.code, capsys.readouterr().err
    assert status == 2
    assert sentence in complaint
    assert len(complaint.splitlines()) == 1
    assert not (tmp_path / "o").exists()


def test_without_a_screen_it_says_so(call, camera, monkeypatch, tmp_path):
    def blind(path=None, real=live_module.LiveView):
        if path is None:
            raise OSError("the Rerun viewer did not start: it needs a screen; record to a file instead")
        return real(path)

    monkeypatch.setattr(live_module, "LiveView", blind)
    camera(3, every=0.2)
    status, _, complaint = call(0, "--live")
    assert (status, "it needs a screen" in complaint) == (2, True)
    camera(3, every=0.2)
    status, said, complaint = call(0, "--live", "--out", tmp_path / "out")
    assert (status, complaint) == (0, "")
    assert "it needs a screen" in said
    assert (tmp_path / "out" / "frames.csv").exists()
