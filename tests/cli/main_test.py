"""The command line: what it writes and prints, and one sentence about whatever is wrong."""

import json
import os
import shlex
import signal
import subprocess
import sys
import termios
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest

import endolab as el
from endolab.cli import main as cli
from endolab.io.images import read_image, write_image
from endolab.io.settings import SolvingSettings, write_settings

ROOT = Path(__file__).resolve().parents[2]
OUTPUTS = ["cloud.ply", "depth.npz", "overview.png", "recording.rrd", "report.json"]


def call(words):
    """The exit code of a command."""
    try:
        return cli.main(words.split())
    except SystemExit as exit:
        return exit.code


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def maps(path):
    with np.load(path, allow_pickle=False) as archive:
        return dict(archive)


def report(folder):
    text = (folder / "report.json").read_text(encoding="utf-8")
    return json.loads(text, parse_constant=pytest.fail)


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """A folder with a simulated frame `sim`, its reconstruction `out`, and one in relative units `rel`."""
    folder = tmp_path_factory.mktemp("work")
    sim = folder / "sim"
    assert call(f"simulate curved --out {sim} --calibration simple --width 160") == 0
    known = json.loads((sim / "endoscope.json").read_text())
    known["photometry"]["gain"] = None
    (folder / "unknown.json").write_text(json.dumps(known))
    for out, calibration in (
        ("out", sim / "endoscope.json"),
        ("rel", folder / "unknown.json"),
    ):
        words = f"--calibration {calibration} --out {folder / out}"
        assert call(f"reconstruct {sim}/frame.png {words}") == 0
    return folder


@pytest.fixture
def sim(work):
    return work / "sim"


@pytest.fixture
def solve(work, tmp_path, monkeypatch):
    """Reconstruct the simulated frame with options; the exit code."""
    monkeypatch.chdir(tmp_path)

    def run(options, calibration="sim/endoscope.json"):
        known = f"--calibration {work / calibration}"
        return call(f"reconstruct {work}/sim/frame.png {known} {options}")

    return run


@pytest.fixture
def refused(capsys, tmp_path):
    """Run a command that must fail: exit code 2, nothing on stdout, one line on stderr, nothing written."""

    def run(words):
        before = sorted(tmp_path.rglob("*"))
        capsys.readouterr()
        code = call(words)
        out, error = capsys.readouterr()
        assert (code, out) == (2, "")
        assert error.startswith("endolab: ")
        assert error.count("\n") == 1
        assert len(error) < 700
        assert sorted(tmp_path.rglob("*")) == before
        return error

    return run


# What it does ---------------------------------------------------------------------------
def test_simulate_writes_a_frame_and_its_truth(sim):
    assert names(sim) == ["endoscope.json", "frame.png", "report.json", "truth.npz"]
    calibration = el.load_calibration(sim / "endoscope.json")
    truth = maps(sim / "truth.npz")
    assert (
        read_image(sim / "frame.png").shape == truth["normals"].shape == (120, 160, 3)
    )
    exact = el.SCENES["curved"].distance(calibration.camera.field.rays)
    np.testing.assert_allclose(truth["distance"], exact, rtol=1e-6)


def test_a_folder_is_written_into_only_if_asked_and_the_rest_stays(tmp_path, refused):
    assert (
        call(f"simulate curved --calibration simple --width 64 --out {tmp_path}") == 0
    )
    given = ["endoscope.json", "frame.png", "truth.npz"]
    how = f"reconstruct {tmp_path}/frame.png --solver facing --out {tmp_path}"
    how += f" --calibration {tmp_path}/endoscope.json"
    assert "--overwrite" in refused(how)
    assert call(f"{how} --overwrite") == 0
    assert names(tmp_path) == sorted([*OUTPUTS, *given])


def test_reconstruct_writes_a_whole_folder(work):
    out = work / "out"
    assert names(out) == OUTPUTS
    depth = maps(out / "depth.npz")
    mask = depth["mask"]
    assert mask.shape == (120, 160)
    for name in ("distance", "z", "normals"):
        assert np.all(np.isfinite(depth[name][mask]))
        assert np.all(np.isnan(depth[name][~mask]))
    content = report(out)
    assert content["settings"]["channel"] == "separated"
    assert (content["settings"]["frame"], content["pixels"]) == (
        "frame.png",
        mask.sum(),
    )
    assert f"element vertex {mask.sum()}\n".encode() in (out / "cloud.ply").read_bytes()


@pytest.mark.parametrize(
    ("calibration", "unit"),
    [("sim/endoscope.json", "(mm)"), ("unknown.json", "(relative")],
)
def test_the_summary_tells_how_it_ended_in_which_unit_and_where_it_is(
    solve, capsys, tmp_path, calibration, unit
):
    assert solve("--width 80 --channel green --out o", calibration) == 0
    output, error = capsys.readouterr()
    assert error == ""
    steps = f"gauss_newton, {report(tmp_path / 'o')['iterations']} iteration"
    for words in ("CONVERGED", steps, unit, "written to o"):
        assert words in output
    assert ("--median-distance" in output) == (unit != "(mm)")


def test_mesh_and_preparation_and_snapshots_come_if_they_are_asked_for(
    solve, tmp_path, capsys
):
    assert solve("--solver facing --out out --mesh --prepare") == 0
    assert names(tmp_path / "out") == sorted([*OUTPUTS, "mesh.ply", "preparation.png"])
    assert "100 % of the picture" in capsys.readouterr().out
    assert solve("--width 80 --solver fast_marching --snapshots 3 --out m") == 0
    assert "fast_marching, 3 iterations" in capsys.readouterr().out


def test_trust_comes_if_it_is_asked_for(solve, sim, tmp_path, capsys, refused):
    assert solve("--width 80 --out out --uncertainty --mesh") == 0
    assert names(tmp_path / "out") == sorted(
        [*OUTPUTS, "mesh.ply", "mesh_uncertainty.ply"]
    )
    assert "σ of the distance: " in capsys.readouterr().out
    depth = maps(tmp_path / "out/depth.npz")
    assert (depth["sigma"][depth["mask"]] > 0).all()
    assert report(tmp_path / "out")["uncertainty"]["status"] == "CONVERGED"
    assert call(f"evaluate out/depth.npz {sim}/truth.npz") == 0
    assert "within 1 σ" in capsys.readouterr().out
    assert call(f"evaluate out/depth.npz {sim}/truth.npz --json") == 0
    assert 0 < json.loads(capsys.readouterr().out)["coverage"]["within_one"] <= 100
    known = f"--calibration {sim}/endoscope.json --uncertainty --solver facing"
    assert "'facing'" in refused(f"reconstruct {sim}/frame.png {known} --out f")


def test_options_arrive(solve, tmp_path):
    write_image(tmp_path / "mask.png", np.arange(160) < np.full((120, 1), 80))
    options = "--mask mask.png --regulariser first --width 80 --median-distance 33"
    assert solve(f"--out o {options} --contours no --albedo 0.4", "unknown.json") == 0
    content = report(tmp_path / "o")
    assert content["settings"]["regulariser"] == "first"
    depth = maps(tmp_path / "o/depth.npz")
    assert depth["distance"].shape == (60, 80)
    assert depth["mask"][:, :39].mean() > 0.9
    assert not depth["mask"][:, 41:].any()
    assert np.nanmedian(depth["distance"]) == pytest.approx(33, rel=1e-4)
    assert content["metric"]


def test_a_settings_file_gives_what_options_give_and_options_win(solve, tmp_path):
    light = {"k": 2.0, "albedo": 0.5}
    options = {"lam": 0.1 + 0.2, "xi": "d", "channel": "green", "width": 48}
    options |= {"contours": False, "known_distance": (30.0, 32.5, 20.0)}
    write_settings(SolvingSettings(options, light), tmp_path / "s.json")
    write_settings(SolvingSettings({}, light), tmp_path / "light.json")
    assert solve("--settings s.json --out file") == 0
    same = f"--lam {0.1 + 0.2} --xi d --channel green --width 48 --contours no"
    assert (
        solve(f"{same} --known-distance 30,32.5,20 --settings light.json --out options")
        == 0
    )
    assert (
        solve("--lam 1 --settings s.json --median-distance 20 --albedo 0.9 --out both")
        == 0
    )
    runs = [tmp_path / name for name in ("file", "options", "both")]
    content = [report(run)["settings"] for run in runs]
    assert content[0] == content[1]
    found = [maps(run / "depth.npz")["distance"] for run in runs]
    np.testing.assert_array_equal(found[0], found[1])
    assert content[2]["lam"] == 1
    assert (content[2]["xi"], content[2]["known_distance"]) == ("d", None)
    assert np.nanmedian(found[2]) == pytest.approx(20, rel=1e-6)


def test_a_depth_map_that_is_given_as_a_frame_is_suspected(
    sim, solve, tmp_path, capsys
):
    write_image(tmp_path / "1.png", maps(sim / "truth.npz")["z"] / 100, 16)
    how = f"--calibration {sim}/endoscope.json --solver facing --out o --overwrite"
    for frame, suspected in (("1.png", True), (sim / "frame.png", False)):
        assert call(f"reconstruct {frame} {how}") == 0
        assert ("depth map" in capsys.readouterr().out) == suspected


def test_evaluate_compares_with_the_truth(work, solve, tmp_path, capsys):
    """Which may be of a published data set, and is resampled for the result of a shrunk frame."""

    def errors(depth, truth, options=""):
        assert call(f"evaluate {depth} {truth} {options} --json") == 0
        return json.loads(capsys.readouterr().out, parse_constant=pytest.fail)

    true = maps(work / "sim/truth.npz")
    assert solve("--width 80 --out small") == 0
    write_image(tmp_path / "0001_depth.png", true["z"] / 100, 16)
    capsys.readouterr()
    whole = errors(work / "out/depth.npz", work / "sim/truth.npz")
    lack = np.abs(maps(work / "out/depth.npz")["distance"] / true["distance"] - 1)
    assert whole["mean_percent"] == pytest.approx(100 * np.nanmean(lack), rel=1e-5)
    assert (whole["scale"], whole["mean_percent"] < 0.6) == (1.0, True)
    relative = errors(work / "rel/depth.npz", work / "sim/truth.npz")
    assert relative["scale"] > 10
    assert relative["mean_percent"] < 0.6
    narrow = errors(work / "rel/depth.npz", work / "sim/truth.npz", "--max-angle 20")
    assert narrow["pixels"] < 0.5 * relative["pixels"]
    shrunk = errors("small/depth.npz", "0001_depth.png")
    assert shrunk["mean_percent"] < whole["mean_percent"] + 0.2
    assert (shrunk["truth_resampled_from"], shrunk["pixels"]) == ([160, 120], 80 * 60)
    assert call(f"evaluate {work}/out/depth.npz {work}/sim/truth.npz") == 0
    assert f"{whole['mean_percent']:.4g}" in capsys.readouterr().out


def test_evaluate_compares_folders_of_other_programs_depths(sim, tmp_path, capsys):
    """A row each, their mean and median; what has no partner is said."""
    true = maps(sim / "truth.npz")["z"]
    for name, factor in {"a_1": 1.1, "a_2": 1.2, "a_4": 1.6, "a_9": 1}.items():
        (tmp_path / "a").mkdir(exist_ok=True)
        np.save(tmp_path / f"a/{name}.npy", factor * true / 1000)
    for number in (1, 2, 4, 7):
        (tmp_path / "b").mkdir(exist_ok=True)
        np.savez(tmp_path / f"b/{number:04d}.npz", z=true)
    words = f"evaluate {tmp_path}/a {tmp_path}/b --unit 1000"
    assert call(words) == 0
    head, *rows, alone = capsys.readouterr().out.splitlines()
    assert head.split()[:2] == ["AbsRel", "%"]
    assert [float(row.split()[1]) for row in rows] == pytest.approx(
        [10, 20, 60, 30, 20], abs=1e-3
    )
    assert [row.split()[0] for row in rows[3:]] == ["mean", "median"]
    assert "a_9.npy" in alone
    assert "0007.npz" in alone
    assert call(f"{words} --calibration {sim}/endoscope.json --json") == 0
    content = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert [one["within_125"] for one in content["frames"]] == pytest.approx(
        [100, 100, 0]
    )
    assert {one["kind"] for one in content["frames"]} == {"distance"}


# What it refuses ------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("options", "named"),
    [
        ("--solver gaus_newton", "gauss_newton"),
        ("--snapshots 3", "snapshots"),
        ("--channel pink", "--channel"),
        ("--lam nan", "lam"),
        ("--lam auto", "--lam"),
        ("--max-iterations 0", "--max-iterations"),
        ("--known-distance 30,a,2", "--known-distance"),
        ("--known-distance 30,160,60", "column 160"),
        ("--known-diameter 9,1,2", "known_diameter"),
        ("--albedo 2", "albedo"),
        ("--width 161", "161"),
        ("--every 2", "--every"),
        ("--settings none.json", "none.json"),
        ("--bogus", "--bogus"),
        ("--lam=" + "7" * 10**6 + "x", "--lam"),
    ],
    ids=lambda value: value[:40],
)
def test_a_bad_option(sim, tmp_path, refused, options, named):
    known = f"--calibration {sim}/endoscope.json --out {tmp_path}/new/out"
    assert named in refused(f"reconstruct {sim}/frame.png {known} {options}")


@pytest.mark.parametrize(
    ("name", "content", "named"),
    [
        ("frame", np.full((120, 160), 0.5), "constant"),
        ("frame", b"hello", "frame.png"),
        ("mask", np.ones((60, 80)), "80x60 px"),
        ("calibration", b'{"endolab": 3}', "calibration.png"),
        ("calibration", None, "calibration.png"),
        ("out", b"mine", "out.png"),
    ],
)
def test_a_bad_file(sim, tmp_path, refused, name, content, named):
    given = {"frame": sim / "frame.png", "calibration": sim / "endoscope.json"}
    given |= {"out": tmp_path / "new/out", name: tmp_path / f"{name}.png"}
    if isinstance(content, np.ndarray):
        write_image(given[name], content)
    elif content is not None:
        given[name].write_bytes(content)
    words = f"reconstruct {given.pop('frame')}"
    words += "".join(f" --{option} {path}" for option, path in given.items())
    assert named in refused(words)


@pytest.mark.parametrize(
    ("depth", "truth", "named"),
    [
        ("rel/depth.npz", "none.npz", "none.npz"),
        ("rel/depth.npz", "sim/frame.png", "frame.png"),
        ("rel/depth.npz", "small_depth.png", "4x2 px"),
        ("rel/depth.npz", "sim/truth.npz --scale none", "--scale"),
        ("rel/depth.npz", "sim/truth.npz --max-angle 181", "--max-angle"),
        ("rel/depth.npz", "sim/truth.npz --mask none.png", "none.png"),
        ("rel/depth.npz", "sim", "sim"),
        ("rel", "sim/truth.npz", "truth.npz"),
        ("rel/depth.npz", "sim/truth.npz --max-angle 1e-3", "no pixel"),
        ("sim/frame.png", "sim/truth.npz", "frame.png"),
    ],
)
def test_a_bad_comparison(work, refused, monkeypatch, depth, truth, named):
    monkeypatch.chdir(work)
    write_image(work / "small_depth.png", np.full((2, 4), 0.5), 16)
    assert named in refused(f"evaluate {depth} {truth}")


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("simulate coln --out o", "did you mean colon"),
        ("simulate plane --width 8 --out o", "--width"),
        ("simulate plane --noise -1 --out o", "noise"),
        ("simulate plane --calibration papr --out o", "did you mean paper"),
        ("simulate colon --frames 3 --out o", "--frames"),
        ("simulate sheet --fog 0.1 --out o", "--fog"),
        ("simulate sheet --fold 9 --out o", "--fold"),
        ("frobnicate", "frobnicate"),
        ("", "COMMAND"),
        ("reconstruct a.png --calibration paper", "--out"),
        ("sweep a.png --calibration paper --lam a,b", "--lam"),
        ("sweep a.png --calibration paper --xi e --out o.csv", "xi"),
        ("calibrate v --target charuco --every 0 --out c.json", "--every"),
        ("target chessbord --out t.pdf", "did you mean chessboard"),
    ],
)
def test_a_bad_command(tmp_path, monkeypatch, refused, words, named):
    (tmp_path / "v").mkdir()
    (tmp_path / "v/1.png").write_bytes(b"no picture")
    monkeypatch.chdir(tmp_path)
    assert named in refused(words)


def test_without_numbas_compiler_it_says_so(refused, monkeypatch):
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    assert "NUMBA_DISABLE_JIT" in refused("simulate plane --width 16 --out o")


# As a process of its own ----------------------------------------------------------------
@pytest.fixture
def process(tmp_path):
    """Start the command line in a process of its own."""

    def start(words, stderr=subprocess.PIPE, **environment):
        return subprocess.Popen(
            [sys.executable, "-m", "endolab", *words.split()],
            cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": str(ROOT)} | environment,
            stdout=subprocess.PIPE,
            stderr=stderr,
            # A job in the background ignores Ctrl-C, and so would its children.
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        )

    return start


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_told_to_end_it_writes_the_best_so_far(tmp_path, process, number):
    assert (
        call(f"simulate colon --calibration simple --width 640 --out {tmp_path}/s") == 0
    )
    terminal, end = os.openpty()
    termios.tcsetwinsize(terminal, (24, 80))
    command = "reconstruct s/frame.png --calibration s/endoscope.json --out o"
    command += " --solver primal_dual --max-iterations 1000000"
    with process(command, stderr=end) as running:
        os.close(end)
        content = b""
        while content.count(b"energy") < 5:  # on the bar
            content += os.read(terminal, 1000)
        running.send_signal(number)
        assert running.wait(60) == 0
    assert report(tmp_path / "o")["status"] == "STOPPED"
    assert names(tmp_path / "o") == OUTPUTS


@pytest.mark.parametrize(
    ("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)]
)
def test_told_to_end_before_there_is_anything_it_writes_nothing(
    tmp_path, process, number, status
):
    with process("simulate colon --calibration paper --width 1440 --out o") as running:
        while not list(tmp_path.glob("o/.endolab-*")) and running.poll() is None:
            time.sleep(0.02)
        running.send_signal(number)
        out, error = running.communicate(timeout=60)
    assert (running.returncode, out, error.count(b"\n")) == (status, b"", 1)
    assert b"interrupted" in error
    assert names(tmp_path) == []


def test_told_to_end_within_exec_it_ends_with_its_own_status(tmp_path):
    """Python ends as by Ctrl-C after an interrupt of its own that passed exec(), such as a dataclass's."""
    code = """
        import endolab.synthetic.rendering as rendering
        from endolab.cli.main import run

        rendering.render = lambda *_, **__: exec("import signal; signal.raise_signal(signal.SIGTERM)")
        run()
    """
    (tmp_path / "told.py").write_text(textwrap.dedent(code))
    command = [sys.executable, "-m", "told", "simulate", "colon", "--out", "o"]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, timeout=60)
    assert (ended.returncode, ended.stderr.count(b"\n")) == (143, 1)


def test_nobody_needs_to_read_what_is_printed_in_any_encoding(work, process):
    words = f"evaluate {work}/out/depth.npz {work}/out/depth.npz"
    with process(words, PYTHONIOENCODING="ascii") as running:
        out, error = running.communicate(timeout=60)
    assert (running.returncode, error) == (0, b"")
    assert b"median 0\\xb0" in out
    with process(words, PYTHONUNBUFFERED="1") as running:
        running.stdout.close()  # as after `| head -1`
        assert running.stderr.read() == b""
    command = f"{shlex.quote(sys.executable)} -m endolab {words} >&- 2>&-"
    assert subprocess.run(command, shell=True, timeout=60).returncode == 0


def test_the_first_run_says_that_it_compiles_and_no_other(sim, tmp_path, process):
    known = f"--calibration {sim}/endoscope.json --solver facing --out o"
    for lines in (1, 0):
        cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
        with process(f"reconstruct {sim}/frame.png {known}", **cache) as running:
            _, error = running.communicate(timeout=200)
        assert (running.returncode, error.count(b"\n")) == (0, lines)


def test_help_is_quick_and_loads_nothing_large(process):
    with process("--help", PYTHONPROFILEIMPORTTIME="1") as running:
        out, error = running.communicate(timeout=60)
    for word in (b"reconstruct", b"sweep", b"simulate", b"evaluate"):
        assert word in out
    slow = {
        "numpy",
        "cv2",
        "scipy",
        "numba",
        "matplotlib",
        "rerun",
        "open3d",
        "jupyterlab",
    }
    loaded = {line.rpartition("|")[2].strip() for line in error.decode().splitlines()}
    assert not slow & loaded
