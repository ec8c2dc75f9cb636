"""Installed: the core without its extras, which says what is missing, and a wheel with the lab."""

import os
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import endolab as el
from endolab._extras import MissingPackage, lacking
from endolab.cli import main as cli

ROOT = Path(__file__).resolve().parent.parent
LAB = ["anywidget", "IPython", "ipywidgets", "jinja2", "jupyterlab", "open3d", "rerun"]
SENTENCE = '{} is not installed; pip install "endolab[lab]" brings it'


HERE = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}


def python(*words, program=sys.executable, cwd=None, timeout=200, **environment):
    """Run Python in a process of its own, on which this checkout's path is not set."""
    command = [program, *map(str, words)]
    how = {"capture_output": True, "text": True, "timeout": timeout, "cwd": cwd}
    return subprocess.run(command, env=HERE | environment, **how)


def install(fresh, *what):
    """Install into an environment, of the versions in the lock; skip where no index is in reach."""
    command = ["-m", "uv", "pip", "install", "--python", fresh]  # quicker than pip
    command += ["-q", "-c", ROOT / "requirements.lock"]
    if python(*command, "setuptools").returncode:
        pytest.skip("no package can be installed here: the index is out of reach")
    done = python(*command, *what, timeout=1500)
    assert done.returncode == 0, done.stderr


def copy_source(folder):
    """Copy what the package is built of: a build leaves files beside it."""
    source = folder / "source"
    left_out = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "endolab", source / "endolab", ignore=left_out)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    return source


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Run the Python of a fresh environment that holds the core alone, of the versions in the lock."""
    folder = tmp_path_factory.mktemp("alone")
    source = copy_source(folder)
    fresh = folder / "venv/bin/python"
    python("-m", "venv", folder / "venv")
    install(fresh, "--no-build-isolation", source)
    yield lambda *words: python("-W", "error", *words, program=fresh, cwd=folder)
    shutil.rmtree(folder)  # some 600 MB


def test_the_core_alone_simulates_and_reconstructs(run):
    code = f"import importlib.util as u; print([n for n in {LAB} if u.find_spec(n)])"
    assert run("-c", code).stdout == "[]\n"
    done = run("-m", "endolab", "simulate", "curved", "--width", 64, "--out", "sim")
    assert done.returncode == 0, done.stderr
    given = "sim/frame.png --calibration sim/endoscope.json --mesh --prepare"
    given += " --solver fast_marching --out"
    for lines in (1, 0):  # that the first run compiles is said, and only then
        done = run("-m", "endolab", "reconstruct", *given.split(), f"out{lines}")
        assert (done.returncode, done.stderr.count("\n")) == (0, lines), done.stderr
        assert SENTENCE.format("rerun") in done.stdout
    done = run("-m", "endolab", "evaluate", "out0/depth.npz", "sim/truth.npz")
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("version", ["3.11", "3.12", "3.13"])
def test_a_wheel_with_the_lab_works_in_a_bare_environment(version, tmp_path):
    program = shutil.which(f"python{version}")
    if program is None or python("-c", "", program=program).returncode:
        pytest.skip(f"Python {version} is not on this machine")
    build = ["wheel", "-q", "--no-deps", "--no-build-isolation", "-w", tmp_path]
    done = python("-m", "pip", *build, copy_source(tmp_path))
    assert done.returncode == 0, done.stderr
    (wheel,) = tmp_path.glob("*.whl")
    fresh = tmp_path / "venv/bin/python"
    assert python("-m", "venv", tmp_path / "venv", program=program).returncode == 0
    install(fresh, f"{wheel}[lab]")
    for words in (
        "simulate colon --width 96 --out sim",
        "reconstruct sim/frame.png --calibration sim/endoscope.json --out out",
        "tune sim/frame.png --calibration sim/endoscope.json --html page.html",
        "target vicalib_folded --out sheet.pdf",
    ):
        how = {"program": fresh, "cwd": tmp_path, "timeout": 600}
        done = python("-m", "endolab", *words.split(), **how)
        assert done.returncode == 0, done.stderr
    assert (tmp_path / "out/recording.rrd").is_file()
    code = "import endolab as el; el.load_traced('matt'); el.load_calibration('c3vd')"
    assert python("-c", code, program=fresh, cwd=tmp_path).returncode == 0


@pytest.fixture
def without_lab(monkeypatch):
    """No package of the extra can be imported, and none has been."""
    rooms = ("endolab.workbench.recording", "endolab.workbench.tuning")
    for name in [name for name in sys.modules if name.startswith(rooms)]:
        monkeypatch.delitem(sys.modules, name)
    kept = {"recording", "tuning", "record", "show", "read_recording", "tune"}
    for name in kept & vars(el).keys():  # once asked for
        monkeypatch.delattr(el, name)
    for name in LAB:
        monkeypatch.setitem(sys.modules, name, None)


@pytest.mark.parametrize(
    ("use", "package"),
    [
        (lambda: el.record("run.rrd"), "rerun"),
        (lambda: el.show("run.rrd"), "rerun"),
        (lambda: el.read_recording("run.rrd"), "rerun"),
        (lambda: import_module("endolab.workbench.recording"), "rerun"),
        (lambda: el.tune, "ipywidgets"),
        (lambda: el.metrics.to_open3d(None), "open3d"),
    ],
)
def test_what_is_missing_is_said_in_a_sentence(without_lab, use, package):
    with pytest.raises(MissingPackage) as caught:
        use()
    assert str(caught.value) == SENTENCE.format(package) == lacking(package)


def test_the_command_line_says_it_too(without_lab, capsys):
    assert cli.main(["lab"]) == 2
    assert capsys.readouterr().err == f"endolab: {SENTENCE.format('jupyterlab')}\n"


@pytest.mark.parametrize(
    ("version", "accepted"), [("4.14.0.94", False), ("5.0.0.93", True)]
)
def test_an_older_opencv_is_refused_in_one_sentence_at_the_first_import(
    version, accepted, tmp_path
):
    package = tmp_path / "cv2"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "version.py").write_text(f'opencv_version = "{version}"\n')
    path = f"{tmp_path}{os.pathsep}{ROOT}"
    done = python("-c", "import endolab", PYTHONPATH=path)
    assert (done.returncode == 0) == accepted, done.stderr
    if not accepted:
        assert f"needs OpenCV 5, found {version}" in done.stderr.splitlines()[-1]


def test_a_script_beside_the_clone_imports_the_package_not_the_clones_folder(tmp_path):
    (tmp_path / "endolab").symlink_to(ROOT, target_is_directory=True)
    script = tmp_path / "script.py"
    script.write_text("import endolab; print(endolab.__version__)")
    done = python(script, cwd=tmp_path)
    assert done.stdout.strip() == el.__version__, done.stderr
