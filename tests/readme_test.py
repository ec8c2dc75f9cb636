"""The commands of the README work."""

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


def blocks(language):
    return [text for kind, text in BLOCKS if kind == language]


def commands():
    """What the README types, a command a line, without comments."""
    return [
        shlex.split(line, comments=True)
        for text in blocks("sh")
        for line in text.splitlines()
    ]


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
        if program == ".venv/bin/endolab":
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
