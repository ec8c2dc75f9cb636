"""The core without its extras: it installs and reconstructs, and says in a sentence what is missing."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import endolab as el
from endolab._extras import MissingPackage, lacking
from endolab.cli import main as cli
from endolab.cli.streams import ONCE
from endolab.metrics.mesh_distance import load_open3d

ROOT = Path(__file__).resolve().parent.parent
LAB = ["anywidget", "IPython", "ipywidgets", "jinja2", "jupyterlab", "open3d", "rerun"]
SENTENCE = '{} is not installed; pip install "endolab[lab]" brings it'


@pytest.fixture(scope="module")
def python(tmp_path_factory):
    """The Python of a fresh environment that holds the core alone, of the versions in the lock."""
    folder = tmp_path_factory.mktemp("alone")
    source, found = folder / "source", folder / "venv/bin/python"
    shutil.copytree(ROOT / "endolab", source / "endolab", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    uv = Path(sys.executable).with_name("uv")
    options = ["--without-pip"] if uv.exists() else []
    subprocess.run([sys.executable, "-m", "venv", *options, folder / "venv"], check=True, timeout=60)
    pip = [uv, "pip", "install", "--python", found] if uv.exists() else [found, "-m", "pip", "install"]

    def install(*what):
        command = [*pip, "-q", "-c", ROOT / "requirements.lock", *what]
        return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=200)

    if install("setuptools").returncode:
        pytest.skip("no package can be installed here: the index is out of reach")
    done = install("--no-build-isolation", source)
    assert done.returncode == 0, done.stderr
    yield found
    shutil.rmtree(folder)  # some 600 MB, where files cannot be linked


@pytest.fixture
def run(python, tmp_path):
    def run(*words):
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        command = [str(word) for word in (python, "-W", "error", *words)]
        return subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=200
        )

    return run


def test_the_core_alone_simulates_and_reconstructs(run, tmp_path):
    code = f"import importlib.util as u; print([n for n in {LAB} if u.find_spec(n)])"
    assert run("-c", code).stdout == "[]\n"
    done = run("-m", "endolab", "simulate", "curved", "--width", 64, "--out", "sim")
    assert (done.returncode, done.stderr) == (0, "")
    calibration = ("--calibration", "sim/endoscope.json", "--mesh", "--prepare")
    done = run("-m", "endolab", "reconstruct", "sim/frame.png", *calibration, "--out", "out")
    assert (done.returncode, done.stderr) == (0, f"{ONCE}\n")  # a copy, of which nothing is compiled yet
    assert f"There is no recording.rrd: {SENTENCE.format('rerun')}.\n" in done.stdout
    written = ["cloud.ply", "depth.npz", "mesh.ply", "overview.png", "preparation.png"]
    written.append("report.json")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == written
    assert json.loads((tmp_path / "out/report.json").read_text(encoding="utf-8"))["metric"]
    done = run("-m", "endolab", "evaluate", "out/depth.npz", "sim/truth.npz")
    assert (done.returncode, done.stderr) == (0, "")
    done = run("-m", "endolab", "lab")
    assert (done.returncode, done.stderr) == (2, f"endolab: {SENTENCE.format('jupyterlab')}\n")
    for name, package in (("record", "rerun"), ("show", "rerun"), ("tune", "ipywidgets")):
        done = run("-c", f"import endolab as el; el.{name}")
        assert done.stderr.splitlines()[-1] == f"endolab._extras.MissingPackage: {SENTENCE.format(package)}"


@pytest.fixture
def without_lab(monkeypatch):
    """No package of the extra can be imported, and none has been."""
    for name in [name for name in sys.modules if name.startswith(("endolab.recording", "endolab.tuning"))]:
        monkeypatch.delitem(sys.modules, name)
    kept = {"recording", "tuning", "record", "show", "read_recording", "Comparison", "tune"}  # once asked for
    for name in kept & vars(el).keys():
        monkeypatch.delattr(el, name)
    for name in LAB:
        monkeypatch.setitem(sys.modules, name, None)


@pytest.mark.parametrize(
    ("use", "package"),
    [
        (lambda: el.record("run.rrd"), "rerun"),
        (lambda: el.show("run.rrd"), "rerun"),
        (lambda: el.read_recording("run.rrd"), "rerun"),
        (lambda: el.recording, "rerun"),
        (lambda: el.tune, "ipywidgets"),
        (load_open3d, "open3d"),
    ],
)
def test_what_is_missing_is_said_in_a_sentence(without_lab, use, package):
    with pytest.raises(MissingPackage) as caught:
        use()
    assert str(caught.value) == SENTENCE.format(package) == lacking(package)


def test_the_command_line_says_it_too(without_lab, capsys):
    assert cli.main(["lab"]) == 2
    assert capsys.readouterr().err == f"endolab: {SENTENCE.format('jupyterlab')}\n"
    assert cli.main(["tune", "frame.png", "--calibration", "paper"]) == 2
    assert capsys.readouterr().err == f"endolab: {SENTENCE.format('ipywidgets')}\n"


def test_nothing_is_said_of_what_is_there():
    assert lacking("json", "numpy") == ""
