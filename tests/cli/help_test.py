"""Every command's help shows examples that can be typed, as can what the guides say."""

import re
import shlex
import subprocess
from pathlib import Path

import pytest

import endolab as el
from endolab.cli.main import COMMANDS, main, make_app

GUIDES = Path(__file__).resolve().parents[2] / "notebooks/guides"
NAMES = [place.partition(":")[2].replace("_", "-") for place in COMMANDS]
ROOM = Path(main.__code__.co_filename).parent
PLACES = [path.read_text(encoding="utf-8") for path in sorted(ROOM.glob("*.py"))]
PLACES += [path.read_text(encoding="utf-8") for path in sorted(GUIDES.glob("*.md"))]
EXAMPLES = re.findall(
    r"(?m)^ *(?:- )?endolab ([a-z-]+ .*?)(?:  +#.*)?$", "\n".join(PLACES)
)


@pytest.mark.parametrize("example", dict.fromkeys(EXAMPLES))
def test_an_example_parses(example):
    make_app().parse_args(shlex.split(example), exit_on_error=False)


@pytest.mark.parametrize("name", NAMES)
def test_help_shows_examples(name, capsys):
    assert main([name, "--help"]) == 0
    _usage, *examples = capsys.readouterr().out.split(f"endolab {name}")
    assert len(examples) >= 2


@pytest.mark.parametrize("name", NAMES)
def test_no_option_is_without_words(name):
    for argument in make_app()[name].assemble_argument_collection(parse_docstring=True):
        assert argument.parameter.help, argument.name


def test_the_help_names_every_command_by_its_first_sentence(capsys):
    assert main(["--help"]) == 0
    printed = capsys.readouterr().out
    for name in NAMES:
        *_, sentence = make_app()[name].help.partition("\n")[0].rpartition("\n")
        assert re.search(rf"(?m)^ +{name} +{re.escape(sentence)}$", printed)


def test_the_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"endolab {el.__version__}\n"


@pytest.mark.parametrize(
    ("typed", "completed"),
    [
        ("endolab rec", "reconstruct"),
        ("endolab reconstruct --highl", "--highlights"),
        ("endolab evaluate --align n", "none"),
    ],
)
def test_a_shell_completes(typed, completed, tmp_path, capsys):
    assert main(["--completion", "bash"]) == 0
    script = tmp_path / "completion"
    script.write_text(capsys.readouterr().out)
    words = f"COMP_WORDS=({typed}); COMP_CWORD={len(typed.split()) - 1}"
    typing = f"source {script}; {words}; _endolab; echo ${{COMPREPLY[*]}}"
    done = subprocess.run(["bash", "-c", typing], capture_output=True, text=True)
    assert done.stdout.split() == [completed], done.stderr
