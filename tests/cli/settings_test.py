"""``--settings``: a file says what options would say, to the last bit, and options win."""

import json

import numpy as np
import pytest

from endolab.cli import main as cli
from endolab.io.settings import SolvingSettings, write_settings

SAID = {
    "lam": 0.1 + 0.2,
    "xi": "d",
    "regulariser": "first",
    "channel": "green",
    "width": 48,
    "contours": False,
}
GIVEN = ["--lam", "0.30000000000000004", "--xi", "d", "--regulariser", "first", "--channel", "green"]
GIVEN += ["--width", "48", "--contours", "no"]


@pytest.fixture(scope="module")
def sim(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sim")
    options = ["--calibration", "simple", "--width", "64", "--out"]
    assert cli.main(["simulate", "curved", *options, str(folder)]) == 0
    return folder


@pytest.fixture
def solve(sim, tmp_path):
    """Function that reconstructs, and returns the maps and what the report says of the settings."""

    def solve(*options, name="out"):
        command = ["reconstruct", str(sim / "frame.png"), "--calibration", str(sim / "endoscope.json")]
        assert cli.main([*command, "--out", str(tmp_path / name), *map(str, options)]) == 0
        with np.load(tmp_path / name / "depth.npz") as archive:
            maps = {key: archive[key] for key in archive.files}
        return maps, json.loads((tmp_path / name / "report.json").read_text())["settings"]

    return solve


def same(a, b):
    return a.keys() == b.keys() and all(np.array_equal(a[key], b[key], equal_nan=True) for key in a)


def test_a_file_gives_what_options_give(solve, tmp_path):
    write_settings(SolvingSettings(SAID), tmp_path / "s.json")
    from_file, told = solve("--settings", tmp_path / "s.json", name="a")
    from_options, expected = solve(*GIVEN, name="b")
    assert same(from_file, from_options)
    assert told == expected
    usual, _ = solve(name="c")
    assert not same(from_file, usual)


def test_an_option_wins_wherever_it_stands(solve, tmp_path):
    write_settings(SolvingSettings(SAID), tmp_path / "s.json")
    expected, _ = solve(*GIVEN, "--xi", "1/d", "--lam", 1, name="a")  # said, and the usual ones too
    before, _ = solve("--xi", "1/d", "--lam", 1, "--settings", tmp_path / "s.json", name="b")
    after, _ = solve("--settings", tmp_path / "s.json", "--lam", 1, "--xi", "1/d", name="c")
    assert same(before, expected)
    assert same(after, expected)


def test_lengths_and_light_are_taken(solve, tmp_path):
    said = {"channel": "green", "known_distance": (30.0, 32.5, 20.0)}
    write_settings(SolvingSettings(said, {"k": 2.0, "albedo": 0.5}), tmp_path / "s.json")
    maps, told = solve("--settings", tmp_path / "s.json", name="a")
    assert told["known_distance"] == [30.0, 32.5, 20.0]
    like, _ = solve("--channel", "green", "--known-distance", "30,32.5,20", "--albedo", 0.5, name="b")
    assert not same(maps, like)  # k
    bright, _ = solve("--settings", tmp_path / "s.json", "--albedo", 0.9, name="c")
    assert not same(maps, bright)
    half, told = solve("--settings", tmp_path / "s.json", "--median-distance", 20, name="d")
    assert np.median(half["distance"][half["mask"]]) == pytest.approx(20, rel=1e-6)
    assert told["known_distance"] is None


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ('{"endolab_settings": 1, "speed": 1}', "speed: unknown key; expected "),
        ('{"endolab_settings": 1, "xi": "z"}', "unknown xi 'z'; choose 1/z, d or 1/d"),
        ('{"endolab_settings": 1, "photometry": {"k": -1}}', "k must be finite and at least 0, got -1"),
        (None, "there is no such settings file"),
    ],
)
def test_what_is_wrong_is_one_sentence_and_nothing_is_written(content, said, sim, tmp_path, capsys):
    if content is not None:
        (tmp_path / "s.json").write_text(content)
    command = ["reconstruct", str(sim / "frame.png"), "--calibration", str(sim / "endoscope.json")]
    assert cli.main([*command, "--settings", str(tmp_path / "s.json"), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_the_file_is_never_overwritten(solve, sim, tmp_path, capsys):
    (tmp_path / "out").mkdir()
    write_settings(SolvingSettings(SAID), tmp_path / "out/report.json")
    command = ["reconstruct", str(sim / "frame.png"), "--calibration", str(sim / "endoscope.json")]
    command += [
        "--out",
        str(tmp_path / "out"),
        "--settings",
        str(tmp_path / "out/report.json"),
        "--overwrite",
    ]
    assert cli.main(command) == 2
    assert "report.json" in capsys.readouterr().err
    assert json.loads((tmp_path / "out/report.json").read_text())["endolab_settings"] == 1
