"""Odd values for every option of every command: it works, or one short sentence says what is wrong."""

import argparse
import random

import pytest

from endolab.cli import main as cli
from endolab.cli.streams import LONGEST

ODD = [
    *(
        "nan",
        "inf",
        "-inf",
        "",
        "0",
        "-1",
        "1e3",
        "1e400",
        "0.5",
        "0.5,0.5",
        ",",
        "0.5,",
        "1,2,3,4",
        "9" * 400,
    ),
    *("x" * 200_000, "٣", "²", "a\0b", "\n", "foo", "../..", " 1 ", "0x10", "None", "\udcff", "--", "-"),
    *("1e-320", "2147483648", "30,80,nan", "30,20,16", "9,10,10,40,20", "inf,2,2,4,2", "free", "1,-1"),
]
EACH = 4  # odd values for each option, drawn from a seed
BASE = {
    "reconstruct": ["frame.png", "--calibration", "endoscope.json", "--solver", "facing", "--out", "out"],
    "sweep": ["frame.png", "--calibration", "endoscope.json", "--solver", "facing", "--out", "out.csv"],
    "simulate": ["plane", "--width", "32", "--out", "out"],
    "target": ["chessboard", "--out", "out.pdf"],
    "calibrate": ["none.mkv", "--target", "chessboard", "--out", "out.json"],
    "calibrate-light": ["none.mkv", "--camera", "paper", "--out", "out.json"],
    "convert": ["none.xml", "--out", "out.json"],
    "evaluate": ["truth.npz", "truth.npz"],
    "tune": ["none.png", "--calibration", "endoscope.json", "--no-browser"],
    "lab": ["--notebooks", "none"],
}
COMMANDS = next(
    action.choices for action in cli._parser()._actions if isinstance(action, argparse._SubParsersAction)
)


def options(command):
    """Every option of a command that takes a value, and each thing that it is given without one's name."""
    taken = (
        action for action in COMMANDS[command]._actions if action.nargs != 0 and action.dest != "jupyter"
    )
    return [action.option_strings[-1] if action.option_strings else action.dest for action in taken]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    assert cli.main(["simulate", "plane", "--width", "32", "--out", str(folder)]) == 0
    return folder


def test_every_command_is_tried():
    assert set(BASE) == set(COMMANDS)


@pytest.mark.parametrize(
    ("command", "option"), [(command, name) for command in BASE for name in options(command)]
)
def test_an_odd_value_works_or_is_refused_in_a_line(command, option, made, tmp_path, monkeypatch, capsys):
    for name in ("frame.png", "endoscope.json", "truth.npz"):
        (tmp_path / name).write_bytes((made / name).read_bytes())
    monkeypatch.chdir(tmp_path)
    for value in random.Random(f"{command} {option}").sample(ODD, EACH):
        given = [f"{option}={value}"] if option.startswith("--") else [value]
        arguments = (
            [command, *BASE[command], *given]
            if option.startswith("--")
            else [command, *given, *BASE[command][1:]]
        )
        try:
            code = cli.main(arguments)
        except SystemExit as exit:
            code = exit.code
        error = capsys.readouterr().err
        assert code in (0, 2), value
        assert (code == 0) == (error == ""), (value, error[:200])
        if error:
            assert error.startswith("endolab: "), value
            assert error.count("\n") == 1, value
            assert len(error) < LONGEST + 100, value


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("simulate colon --frames 3 --out o", "--frames is of a calibration video, and colon is one frame"),
        ("simulate colon --video --out o", "--video is of a calibration video, and colon is one frame"),
        ("simulate sheet --fog 0.1 --out o", "--fog is of one frame, and sheet is a calibration video"),
        ("simulate sheet --fold 9 --out o", "--fold is of a folded target, and vicalib_small is flat"),
        ("simulate plane --texture 1e3 --out o", "texture must be at most 100, got 1000"),
        ("evaluate a.npz b.npz --max-angle=", "argument --max-angle: expected a value, found ''"),
        ("calibrate v --target charuco --every 0 --out c.json", "--every must be at least 1, got 0"),
        (
            "calibrate v --target charuco --gamma -1 --out c.json",
            "--gamma must be a positive number, one and",
        ),
        ("calibrate v --target charuco --gamma 9 --out c.json", "gamma must lie between 0.5 and 5, alone or"),
        ("sweep a.png --calibration papr --out o.csv", "or a JSON file; did you mean paper?"),
        ("sweep a.png --calibration paper --xi e --out o.csv", "unknown xi 'e'; choose 1/z, d or 1/d"),
        ("sweep a.png --calibration paper --regulariser 3rd", "unknown regulariser '3rd'; choose first,"),
        ("target chessbord --out t.pdf", "or a JSON file; did you mean chessboard?"),
    ],
)
def test_what_cannot_be_meant_is_refused_before_anything_is_done(
    words, message, tmp_path, monkeypatch, capsys
):
    (tmp_path / "v").mkdir()
    (tmp_path / "v/1.png").write_bytes(b"no picture")
    monkeypatch.chdir(tmp_path)
    try:
        code = cli.main(words.split())
    except SystemExit as exit:
        code = exit.code
    assert code == 2
    assert message in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["v"]
