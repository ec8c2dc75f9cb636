"""The examples at the end of every command's help: all parse; the version, and what a shell completes."""

import argparse
import shlex
import subprocess

import pytest

import endolab as el
from endolab.cli import main as cli

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


def test_every_command_ends_its_help_with_examples():
    for name, command in COMMANDS.items():
        own = [line for line in EXAMPLES if line.split()[1] == name]
        assert len(own) >= 2, name
        assert command.format_help().splitlines()[-1].strip() == own[-1]


def test_help_is_80_columns_wide(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    for parser in (cli._parser(), *COMMANDS.values()):
        assert max(map(len, parser.format_help().splitlines())) <= 80


@pytest.mark.parametrize("example", EXAMPLES)
def test_an_example_parses(example):
    command, *words = shlex.split(example)[1:]
    arguments = cli._parser().parse_args([command, *words])
    assert arguments.command == command


def test_the_version(capsys):
    with pytest.raises(SystemExit, match="0"):
        cli.main(["--version"])
    assert capsys.readouterr().out == f"endolab {el.__version__}\n"


@pytest.mark.parametrize(
    ("typed", "completed"),
    [
        ("endolab rec", "reconstruct"),
        ("endolab reconstruct --highl", "--highlights"),
        ("endolab evaluate --scale n", "none"),
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
