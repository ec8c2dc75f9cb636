"""The README is one page and its commands work; no name in the code only tells that it tells."""

import ast
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```", README, re.DOTALL | re.MULTILINE)
PROGRAM = ".venv/bin/endolab"
NO_NAMES = {"told", "said", "judged"}  # which only tell that they tell
# A function is named by a verb or by what it returns; these are quantities, and a decorator.
PARTICIPLES = {"misplaced", "shown", "pictured", "checked", "explained", "left"}
IRREGULAR = {
    "found",
    "kept",
    "held",
    "seen",
    "made",
    "begun",
    "drawn",
    "known",
    "given",
    "taken",
    "left",
    "shown",
    "told",
    "said",
    "sent",
    "cut_off",
    "built",
    "written",
    "hidden",
    "grown",
    "chosen",
}


def blocks(language):
    return [text for kind, text in BLOCKS if kind == language]


def commands():
    """What the README types, a command a line, without comments."""
    return [
        shlex.split(line, comments=True)
        for text in blocks("sh")
        for line in text.splitlines()
    ]


def names_in(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        for field in ("id", "attr", "arg", "name"):
            if isinstance(name := getattr(node, field, None), str):
                yield name


def test_the_readme_is_one_page():
    assert len(README.split()) <= 1000
    assert len(README.splitlines()) <= 130


def test_no_name_only_tells_that_it_tells():
    paths = [
        path
        for folder in ("endolab", "tests")
        for path in (ROOT / folder).rglob("*.py")
    ]
    assert {name for path in paths for name in names_in(path)} & NO_NAMES == set()


def test_functions_are_verbs_or_what_they_return():
    names = set()
    for path in (ROOT / "endolab").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef):
                names.add(node.name)
    plain = {name: name.strip("_") for name in names if "_" not in name.strip("_")}
    is_participle = {
        name for name, word in plain.items() if word in IRREGULAR or word.endswith("ed")
    }
    assert is_participle - {"_embed", "need"} == PARTICIPLES


def test_make_knows_the_targets_of_the_readme():
    targets = set(
        re.findall(
            r"^([a-z-]+):",
            (ROOT / "Makefile").read_text(encoding="utf-8"),
            re.MULTILINE,
        )
    )
    asked = {target for name, *rest in commands() if name == "make" for target in rest}
    assert asked
    assert asked <= targets


def run(*words):
    """Type a command of endolab's; the tuner is ended as by Ctrl-C once it has printed its link."""
    more = ["--no-browser"] if words[0] == "tune" else []
    command = [sys.executable, "-m", "endolab", *words, *more]
    pipe = subprocess.PIPE
    with subprocess.Popen(
        command, stdout=pipe, stderr=subprocess.STDOUT, text=True
    ) as program:
        lines = [program.stdout.readline()] if more else []
        if more:
            program.send_signal(signal.SIGINT)
        printed = "".join([*lines, *program.stdout])
    assert program.returncode == 0, printed
    assert "http" in printed or not more


@pytest.mark.slow
def test_every_command_of_the_readme_works(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("endoscope.json").write_text(blocks("json")[0])
    colon = ("colon", "--calibration", "endoscope.json", "--width", "640")
    run("simulate", *colon, "--out", "sim")
    sheet = ("sheet", "--target", "vicalib_folded", "--frames", "24", "--video")
    run("simulate", *sheet, "--out", "sheet")
    Path("sim/frame.png").rename("frame.png")
    next(Path("sheet").glob("*.mkv")).rename("video.mp4")
    for program, *words in commands():
        if program == PROGRAM:
            if words[0] == "calibrate":
                Path("endoscope.json").unlink()
            run(*words)
    listed = re.findall(r"^- `([^`]+)`:", README, re.MULTILINE)
    assert {path.name for path in Path("result").iterdir()} == set(listed)
    assert Path("endoscope_report/report.html").is_file()


def test_the_python_of_the_readme_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (code,) = blocks("python")
    exec(code, {})
    assert (tmp_path / "run.rrd").is_file()
    assert (tmp_path / "out/depth.npz").is_file()
