"""Videos and sweeps on the command line."""

import csv
from dataclasses import replace

import pytest

import endolab as el
from endolab import datasets
from endolab.cli import main as cli
from endolab.io.images import write_image
from endolab.io.video import write_video
from tests.tools.problems import moved_colon


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
    for words in ("2 of 3", "earlier call", "not done: 2.png", "relative", ".rrd"):
        assert words in output
    assert len(rows(here / "o/frames.csv")) == 3
    code, _, error = call("reconstruct film --out o --solver facing --lam 3")
    assert (code, error.count("\n"), "--overwrite" in error) == (2, 1, True)
    assert (
        call("reconstruct v.mkv --out w --every 4 --solver facing --width 32")[0] == 0
    )
    assert [row["frame"] for row in rows(here / "w/frames.csv")] == ["000000", "000004"]


def test_a_sweep_tells_what_became_of_it(call, here):
    words = "sweep film/0.png none.png --lam 0.1,1 --xi d --max-iterations 3"
    code, output, _ = call(words)
    assert (code, "2 of 4 rows" in output, "none.png" in output) == (0, True, True)
    assert len(rows(here / "sweep.csv")) == 4
