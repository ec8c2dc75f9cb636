"""The command line: what it writes and prints, and one sentence about whatever is wrong."""

import io
import json
import os
import shlex
import shutil
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


def call(*arguments):
    """The exit code of a command."""
    try:
        return cli.main([str(argument) for argument in arguments])
    except SystemExit as exit:
        return exit.code


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def maps(path):
    with np.load(path, allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}


def report(folder):
    return json.loads(
        (folder / "report.json").read_text(encoding="utf-8"), parse_constant=pytest.fail
    )


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """A folder with a simulated frame `sim`, its reconstruction `out`, and one in relative units `rel`."""
    folder = tmp_path_factory.mktemp("work")
    sim = folder / "sim"
    assert (
        call("simulate", "curved", "--out", sim, "--calibration", "simple", "--width", 160)
        == 0
    )
    known = json.loads((sim / "endoscope.json").read_text())
    known["photometry"]["gain"] = None
    (folder / "unknown.json").write_text(json.dumps(known))
    frame = sim / "frame.png"
    assert (
        call(
            "reconstruct",
            frame,
            "--calibration",
            sim / "endoscope.json",
            "--out",
            folder / "out",
        )
        == 0
    )
    assert (
        call(
            "reconstruct",
            frame,
            "--calibration",
            folder / "unknown.json",
            "--out",
            folder / "rel",
        )
        == 0
    )
    return folder


@pytest.fixture
def sim(work):
    return work / "sim"


@pytest.fixture
def solve(sim):
    """Reconstruct the simulated frame with options; the exit code."""

    def run(*options, calibration=sim / "endoscope.json"):
        return call(
            "reconstruct", sim / "frame.png", "--calibration", calibration, *options
        )

    return run


@pytest.fixture
def refused(capsys, tmp_path):
    """Run a command that must fail: exit code 2, nothing on stdout, one line on stderr, nothing written."""

    def run(*arguments):
        before = sorted(tmp_path.rglob("*"))
        capsys.readouterr()
        code = call(*arguments)
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
    assert read_image(sim / "frame.png").shape == (120, 160, 3)
    exact = el.SCENES["curved"].distance(calibration.camera.field.rays)
    np.testing.assert_allclose(truth["distance"], exact, rtol=1e-6)
    assert truth["normals"].shape == (120, 160, 3)
    assert call("simulate", "plane", "--out", sim.parent / "s", "--width", 32) == 0
    assert (
        call("simulate", "tube", "--out", sim.parent / "s", "--width", 32) == 0
    )  # which is endolab's own


def test_a_folder_holds_what_was_written_last_and_what_that_was_made_of(solve, tmp_path):
    out = tmp_path / "s"
    scene = ("--calibration", "simple", "--width", 64, "--out", tmp_path / "s")
    given = ["endoscope.json", "frame.png", "notes.txt", "truth.npz"]
    assert call("simulate", "curved", *scene) == 0
    (out / "notes.txt").write_text("mine")
    how = ("--calibration", out / "endoscope.json", "--out", out)
    assert call("reconstruct", out / "frame.png", *how, "--mesh", "--uncertainty") == 0
    assert names(out) == sorted([*OUTPUTS, *given, "mesh.ply", "mesh_uncertainty.ply"])
    assert call("reconstruct", out / "frame.png", *how, "--overwrite") == 0
    assert names(out) == sorted([*OUTPUTS, *given])
    assert call("simulate", "tube", *scene) == 0
    assert names(out) == sorted([*given, "report.json"])


def test_reconstruct_writes_a_whole_folder(work):
    out = work / "out"
    assert names(out) == OUTPUTS
    depth = maps(out / "depth.npz")
    mask = depth["mask"]
    assert mask.shape == depth["distance"].shape == depth["z"].shape == (120, 160)
    for name in ("distance", "z", "normals"):
        assert np.all(np.isfinite(depth[name][mask]))
        assert np.all(np.isnan(depth[name][~mask]))
    content = report(out)
    assert content["settings"]["channel"] == "separated"
    assert (content["settings"]["frame"], content["pixels"]) == ("frame.png", mask.sum())
    assert sum(one["seconds"] for one in content["stages"]) == pytest.approx(
        content["seconds"]
    )
    header, _, body = (out / "cloud.ply").read_bytes().partition(b"end_header\n")
    assert f"element vertex {mask.sum()}\n".encode() in header
    points = np.frombuffer(
        body, dtype=[("xyz", "<f4", 3), ("n", "<f4", 3), ("rgb", "u1", 3)]
    )
    np.testing.assert_allclose(
        np.linalg.norm(points["xyz"], axis=1), depth["distance"][mask], rtol=1e-5
    )
    assert (out / "recording.rrd").stat().st_size > 10_000


def test_the_summary_tells_how_it_ended_in_which_unit_and_where_it_is(
    work, solve, capsys, tmp_path
):
    for calibration, unit in (
        (work / "sim/endoscope.json", "(mm)"),
        (work / "unknown.json", "(relative"),
    ):
        quick = ("--width", "80", "--channel", "green", "--out", tmp_path / unit)
        assert solve(*quick, calibration=calibration) == 0
        output, error = capsys.readouterr()
        assert error == ""
        content = report(tmp_path / unit)
        for words in (
            "CONVERGED",
            f"gauss_newton, {content['iterations']} iteration",
            unit,
            str(tmp_path),
        ):
            assert words in output
        assert ("--median-distance" in output) == (unit != "(mm)")


def test_mesh_and_preparation_and_snapshots_come_if_they_are_asked_for(
    solve, tmp_path, capsys
):
    assert (
        solve("--solver", "facing", "--out", tmp_path / "out", "--mesh", "--prepare") == 0
    )
    assert names(tmp_path / "out") == sorted([*OUTPUTS, "mesh.ply", "preparation.png"])
    assert "100 % of the picture" in capsys.readouterr().out
    march = ("--width", "80", "--solver", "fast_marching", "--snapshots", "3")
    assert solve(*march, "--out", tmp_path / "m") == 0
    assert "fast_marching, 3 iterations" in capsys.readouterr().out


def test_trust_comes_if_it_is_asked_for(solve, sim, tmp_path, capsys, refused):
    assert solve("--width", "80", "--out", tmp_path / "out", "--uncertainty", "--mesh") == 0
    assert names(tmp_path / "out") == sorted([*OUTPUTS, "mesh.ply", "mesh_uncertainty.ply"])
    assert "σ of the distance: " in capsys.readouterr().out
    depth = maps(tmp_path / "out/depth.npz")
    assert (depth["sigma"][depth["mask"]] > 0).all()
    assert report(tmp_path / "out")["uncertainty"]["status"] == "CONVERGED"
    assert call("evaluate", tmp_path / "out/depth.npz", sim / "truth.npz") == 0
    assert "within 1 σ" in capsys.readouterr().out
    assert call("evaluate", tmp_path / "out/depth.npz", sim / "truth.npz", "--json") == 0
    assert 0 < json.loads(capsys.readouterr().out)["coverage"]["within_one"] <= 100
    command = (
        "reconstruct",
        sim / "frame.png",
        "--calibration",
        sim / "endoscope.json",
        "--uncertainty",
    )
    assert "'facing'" in refused(*command, "--solver", "facing", "--out", tmp_path / "f")


def test_options_arrive(work, solve, tmp_path):
    write_image(tmp_path / "mask.png", np.arange(160) < np.full((120, 1), 80))
    options = [
        "--mask",
        tmp_path / "mask.png",
        "--xi",
        "d",
        "--regulariser",
        "first",
        "--lam",
        "0.5",
    ]
    options += [
        "--channel",
        "red",
        "--median-distance",
        "33",
        "--width",
        "80",
        "--smooth",
        "1.5",
    ]
    options += [
        "--epsilon",
        "2e-3",
        "--threshold",
        "0.04",
        "--max-iterations",
        "2",
        "--contours",
        "no",
    ]
    options += ["--highlights", "inpaint", "--albedo", "0.4"]
    assert solve("--out", tmp_path / "o", *options, calibration=work / "unknown.json") == 0
    content = report(tmp_path / "o")
    expected = {
        "xi": "d",
        "regulariser": "first",
        "lam": 0.5,
        "channel": "red",
        "width": 80,
        "smooth": 1.5,
    }
    expected |= {"epsilon": 2e-3, "threshold": 0.04, "highlights": "inpaint"}
    assert content["iterations"] <= 2
    assert content["settings"] | expected == content["settings"]
    depth = maps(tmp_path / "o/depth.npz")
    assert depth["distance"].shape == (60, 80)
    assert depth["mask"][:, :39].mean() > 0.9
    assert not depth["mask"][:, 41:].any()
    assert np.nanmedian(depth["distance"]) == pytest.approx(33, rel=1e-4)
    assert content["metric"]


@pytest.mark.parametrize(
    ("name", "width"), [("distance", ["--width", "80"]), ("diameter", [])]
)
def test_a_known_length_fixes_the_scale(work, sim, solve, tmp_path, name, width):
    """Pixels are those of the picture, however much it was shrunk."""
    with np.load(sim / "truth.npz") as truth:
        points = (
            truth["distance"][..., None]
            * el.load_calibration(sim / "endoscope.json").camera.field.rays
        )
    one = points[40, 30]
    other = points[85, 120]
    known = {"distance": f"{np.linalg.norm(one)},30,40"}
    known["diameter"] = f"{np.linalg.norm(one - other)},30,40,120,85"
    options = ["--out", tmp_path, *width, f"--known-{name}", known[name]]
    assert solve(*options, calibration=work / "unknown.json") == 0
    found = maps(tmp_path / "depth.npz")
    true = np.median(np.linalg.norm(points, axis=-1)[maps(work / "out/depth.npz")["mask"]])
    assert np.median(found["distance"][found["mask"]]) == pytest.approx(true, rel=0.01)


def test_a_settings_file_gives_what_options_give_and_options_win(solve, tmp_path):
    output = {
        "lam": 0.1 + 0.2,
        "xi": "d",
        "regulariser": "first",
        "channel": "green",
        "width": 48,
    }
    output |= {"contours": False, "known_distance": (30.0, 32.5, 20.0)}
    write_settings(SolvingSettings(output, {"k": 2.0, "albedo": 0.5}), tmp_path / "s.json")
    given = [
        "--regulariser",
        "first",
        "--channel",
        "green",
        "--width",
        48,
        "--contours",
        "no",
    ]
    given += ["--known-distance", "30,32.5,20"]
    write_settings(SolvingSettings({}, {"k": 2.0, "albedo": 0.5}), tmp_path / "light.json")
    runs = {
        "file": ["--settings", tmp_path / "s.json"],
        "options": [
            *given,
            "--xi",
            "d",
            "--lam",
            0.1 + 0.2,
            "--settings",
            tmp_path / "light.json",
        ],
        "both": [
            "--lam",
            1,
            "--settings",
            tmp_path / "s.json",
            "--median-distance",
            20,
            "--albedo",
            0.9,
        ],
    }
    for name, options in runs.items():
        assert solve(*options, "--out", tmp_path / name) == 0
    content = {name: report(tmp_path / name)["settings"] for name in runs}
    assert content["file"] == content["options"]
    found = {name: maps(tmp_path / name / "depth.npz")["distance"] for name in runs}
    np.testing.assert_array_equal(found["file"], found["options"])
    assert (
        content["both"]["lam"],
        content["both"]["xi"],
        content["both"]["known_distance"],
    ) == (
        1,
        "d",
        None,
    )
    assert np.nanmedian(found["both"]) == pytest.approx(20, rel=1e-6)


def test_a_depth_map_that_is_given_as_a_frame_is_suspected(work, sim, tmp_path, capsys):
    write_image(tmp_path / "1.png", maps(sim / "truth.npz")["z"] / 100, 16)
    how = ["--calibration", work / "unknown.json", "--solver", "facing", "--out"]
    for frame, suspected in ((tmp_path / "1.png", True), (sim / "frame.png", False)):
        assert call("reconstruct", frame, *how, tmp_path / frame.stem) == 0
        assert ("depth map" in capsys.readouterr().out) == suspected


def test_evaluate_compares_with_the_truth(work, sim, solve, tmp_path, capsys):
    """Which may be of a published data set, and is resampled for the result of a shrunk frame."""

    def errors(depth, truth, *options):
        assert call("evaluate", depth, truth, *options, "--json") == 0
        return json.loads(capsys.readouterr().out, parse_constant=pytest.fail)

    assert solve("--width", "80", "--out", tmp_path / "small") == 0
    write_image(tmp_path / "0001_depth.png", maps(sim / "truth.npz")["z"] / 100, 16)
    capsys.readouterr()
    whole = errors(work / "out/depth.npz", sim / "truth.npz")
    found = maps(work / "out/depth.npz")["distance"]
    true = maps(sim / "truth.npz")["distance"]
    assert whole["mean_percent"] == pytest.approx(
        100 * np.nanmean(np.abs(found - true) / true), rel=1e-5
    )
    assert whole["scale"] == 1.0
    assert whole["mean_percent"] < 0.6
    assert whole["mean_degrees"] < 2
    relative = errors(work / "rel/depth.npz", sim / "truth.npz")
    assert relative["scale"] > 10
    assert relative["mean_percent"] < 0.6
    narrow = errors(work / "rel/depth.npz", sim / "truth.npz", "--max-angle", "20")
    assert narrow["pixels"] < 0.5 * relative["pixels"]
    for truth in (sim / "truth.npz", tmp_path / "0001_depth.png"):
        shrunk = errors(tmp_path / "small/depth.npz", truth)
        assert shrunk["mean_percent"] < whole["mean_percent"] + 0.2
        assert (shrunk["truth_resampled_from"], shrunk["pixels"]) == ([160, 120], 80 * 60)
    assert call("evaluate", work / "out/depth.npz", sim / "truth.npz") == 0
    assert f"{whole['mean_percent']:.4g}" in capsys.readouterr().out


# What it refuses ------------------------------------------------------------------------
def test_what_is_there_is_replaced_if_it_is_endolabs_and_else_only_when_asked(
    solve, tmp_path
):
    (tmp_path / "mine.txt").write_text("old")
    quick = ("--solver", "facing", "--out", tmp_path)
    assert solve(*quick) == 2
    assert names(tmp_path) == ["mine.txt"]
    assert solve(*quick, "--overwrite") == 0
    assert solve(*quick, "--xi", "d") == 0  # ours now
    assert names(tmp_path) == sorted([*OUTPUTS, "mine.txt"])
    assert (tmp_path / "mine.txt").read_text() == "old"


@pytest.mark.parametrize("read", ["frame", "calibration", "settings"])
def test_what_a_command_reads_is_never_replaced(sim, tmp_path, refused, read):
    inputs = {
        "frame": "overview.png",
        "calibration": "report.json",
        "settings": "report.json",
    }
    given = {"frame": sim / "frame.png", "calibration": sim / "endoscope.json"}
    write_settings(SolvingSettings(), tmp_path / "report.json")
    if read != "settings":
        shutil.copy(given[read], tmp_path / inputs[read])
    given[read] = tmp_path / inputs[read]
    command = [
        "reconstruct",
        given.pop("frame"),
        "--solver",
        "facing",
        "--out",
        tmp_path,
        "--overwrite",
    ]
    for name, path in given.items():
        command += [f"--{name}", path]
    assert inputs[read] in refused(*command)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--solver", "gaus_newton"], "did you mean gauss_newton"),
        (["--snapshots", "3"], "snapshots"),
        (["--channel", "pink"], "--channel"),
        (["--lam", "nan"], "lam"),
        (["--lam", "auto"], "--lam"),
        (["--max-iterations", "0"], "--max-iterations"),
        (["--threads", "0"], "--threads"),
        (["--known-distance", "30,a,2"], "--known-distance"),
        (["--known-distance", "30,160,60"], "column 160"),
        (["--known-diameter", "9,1,2"], "--known-diameter"),
        (["--highlights", "paint"], "--highlights"),
        (["--albedo", "2"], "--albedo"),
        (["--width", "161"], "161"),
        (["--every", "2"], "--every"),
        (["--settings", "none.json"], "none.json"),
        (["--bogus"], "--bogus"),
        (["--lam=" + "7" * 10**6 + "x"], "--lam"),
    ],
    ids=lambda value: " ".join(value)[:40] if isinstance(value, list) else "",
)
def test_a_bad_option(sim, tmp_path, refused, options, named):
    command = ("reconstruct", sim / "frame.png", "--calibration", sim / "endoscope.json")
    assert named in refused(*command, *options, "--out", tmp_path / "new/out")


@pytest.mark.parametrize(
    ("name", "content", "named"),
    [
        ("frame", np.full((120, 160), 0.5), "constant"),
        ("frame", np.full((60, 80), 0.5), "80x60 px"),
        ("frame", b"hello", "frame.png"),
        ("frame", None, "frame.png"),
        ("frame", "folder", "frame.png"),
        ("mask", np.zeros((120, 160)), "mask.png"),
        ("mask", np.ones((60, 80)), "80x60 px"),
        ("calibration", b'{"endolab": 3}', "calibration.png"),
        ("calibration", None, "calibration.png"),
        ("out", b"mine", "out.png"),
    ],
)
def test_a_bad_file(sim, tmp_path, refused, name, content, named):
    given = {
        "frame": sim / "frame.png",
        "calibration": sim / "endoscope.json",
        "out": tmp_path / "new/out",
    }
    given[name] = path = tmp_path / f"{name}.png"
    if isinstance(content, np.ndarray):
        write_image(path, content)
    elif isinstance(content, bytes):
        path.write_bytes(content)
    elif content:
        path.mkdir()
    options = [
        word
        for option, path in given.items()
        if option != "frame"
        for word in (f"--{option}", path)
    ]
    assert named in refused("reconstruct", given["frame"], *options)


FLAT = np.full((120, 160), 50.0)


def npz(**named):
    np.savez(stream := io.BytesIO(), **named)
    return stream.getvalue()


@pytest.mark.parametrize(
    "content",
    [
        b"hello",
        npz(distance=FLAT, z=FLAT)[:5000],
        npz(distance=FLAT),
        npz(distance=np.array([None])),
    ],
)
def test_a_bad_depth_map(sim, tmp_path, refused, content):
    (tmp_path / "depth.npz").write_bytes(content)
    assert "depth.npz" in refused("evaluate", tmp_path / "depth.npz", sim / "truth.npz")


@pytest.mark.parametrize(
    ("truth", "options", "named"),
    [
        ("none.npz", [], "none.npz"),
        ("frame.png", [], "frame.png"),
        ("0001_depth.png", [], "4x2 px"),
        ("truth.npz", ["--scale", "none"], "--scale"),
        ("truth.npz", ["--max-angle", "0"], "--max-angle"),
        ("truth.npz", ["--max-angle", "1e-3"], "no pixel"),
    ],
)
def test_a_bad_comparison(work, tmp_path, refused, truth, options, named):
    write_image(tmp_path / "0001_depth.png", np.full((2, 4), 0.5), 16)
    path = work / "sim" / truth if truth in ("truth.npz", "frame.png") else tmp_path / truth
    assert named in refused("evaluate", work / "rel/depth.npz", path, *options)


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("simulate coln --out o", "did you mean colon"),
        ("simulate plane --width 8 --out o", "--width"),
        ("simulate plane --noise -1 --out o", "noise"),
        ("simulate plane --calibration papr --out o", "did you mean paper"),
        ("simulate plane --seed x --out o", "--seed"),
        ("simulate colon --frames 3 --out o", "--frames"),
        ("simulate sheet --fog 0.1 --out o", "--fog"),
        ("simulate sheet --fold 9 --out o", "--fold"),
        ("frobnicate", "frobnicate"),
        ("", "COMMAND"),
        ("reconstruct a.png --calibration paper", "--out"),
        ("sweep", "FRAME"),
        ("sweep a.png --calibration paper --lam a,b", "--lam"),
        ("sweep a.png --calibration paper --jobs 0", "n_jobs"),
        ("sweep a.png --calibration paper --xi e --out o.csv", "xi"),
        ("evaluate depth.npz", "TRUTH"),
        ("calibrate v --target charuco --every 0 --out c.json", "--every"),
        ("target chessbord --out t.pdf", "did you mean chessboard"),
    ],
)
def test_a_bad_command(tmp_path, monkeypatch, refused, words, named):
    (tmp_path / "v").mkdir()
    (tmp_path / "v/1.png").write_bytes(b"no picture")
    monkeypatch.chdir(tmp_path)
    assert named in refused(*words.split())


# As a process of its own ----------------------------------------------------------------
@pytest.fixture
def process(sim, tmp_path):
    """Start the command line in a process of its own."""

    def start(*arguments, stderr=subprocess.PIPE, **environment):
        command = [sys.executable, "-m", "endolab", *map(str, arguments)]
        environment = os.environ | {"PYTHONPATH": str(ROOT)} | environment
        how = {
            "cwd": tmp_path,
            "env": environment,
            "stdout": subprocess.PIPE,
            "stderr": stderr,
        }
        # A job in the background ignores Ctrl-C, and so would its children.
        return subprocess.Popen(
            command, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL), **how
        )

    return start


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_told_to_end_it_writes_the_best_so_far(tmp_path, process, number):
    assert (
        call(
            "simulate",
            "colon",
            "--calibration",
            "simple",
            "--width",
            640,
            "--out",
            tmp_path / "s",
        )
        == 0
    )
    terminal, end = os.openpty()
    termios.tcsetwinsize(terminal, (24, 80))
    command = [
        "reconstruct",
        "s/frame.png",
        "--calibration",
        "s/endoscope.json",
        "--out",
        "o",
    ]
    command += ["--solver", "primal_dual", "--max-iterations", 10**6]
    with process(*command, stderr=end) as running:
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
    with process(
        "simulate", "colon", "--calibration", "paper", "--width", 1440, "--out", "o"
    ) as running:
        while not list(tmp_path.glob("o/.endolab-*")) and running.poll() is None:
            time.sleep(0.02)
        running.send_signal(number)
        out, error = running.communicate(timeout=60)
    assert (running.returncode, out, error.count(b"\n"), b"interrupted" in error) == (
        status,
        b"",
        1,
        True,
    )
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
    depth = work / "out/depth.npz"
    with process("evaluate", depth, depth, PYTHONIOENCODING="ascii") as running:
        out, error = running.communicate(timeout=60)
    assert (running.returncode, error) == (0, b"")
    assert b"median 0\\xb0" in out
    with process("evaluate", depth, depth, PYTHONUNBUFFERED="1") as running:
        running.stdout.close()  # as after `| head -1`
        assert running.stderr.read() == b""
    command = (
        f"{shlex.quote(sys.executable)} -m endolab evaluate '{depth}' '{depth}' >&- 2>&-"
    )
    assert subprocess.run(command, shell=True, timeout=60).returncode == 0


def test_the_first_run_says_that_it_compiles_and_no_other(sim, tmp_path, process):
    command = [
        "reconstruct",
        sim / "frame.png",
        "--calibration",
        sim / "endoscope.json",
        "--out",
        "o",
    ]
    for lines in (1, 0):
        with process(
            *command, "--solver", "facing", NUMBA_CACHE_DIR=str(tmp_path / "cache")
        ) as running:
            _, error = running.communicate(timeout=200)
        assert (running.returncode, error.count(b"\n")) == (0, lines)


def test_help_is_quick_and_loads_nothing_large(process):
    with process("--help", PYTHONPROFILEIMPORTTIME="1") as running:
        out, error = running.communicate(timeout=60)
    for word in (b"reconstruct", b"sweep", b"simulate", b"evaluate"):
        assert word in out
    slow = {"numpy", "cv2", "scipy", "numba", "matplotlib", "rerun", "open3d", "jupyterlab"}
    assert not slow & {
        line.rpartition("|")[2].strip() for line in error.decode().splitlines()
    }
