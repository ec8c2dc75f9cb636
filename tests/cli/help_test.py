"""The examples at the end of every command's help: all parse, and run where that is quick; the version."""

import argparse
import glob
import re
import shlex
import shutil
import subprocess

import pytest

import endolab as el
from endolab.calibration.targets import Chessboard
from endolab.cli import main as cli
from endolab.io.descriptions import write_target
from endolab.io.images import write_image
from endolab.io.settings import SolvingSettings, write_settings
from endolab.io.surfaces import read_depth
from endolab.io.video import write_video

COMMANDS = next(
    action.choices
    for action in cli._parser()._actions
    if isinstance(action, argparse._SubParsersAction)
)
EXAMPLES = [
    line.strip()
    for command in COMMANDS.values()
    for line in command.epilog.splitlines()[1:]
]
# Which need no camera and no screen.
CHEAP = [
    line
    for line in EXAMPLES
    if line.split()[1] in ("reconstruct", "sweep", "evaluate", "target")
    and "--live" not in line
]


def words(example):
    """The arguments of an example, as a shell would give them."""
    _, *arguments = shlex.split(example)
    return [
        word
        for text in arguments
        for word in (sorted(glob.glob(text)) if "*" in text else [text])
    ]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with small files of the names that the examples use."""
    folder = tmp_path_factory.mktemp("made")
    sim = folder / "sim"
    command = f"simulate curved --calibration simple --width 64 --out {sim}"
    assert cli.main(command.split()) == 0
    for name in ("frame", "a", "b"):
        shutil.copy(sim / "frame.png", folder / f"{name}.png")
        shutil.copy(sim / "truth.npz", folder / f"{name}.npz")
    shutil.copy(sim / "endoscope.json", folder)
    frame = el.read_frame(sim / "frame.png")
    write_video(folder / "video.mkv", [frame.image] * 2)
    write_target(Chessboard(5, 4, 5.0), folder / "target.json")
    write_settings(SolvingSettings({"lam": 0.5}), folder / "tuned.json")
    calibration = el.load_calibration(sim / "endoscope.json")
    el.save_result(el.reconstruct(frame, calibration, solver="facing"), folder / "result")
    depth = read_depth(sim / "truth.npz")["z"] / 100
    write_image(folder / "0001_depth.png", depth, 16)
    return folder


def test_every_command_ends_its_help_with_examples():
    for name, command in COMMANDS.items():
        own = [line for line in EXAMPLES if line.split()[1] == name]
        assert len(own) >= 2, name
        assert command.format_help().splitlines()[-1].strip() == own[-1]


def test_help_is_80_columns_wide(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    for parser in (cli._parser(), *COMMANDS.values()):
        assert max(map(len, parser.format_help().splitlines())) <= 80


@pytest.mark.parametrize("example", [line for line in EXAMPLES if line not in CHEAP])
def test_an_example_parses(example):
    arguments = cli._parser().parse_args(
        words(example) if "*" not in example else shlex.split(example)[1:]
    )
    assert arguments.command == example.split()[1]


@pytest.mark.parametrize("example", CHEAP)
def test_an_example_runs(example, made, tmp_path, monkeypatch, capsys):
    shutil.copytree(made, tmp_path / "here")
    monkeypatch.chdir(tmp_path / "here")
    # The frame is of that calibration's size.
    small = re.sub("--calibration (paper|c3vd)", "--calibration endoscope.json", example)
    small = small.replace("video.mp4", "video.mkv").replace("--width 480", "--width 48")
    if "sweep *" in small:  # a folder of frames alone
        (tmp_path / "here/0001_depth.png").unlink()
    assert cli.main(words(small)) == 0, capsys.readouterr().err


def test_the_version(capsys):
    with pytest.raises(SystemExit, match="0"):
        cli.main(["--version"])
    assert capsys.readouterr().out == f"endolab {el.__version__}\n"


@pytest.mark.parametrize(
    ("typed", "completed"),
    [
        ("endolab rec", "reconstruct"),
        ("endolab reconstruct --highl", "--highlights"),
        ("endolab evaluate --scale m", "median"),
    ],
)
def test_a_shell_completes(typed, completed, tmp_path, capsys):
    with pytest.raises(SystemExit, match="0"):
        cli.main(["--completion", "bash"])
    script = tmp_path / "completion"
    script.write_text(capsys.readouterr().out)
    words = f"COMP_WORDS=({typed}); COMP_CWORD={len(typed.split()) - 1}"
    typing = f"source {script}; {words}; _shtab_endolab; echo ${{COMPREPLY[*]}}"
    done = subprocess.run(["bash", "-c", typing], capture_output=True, text=True)
    assert done.stdout.split() == [completed], done.stderr
