"""The command line: what it writes, and one sentence about whatever is wrong."""

import io
import json
import os
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numba
import numpy as np
import pytest

import endolab as el
from endolab.cli import main as cli
from endolab.cli import reconstruct as cli_reconstruct
from endolab.cli.streams import EACH_TIME, ONCE
from endolab.depth.solvers import DEFAULT_SOLVER, SOLVERS
from endolab.io.images import read_image, write_image
from endolab.numerics import threads
from endolab.numerics.compiled import COMPILED
from endolab.reconstruction import problem_setup as posing
from endolab.reconstruction import reconstruct as reconstruction

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


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """A folder with a simulated frame `sim`, its reconstruction `out`, and one in relative units `rel`."""
    folder = tmp_path_factory.mktemp("work")
    sim = folder / "sim"
    assert call("simulate", "curved", "--out", sim, "--calibration", "simple", "--width", 160) == 0
    known = json.loads((sim / "endoscope.json").read_text())
    known["photometry"]["gain"] = None
    (folder / "unknown.json").write_text(json.dumps(known))
    frame = sim / "frame.png"
    assert call("reconstruct", frame, "--calibration", sim / "endoscope.json", "--out", folder / "out") == 0
    assert call("reconstruct", frame, "--calibration", folder / "unknown.json", "--out", folder / "rel") == 0
    return folder


@pytest.fixture
def sim(work):
    return work / "sim"


@pytest.fixture
def solve(sim):
    """Reconstruct the simulated frame with options; the exit code."""

    def run(*options, calibration=sim / "endoscope.json"):
        return call("reconstruct", sim / "frame.png", "--calibration", calibration, *options)

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
        assert error.endswith("\n")
        assert error.count("\n") == 1
        assert sorted(tmp_path.rglob("*")) == before
        return error

    return run


@pytest.fixture
def unsolved(sim, tmp_path, refused):
    """What is said when the simulated frame cannot be reconstructed so."""

    def run(*options, frame=sim / "frame.png", calibration=sim / "endoscope.json"):
        how = ("--calibration", calibration, "--out", tmp_path / "new/out")
        return refused("reconstruct", frame, *how, *options)

    return run


def test_simulate_writes_a_frame_and_its_truth(sim):
    assert names(sim) == ["endoscope.json", "frame.png", "truth.npz"]
    calibration, truth = el.Calibration.load(sim / "endoscope.json"), maps(sim / "truth.npz")
    assert calibration.photometry.gain > 0
    assert read_image(sim / "frame.png").shape == (120, 160, 3)
    exact = el.SCENES["curved"].distance(calibration.camera.field.rays)
    np.testing.assert_allclose(truth["distance"], exact, rtol=1e-6)
    assert truth["normals"].shape == (120, 160, 3)
    assert bool(truth["metric"])


def test_reconstruct_writes_a_whole_folder(work):
    out = work / "out"
    assert names(out) == OUTPUTS
    depth = maps(out / "depth.npz")
    assert set(depth) == {"distance", "z", "normals", "mask", "metric"}
    mask = depth["mask"]
    assert mask.shape == depth["distance"].shape == depth["z"].shape == (120, 160)
    for name in ("distance", "z", "normals"):
        assert np.all(np.isfinite(depth[name][mask]))
        assert np.all(np.isnan(depth[name][~mask]))
    report = json.loads((out / "report.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert {"iterations", "energy", "seconds"} <= set(report)
    *before, stage = report["stages"]
    assert {"bounced light"} == {one["name"] for one in before}
    assert (stage["name"], stage["iterations"]) == ("solution", report["iterations"])
    assert sum(one["seconds"] for one in report["stages"]) == pytest.approx(report["seconds"])
    assert report["settings"]["channel"] == "separated"
    assert (report["settings"]["frame"], report["pixels"]) == ("frame.png", mask.sum())
    header, _, body = (out / "cloud.ply").read_bytes().partition(b"end_header\n")
    assert f"element vertex {mask.sum()}\n".encode() in header
    points = np.frombuffer(body, dtype=[("xyz", "<f4", 3), ("n", "<f4", 3), ("rgb", "u1", 3)])
    np.testing.assert_allclose(np.linalg.norm(points["xyz"], axis=1), depth["distance"][mask], rtol=1e-5)
    assert (out / "recording.rrd").read_bytes()[:3] == b"RRF"
    assert (out / "recording.rrd").stat().st_size > 10_000


def test_the_report_says_where_all_the_time_went(work):
    report = json.loads((work / "out/report.json").read_text(encoding="utf-8"))
    clock = report["clock"]
    stages = {"starting", "reading", "preparing", "recording", "writing"}
    stages |= {stage["name"] for stage in report["stages"]}
    assert set(clock["stages"]) == stages
    assert min(clock["stages"].values()) >= 0
    assert sum(clock["stages"].values()) == pytest.approx(clock["in_all"], rel=1e-9)
    solved = sum(clock["stages"][stage] for stage in {stage["name"] for stage in report["stages"]})
    assert solved == pytest.approx(report["seconds"], rel=1e-9)
    assert set(clock["outputs"]) == {"overview.png", "depth.npz", "cloud.ply", "recording.rrd"}
    assert 0 < max(clock["outputs"].values()) <= clock["stages"]["writing"]


def test_the_stages_are_the_time_that_passed_outside(sim, tmp_path):
    """From the start of the process until it has ended, but for moving the files and ending."""
    command = [sys.executable, "-m", "endolab", "reconstruct", sim / "frame.png", "--out", tmp_path]
    began = time.perf_counter()
    subprocess.run([*command, "--calibration", sim / "endoscope.json"], check=True, capture_output=True)
    passed = time.perf_counter() - began
    stages = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))["clock"]["stages"]
    assert 0.9 * passed < sum(stages.values()) < passed + 0.05


def test_the_summary_tells_the_same_time(solve, tmp_path, capsys):
    assert solve("--solver", "facing", "--out", tmp_path) == 0
    seconds = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))["clock"]["in_all"]
    assert f"; {seconds:.1f} s in all\n" in capsys.readouterr().out


def test_the_first_run_says_that_it_compiles(sim, tmp_path):
    """And no other does; in a process of its own, which Matplotlib is not loaded into."""
    command = [sys.executable, "-m", "endolab", "reconstruct", sim / "frame.png", "--out", tmp_path / "out"]
    command += ["--calibration", sim / "endoscope.json", "--solver", "fast_marching", "--width", "80"]
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    for said in (f"{ONCE}\n", ""):
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=200)
        assert (done.returncode, done.stderr) == (0, said)
        assert names(tmp_path / "out") == OUTPUTS


@pytest.mark.parametrize(
    ("does", "command"),
    [
        ("endolab.batch.sweep.sweep", ["sweep", "--out", "t.csv", "frame.png", "--calibration"]),
        ("endolab.batch.video.reconstruct_video", ["reconstruct", ".", "--out", "out", "--calibration"]),
        (
            "endolab.reconstruction.unknown_light.estimate_light",
            ["calibrate-light", "frame.png", "--out", "e.json", "--camera"],
        ),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_whatever_compiles_says_so(sim, tmp_path, monkeypatch, capsys, does, command):
    def compile_something(*given, **options):
        assert numba.njit(lambda x: x + 1)(1) == 2
        raise ValueError("enough")

    write_image(tmp_path / "frame.png", np.zeros((120, 160)))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(does, compile_something)
    assert call(*command, sim / "endoscope.json") == 2
    said = ONCE if COMPILED["cache"] else EACH_TIME
    assert capsys.readouterr().err.splitlines() == [said, "endolab: enough"]


@pytest.mark.parametrize(
    ("count", "complaint"),
    [
        ("0", "--threads must be at least 1, got 0"),
        ("-1", "--threads must be at least 1, got -1"),
        ("x", "argument --threads: expected a whole number, found 'x'"),
        ("1.5", "argument --threads: expected a whole number, found '1.5'"),
    ],
)
def test_a_number_of_threads_that_is_none_is_refused(unsolved, count, complaint):
    assert complaint in unsolved("--threads", count)


@pytest.mark.parametrize("before", [None, "3"])
def test_so_many_threads_are_taken_and_no_more_said_afterwards(solve, tmp_path, monkeypatch, before):
    counts = []
    real = reconstruction.reconstruct

    def counted(*given, **options):
        counts.append((threads.threads(), os.environ[threads.VARIABLE]))
        return real(*given, **options)

    monkeypatch.delenv(threads.VARIABLE, raising=False)
    if before is not None:
        monkeypatch.setenv(threads.VARIABLE, before)
    monkeypatch.setattr(reconstruction, "reconstruct", counted)
    found = []
    for count in (1, 2):
        out = tmp_path / str(count)
        assert solve("--threads", count, "--out", out) == 0  # of 160x120 px: enough for several to be woken
        assert os.environ.get(threads.VARIABLE) == before
        found.append(maps(out / "depth.npz"))
    assert counts == [(1, "1"), (min(2, int(numba.config.NUMBA_NUM_THREADS)), "2")]
    assert threads.ENOUGH <= 160 * 120
    for name, values in found[0].items():
        np.testing.assert_array_equal(values, found[1][name])


def test_what_came_before_rerun_was_loaded_is_recorded_too(sim, tmp_path, monkeypatch):
    """And in the same order; after a failure nothing is written."""
    loaded = threading.Event()
    seen = []

    class Recorder:
        def __init__(self, path):
            loaded.wait(60)

        def __call__(self, iterate):
            seen.append(iterate)

        def close(self):
            seen.append("closed")

    monkeypatch.setattr("endolab.recording.recorder.record", Recorder)
    with cli_reconstruct._Recording(tmp_path / "a.rrd") as recording:
        recording(1)
        recording(2)
        assert seen == []
        loaded.set()
        recording.write(tmp_path)
    assert seen == [1, 2, "closed"]
    failed = cli_reconstruct._Recording(tmp_path / "b.rrd")
    failed(3)
    failed.__exit__(ValueError)
    assert seen[-1] == "closed"  # and let go of


def test_a_mesh_and_the_preparation_come_if_they_are_asked_for(solve, tmp_path, capsys):
    assert solve("--solver", "facing", "--out", tmp_path / "out", "--mesh", "--prepare") == 0
    assert names(tmp_path / "out") == sorted([*OUTPUTS, "mesh.ply", "preparation.png"])
    said = capsys.readouterr().out
    assert "depth.npz, mesh.ply, overview.png, preparation.png" in said
    assert "The endoscope shows 100 % of the picture." in said
    assert (tmp_path / "out/mesh.ply").read_bytes().startswith(b"ply\nformat binary_little_endian")
    assert read_image(tmp_path / "out/preparation.png").shape[1] == 1600


def test_trust_comes_if_it_is_asked_for(work, solve, sim, tmp_path, capsys):
    assert solve("--width", "80", "--out", tmp_path / "out", "--trust", "--mesh") == 0
    assert names(tmp_path / "out") == sorted([*OUTPUTS, "mesh.ply", "mesh_trust.ply"])
    assert b"sigma" in (tmp_path / "out/mesh_trust.ply").read_bytes()[:600]
    said = capsys.readouterr().out
    assert "σ of the distance: " in said
    assert "Who decided the pixels: data " in said
    assert "No standard errors of the calibration are known" in said
    depth = maps(tmp_path / "out/depth.npz")
    inside = depth["mask"]
    assert (depth["sigma"][inside] > 0).all()
    assert np.isnan(depth["sigma"][~inside]).all()
    assert set(np.unique(depth["decided_by"][inside])) <= {1, 2, 3}
    report = json.loads((tmp_path / "out/report.json").read_text())
    assert report["clock"]["stages"]["trust"] > 0
    assert report["trust"]["status"] == "CONVERGED"
    assert call("evaluate", tmp_path / "out/depth.npz", sim / "truth.npz") == 0
    assert "within 1 σ" in capsys.readouterr().out
    assert call("evaluate", tmp_path / "out/depth.npz", sim / "truth.npz", "--json") == 0
    assert 0 < json.loads(capsys.readouterr().out)["coverage"]["within_one"] <= 100
    assert call("evaluate", work / "out/depth.npz", sim / "truth.npz") == 0
    assert "within 1 σ" not in capsys.readouterr().out


def test_trust_that_cannot_be_told_is_said_before_anything_is_solved(unsolved):
    assert "'facing' minimises no energy" in unsolved("--trust", "--solver", "facing")


def test_no_patience_for_trust_leaves_the_surface(solve, tmp_path, capsys, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("endolab.uncertainty.trust.trust_of", interrupted)
    assert solve("--width", "80", "--channel", "green", "--out", tmp_path / "out", "--trust") == 0
    assert "interrupted" in capsys.readouterr().out
    assert "sigma" not in maps(tmp_path / "out/depth.npz")


def test_the_summary_tells_the_unit(work, solve, capsys, tmp_path):
    assert solve("--solver", "facing", "--out", tmp_path / "a") == 0
    known, error = capsys.readouterr()
    assert error == ""
    assert "CONVERGED" in known
    assert "(mm)" in known
    assert str(tmp_path / "a") in known
    assert "relative" not in known
    unknown = work / "unknown.json"
    assert solve("--solver", "facing", "--out", tmp_path / "b", calibration=unknown) == 0
    unknown = capsys.readouterr().out
    assert "(relative units)" in unknown
    assert "--median-distance" in unknown
    assert "(mm)" not in unknown


def test_the_summary_counts_the_steps(solve, capsys, tmp_path):
    """Of several iterates it tells both ends of the energy, as the report and the bar count them."""
    for solver in (DEFAULT_SOLVER, "facing"):
        assert solve("--width", "80", "--solver", solver, "--channel", "green", "--out", tmp_path) == 0
        said = capsys.readouterr().out.splitlines()[1]
        report = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
        count = report["iterations"]
        assert count != 1
        assert said.startswith(f"{solver}, {count} iterations, {report['seconds']:.2f} s, energy ")
        energies = said.split("energy ")[1].split(",")[0].split(" to ")
        assert (energies[-1], len(energies)) == (f"{report['energy']:.3e}", 2 if count else 1)
        assert float(energies[0]) > 10 * report["energy"] or not count


def test_a_depth_map_that_is_given_as_a_frame_is_suspected(work, sim, tmp_path, capsys):
    """By its name, or because it has no noise; nothing is said of a picture."""
    z = maps(sim / "truth.npz")["z"] / 100
    film = tmp_path / "film"
    film.mkdir()
    for name, image in (
        ("1.png", z),
        ("0001_depth.png", 0.5 + 0 * z),
        ("frame.png", read_image(sim / "frame.png")),
    ):
        write_image(film / name, image, 16)
    how = ["--calibration", work / "unknown.json", "--solver", "facing", "--out"]
    for name, suspected in (("1.png", True), ("frame.png", False)):
        assert call("reconstruct", film / name, *how, tmp_path / name) == 0
        assert (f"{name} may be a depth map and no picture" in capsys.readouterr().out) == suspected
    assert call("reconstruct", film, *how, tmp_path / "film-out") == 0
    assert (
        "holds depth maps too, which are taken for frames, such as 0001_depth.png" in capsys.readouterr().out
    )


@pytest.mark.parametrize("snapshots", [[], ["--snapshots", "3"]])
def test_a_march_shows_its_front(solve, capsys, tmp_path, snapshots):
    assert solve("--width", "80", "--solver", "fast_marching", "--out", tmp_path, *snapshots) == 0
    assert f"fast_marching, {3 if snapshots else 12} iterations" in capsys.readouterr().out


def test_the_bar_counts_what_the_report_counts(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    monkeypatch.setattr(sys, "stderr", Terminal())
    bar = cli_reconstruct._Progress(None)
    for k in range(4):
        bar(SimpleNamespace(k=k, energy=0.1**k, stage="solution", round=0))
        assert bar.bar.n == k
    bar(SimpleNamespace(k=0, energy=1.0, stage="bounced light", round=2))
    assert (bar.bar.n, bar.bar.desc) == (0, "bounced light, round 2: ")
    bar(SimpleNamespace(k=3, energy=1e-3, stage="solution", round=0))
    bar.bar.refresh()
    assert "3it" in sys.stderr.getvalue()
    assert "energy 1.000e-03" in sys.stderr.getvalue()
    bar.close()


def test_options_arrive(work, solve, tmp_path):
    write_image(tmp_path / "mask.png", np.arange(160) < np.full((120, 1), 80))
    options = ["--mask", tmp_path / "mask.png", "--xi", "d", "--regulariser", "first", "--lam", "0.5"]
    options += ["--channel", "red", "--median-distance", "33", "--width", "80", "--smooth", "1.5"]
    options += ["--epsilon", "2e-3", "--threshold", "0.04", "--max-iterations", "2"]
    assert solve("--out", tmp_path / "o", *options, calibration=work / "unknown.json") == 0
    report = json.loads((tmp_path / "o/report.json").read_text(encoding="utf-8"))
    expected = {"xi": "d", "regulariser": "first", "lam": 0.5, "channel": "red", "width": 80, "smooth": 1.5}
    expected |= {"epsilon": 2e-3, "threshold": 0.04}
    assert report["iterations"] <= 2
    assert report["settings"] | expected == report["settings"]
    depth = maps(tmp_path / "o/depth.npz")
    assert depth["distance"].shape == (60, 80)
    assert depth["mask"][:, :39].mean() > 0.9
    assert not depth["mask"][:, 41:].any()
    assert np.nanmedian(depth["distance"]) == pytest.approx(33, rel=1e-4)
    assert report["metric"]


def test_lam_can_be_chosen(solve, tmp_path, capsys):
    assert solve("--out", tmp_path / "o", "--lam", "auto") == 0
    report = json.loads((tmp_path / "o/report.json").read_text(encoding="utf-8"))
    lam = report["settings"]["lam"]
    assert report["lam_curve"]["lam"][0] <= lam <= report["lam_curve"]["lam"][-1]
    assert f"λ = {lam:.3g} was chosen" in capsys.readouterr().out


@pytest.mark.parametrize(("name", "width"), [("distance", ["--width", "80"]), ("diameter", [])])
def test_a_known_length_fixes_the_scale(work, sim, solve, tmp_path, capsys, name, width):
    """Pixels are those of the picture, however much it was shrunk."""
    with np.load(sim / "truth.npz") as truth:
        points = truth["distance"][..., None] * el.Calibration.load(sim / "endoscope.json").camera.field.rays
    one, other = points[40, 30], points[85, 120]
    known = {"distance": f"{np.linalg.norm(one)},30,40"}
    known["diameter"] = f"{np.linalg.norm(one - other)},30,40,120,85"
    options = ["--out", tmp_path, *width, f"--known-{name}", known[name]]
    assert solve(*options, calibration=work / "unknown.json") == 0
    said = capsys.readouterr().out
    assert "(mm)" in said
    report = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert (report["scale"], report["metric"]) == (f"known {name}", True)
    assert "column 30, row 40" in report["meaning"][0]
    found = maps(tmp_path / "depth.npz")
    true = np.median(np.linalg.norm(points, axis=-1)[maps(work / "out/depth.npz")["mask"]])
    assert np.median(found["distance"][found["mask"]]) == pytest.approx(true, rel=0.01)


def test_what_is_said_is_passed_on(solve, tmp_path, monkeypatch):
    """Highlights and contours reach `reconstruct` only if they are asked for."""
    seen = []

    def fail(frame, calibration, **options):
        seen.append({key: options.get(key, "not given") for key in ("highlights", "contours", "channel")})
        raise ValueError("seen")

    monkeypatch.setattr(reconstruction, "reconstruct", fail)
    solve("--out", tmp_path)
    solve("--out", tmp_path, "--contours", "yes", "--highlights", "ignore", "--channel", "separated")
    solve("--out", tmp_path, "--contours", "no", "--highlights", "inpaint")
    solve("--out", tmp_path, "--contours", "auto", "--highlights", "keep")
    none = "not given"
    said = [("ignore", True, "separated"), ("inpaint", False, None), ("keep", none, None)]
    assert [tuple(each.values()) for each in seen] == [(none, none, None), *said]


@pytest.mark.parametrize(("row", "code"), [(40, 0), (400, 2)])
def test_a_known_length_in_a_video_is_of_its_first_frame(work, sim, tmp_path, capsys, row, code):
    film = tmp_path / "film"
    film.mkdir()
    picture = read_image(sim / "frame.png")
    for name, light in (("a.png", 1.0), ("b.png", 0.8), ("c.png", 0.9)):
        write_image(film / name, light * picture)
    options = ["--calibration", work / "unknown.json", "--out", tmp_path / "out"]
    assert call("reconstruct", film, *options, "--known-distance", f"44,30,{row}") == code
    if code:
        assert "a.png: the pixel at column 30, row 400 is outside" in capsys.readouterr().err
        assert not (tmp_path / "out").exists()
        return
    for name in "abc":  # the same scene: the gain changed
        found = maps(tmp_path / f"out/frames/{name}/depth.npz")
        assert found["metric"]
        assert found["distance"][40, 30] == pytest.approx(44, rel=0.06)


def test_reconstruct_again_replaces_what_endolab_wrote_and_nothing_else_unasked(solve, tmp_path, capsys):
    for name in ("mine.txt", "depth.npz"):
        (tmp_path / name).write_text("old")
    quick = ("--solver", "facing", "--out", tmp_path)
    assert solve(*quick) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert str(tmp_path) in said
    assert "--overwrite" in said
    assert {name: (tmp_path / name).read_text() for name in names(tmp_path)} == {
        "mine.txt": "old",
        "depth.npz": "old",
    }
    assert solve(*quick, "--overwrite") == 0
    assert solve(*quick, "--xi", "d") == 0  # ours now
    assert names(tmp_path) == sorted([*OUTPUTS, "mine.txt"])
    assert (tmp_path / "mine.txt").read_text() == "old"
    assert maps(tmp_path / "depth.npz")["distance"].shape == (120, 160)
    (tmp_path / "report.json").write_text("my remarks")
    assert solve(*quick) == 2
    assert (tmp_path / "report.json").read_text() == "my remarks"


@pytest.mark.parametrize("read", ["frame", "calibration"])
def test_what_a_command_reads_is_never_replaced(work, sim, tmp_path, refused, read):
    inputs = {"frame": tmp_path / "overview.png", "calibration": tmp_path / "report.json"}
    for name, path in inputs.items():
        shutil.copy(sim / {"frame": "frame.png", "calibration": "endoscope.json"}[name], path)
    usual = {"frame": sim / "frame.png", "calibration": sim / "endoscope.json"}
    given = usual | {read: inputs[read]}
    command = ("reconstruct", given["frame"], "--calibration", given["calibration"], "--out", tmp_path)
    assert f"{inputs[read]} is read by this very call" in refused(*command, "--overwrite")


def test_simulate_does_not_replace_the_calibration_that_it_was_given(tmp_path, refused, sim):
    given = tmp_path / "endoscope.json"
    shutil.copy(sim / given.name, given)
    command = ("simulate", "curved", "--calibration", given, "--width", 160, "--out", tmp_path)
    assert "--overwrite" in refused(*command)
    assert "endoscope.json is read by this very call" in refused(*command, "--overwrite")
    given.unlink()
    assert call("simulate", "curved", "--width", 160, "--out", tmp_path) == 0


def test_evaluate_compares_with_the_truth(work, sim, capsys):
    assert call("evaluate", work / "out/depth.npz", sim / "truth.npz", "--json") == 0
    errors = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    found, true = maps(work / "out/depth.npz")["distance"], maps(sim / "truth.npz")["distance"]
    relative = np.abs(found - true) / true
    assert errors["mean_percent"] == pytest.approx(100 * np.nanmean(relative), rel=1e-5)
    assert errors["scale"] == 1.0
    assert errors["mean_percent"] < 0.6
    assert errors["mean_degrees"] < 2
    assert call("evaluate", work / "out/depth.npz", sim / "truth.npz") == 0
    text = capsys.readouterr().out
    for key in ("mean_mm", "mean_percent", "rmse_z_mm", "mean_degrees"):
        assert f"{errors[key]:.4g}" in text


def test_evaluate_scales_relative_units(work, sim, capsys):
    assert call("evaluate", work / "rel/depth.npz", sim / "truth.npz", "--json") == 0
    errors = json.loads(capsys.readouterr().out)
    assert errors["scale"] > 10
    assert errors["mean_percent"] < 0.6
    assert call("evaluate", work / "rel/depth.npz", sim / "truth.npz", "--max-angle", "20", "--json") == 0
    assert json.loads(capsys.readouterr().out)["pixels"] < 0.5 * errors["pixels"]


def test_evaluate_reads_a_data_sets_depth_map(work, sim, tmp_path, capsys):
    z = maps(sim / "truth.npz")["z"]
    write_image(tmp_path / "0001_depth.png", z / 100, 16)
    assert call("evaluate", work / "out/depth.npz", tmp_path / "0001_depth.png", "--json") == 0
    errors = json.loads(capsys.readouterr().out)
    assert errors["mean_percent"] < 0.6
    assert errors["mean_degrees"] is None


def test_evaluate_takes_a_result_of_a_shrunk_frame(work, solve, sim, tmp_path, capsys):
    """The truth is resampled to its grid, and says as much as at full size."""

    def errors(depth, truth):
        assert call("evaluate", depth, truth, "--json") == 0
        return json.loads(capsys.readouterr().out)

    assert solve("--width", "80", "--out", tmp_path / "small") == 0
    write_image(tmp_path / "0001_depth.png", maps(sim / "truth.npz")["z"] / 100, 16)
    capsys.readouterr()
    whole = errors(work / "out/depth.npz", sim / "truth.npz")
    for truth in (sim / "truth.npz", tmp_path / "0001_depth.png"):
        shrunk = errors(tmp_path / "small/depth.npz", truth)
        assert shrunk["mean_percent"] < whole["mean_percent"] + 0.2
        assert (shrunk["truth_resampled_from"], shrunk["pixels"]) == ([160, 120], 80 * 60)
    assert errors(tmp_path / "small/depth.npz", sim / "truth.npz")["mean_degrees"] < 2
    assert "truth_resampled_from" not in whole
    assert call("evaluate", tmp_path / "small/depth.npz", sim / "truth.npz") == 0
    said = capsys.readouterr().out
    assert said.startswith("The truth, 160x120 px, is resampled to the result's 80x60 px.\n4800 pixels, ")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ["--solver", "magic"],
            "unknown solver 'magic'; choose facing, fast_marching, gauss_newton or primal_dual",
        ),
        (["--solver", "gaus_newton"], "or primal_dual; did you mean gauss_newton?"),
        (["--snapshots", "3"], "solver 'gauss_newton' has no option 'snapshots'"),
        (["--xi", "z"], "unknown xi 'z'; choose 1/z, d or 1/d"),
        (["--regulariser", "third"], "unknown regulariser 'third'; choose first, second or curvature"),
        (["--channel", "pink"], "unknown channel 'pink'; choose auto, separated, red, green, blue or grey"),
        (["--lam", "-1"], "lam must lie in [0, 1e+12], got -1"),
        (["--lam", "nan"], "lam must be finite, got nan"),
        (["--lam", "much"], "argument --lam: expected a number, found 'much'"),
        (["--lam", "auto", "--solver", "facing"], "and solver 'facing' minimises none"),
        (["--epsilon", "0"], "epsilon must lie in [1e-12, 1e+06], got 0"),
        (["--threshold", "nan"], "threshold must be finite, got nan"),
        (["--max-iterations", "0"], "--max-iterations must be at least 1, got 0"),
        (["--max-iterations", "1e3"], "argument --max-iterations: expected a whole number, found '1e3'"),
        (["--width=--"], "argument --width: expected a value, found '--'"),
        (["--median-distance", "0"], "median_distance"),
        (["--median-distance", "-3"], "median_distance"),
        (["--known-distance", "30"], "--known-distance must be MM,COLUMN,ROW, such as 30,80,80, got 30"),
        (["--known-distance", "30,a,2"], "--known-distance must be MM,COLUMN,ROW"),
        (["--known-distance", "0,80,60"], "known_distance"),
        (["--known-distance", "30,160,60"], "the pixel at column 160, row 60 is outside the picture of 160x"),
        (["--known-diameter", "9,1,2"], "--known-diameter must be MM,COLUMN1,ROW1,COLUMN2,ROW2"),
        (["--known-diameter", "9,80,60,81,60"], "are 1 px apart in the depth map, too near to measure by"),
        (
            ["--known-distance", "30,80,60", "--median-distance", "30"],
            "--median-distance and --known-distance exclude each other; give one",
        ),
        (
            ["--known-distance", "30,80,60", "--known-diameter", "9,70,60,90,60"],
            "--known-distance and --known-diameter exclude each other; give one",
        ),
        (["--highlights", "paint"], "argument --highlights: invalid choice: 'paint'"),
        (["--contours", "maybe"], "argument --contours: invalid choice: 'maybe'"),
        (["--width", "0"], "width must be a whole number of at least 1, got 0"),
        (["--width", "161"], "cannot shrink 160x120 px to 161x121 px"),
        (["--smooth", "-1"], "smooth must be finite and at least 0"),
        (["--smooth", "1e9"], "smooth must not exceed the frame's width of 160 px"),
        (["--bogus"], "unrecognized arguments: --bogus"),
    ],
)
def test_a_bad_option(unsolved, options, message):
    assert message in unsolved(*options)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("frame", np.full((120, 160), 0.5), "is constant"),
        ("frame", np.zeros((120, 160, 3)), "is all dark"),
        ("frame", np.ones((120, 160)), "is fully saturated"),
        ("frame", np.full((60, 80), 0.5), "frame.png is 80x60 px, but the calibration is for 160x120 px"),
        ("frame", b"hello", "frame.png: not a picture that can be read"),
        ("frame", b"", "frame.png: not a picture that can be read"),
        ("frame", None, "frame.png: there is no such file"),
        ("frame", "folder", "frame.png: cannot be read: Is a directory"),
        ("mask", np.zeros((120, 160)), "mask.png is empty"),
        ("mask", np.ones((60, 80)), "mask.png is 80x60 px, the frame 160x120 px"),
        ("mask", None, "mask.png: there is no such file"),
    ],
)
def test_a_bad_frame_or_mask(tmp_path, unsolved, name, content, message):
    path = tmp_path / f"{name}.png"
    if isinstance(content, np.ndarray):
        write_image(path, content)
    elif isinstance(content, bytes):
        path.write_bytes(content)
    elif content:
        path.mkdir()
    assert message in (unsolved(frame=path) if name == "frame" else unsolved("--mask", path))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"fx"', '"fxx"', "camera.fx: missing"),
        ('"width": 160', '"width": -160', "camera.width: expected a positive number"),
        ('"endolab": 1', '"endolab": 3', "endolab: expected version 1, found 3"),
        ('"gamma": 2.2', '"gamma": NaN', "photometry.gamma: expected a finite number, found NaN"),
        ('"gamma": 2.2', '"gamma": 2.2, "bias": 0', "photometry.bias: unknown key"),
        ('"pinhole"', '"pinhead"', "camera.model: expected one of"),
        ('"width": 160', '"width": 161', "but the calibration is for 161x120 px"),
        ("{", "", "not valid JSON"),
        (None, None, "bad.json: there is no such calibration file"),
    ],
)
def test_a_bad_calibration(sim, tmp_path, unsolved, old, new, message):
    text = (sim / "endoscope.json").read_text(encoding="utf-8")
    path = tmp_path / "bad.json"
    if old is not None:
        assert old in text
        path.write_text(text.replace(old, new, 1), encoding="utf-8")
    said = unsolved(calibration=path)
    assert message in said
    assert "bad.json" in said or "but the calibration" in said


@pytest.mark.parametrize("out", ["file", "file/out"])
@pytest.mark.parametrize("command", ["reconstruct", "simulate"])
def test_an_output_folder_in_the_way_of_a_file(sim, tmp_path, refused, command, out):
    (tmp_path / "file").write_text("mine")
    inputs = {"reconstruct": [sim / "frame.png", "--calibration", sim / "endoscope.json"]}
    inputs["simulate"] = ["plane", "--width", 32]
    assert "cannot write to the folder" in refused(command, *inputs[command], "--out", tmp_path / out)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("simulate pig", "unknown scene 'pig'; choose plane, curved, tube, colon or sheet"),
        ("simulate coln", "colon or sheet; did you mean colon?"),
        ("simulate plane --width 8", "--width must be at least 16 px, got 8"),
        ("simulate plane --noise -1", "noise must be finite and at least 0"),
        ("simulate plane --fog nan", "fog must be finite and at least 0"),
        ("simulate plane --calibration papr", "simcol3d or a JSON file; did you mean paper?"),
        ("simulate plane --bits 12", "argument --bits: invalid choice"),
        ("simulate", "the following arguments are required: SCENE"),
        ("frobnicate", "invalid choice: 'frobnicate'"),
        ("", "the following arguments are required: COMMAND"),
        (
            "simulate plane --seed x",
            "argument --seed: expected a whole number, found 'x'; see endolab simulate",
        ),
        (
            "reconstruct a.png b.png --calibration paper",
            "reconstruct takes one picture, one folder of a video's",
        ),
        ("reconstruct", "the following arguments are required: FRAME, --calibration, --out"),
        ("sweep", "the following arguments are required: FRAME, --calibration"),
        ("evaluate depth.npz", "the following arguments are required: TRUTH"),
    ],
)
def test_a_bad_simulation_and_a_command_that_is_not_one(tmp_path, refused, words, message):
    out = ("--out", tmp_path / "new") if words.startswith(("simulate", "reconstruct a")) else ()
    assert message in refused(*words.split(), *out)


def npz(save=np.savez, *arrays, **named):
    save(stream := io.BytesIO(), *arrays, **named)
    return stream.getvalue()


FLAT = np.full((120, 160), 50.0)
BAD_DEPTH = {
    "text": (b"hello", "not a depth.npz"),
    "empty": (b"", "not a depth.npz"),
    "cut off": (npz(distance=FLAT, z=FLAT)[:5000], "not a depth.npz"),
    "flipped": (npz(z=FLAT, distance=FLAT).replace(bytes(FLAT[0]), bytes(FLAT[0] + 1), 1), "not a depth.npz"),
    "npy": (npz(np.save, FLAT), "not a depth.npz"),
    "pickle": (npz(distance=np.array([None]), z=np.array([None])), "not a depth.npz"),
    "no z": (npz(distance=FLAT), "z is missing"),
    "words": (npz(distance=np.array([["a"]]), z=np.array([["b"]])), "depth.npz"),
    "two sizes": (npz(distance=FLAT, z=FLAT[:60]), "depth.npz"),
    "one row": (npz(distance=FLAT[0], z=FLAT[0]), "depth"),
    "other size": (npz(distance=FLAT[:60], z=FLAT[:60]), "truth has shape"),
    "odd normals": (npz(distance=FLAT, z=FLAT, normals=np.ones((2, 2, 3))), "normals"),
    "unknown": (npz(distance=FLAT * np.nan, z=FLAT * np.nan), "no pixel has both an estimate and a true"),
}


@pytest.mark.parametrize(("content", "message"), BAD_DEPTH.values(), ids=BAD_DEPTH.keys())
def test_a_bad_depth_map(sim, tmp_path, refused, content, message):
    (tmp_path / "depth.npz").write_bytes(content)
    assert message in refused("evaluate", tmp_path / "depth.npz", sim / "truth.npz")


@pytest.mark.parametrize(
    ("truth", "options", "message"),
    [
        ("none.npz", [], "none.npz: there is no such file"),
        ("frame.png", [], "frame.png: expected truth.npz, C3VD's"),
        ("0001_depth.png", [], "the depth map is 160x120 px, the truth 4x2 px, of other proportions"),
        ("truth.npz", ["--scale", "none"], "is in relative units: compare it with --scale median"),
        ("truth.npz", ["--scale", "mean"], "argument --scale: invalid choice: 'mean'"),
        ("truth.npz", ["--max-angle", "0"], "--max-angle must be above 0 and at most 180, got 0"),
        ("truth.npz", ["--max-angle", "1e-3"], "no pixel has both"),
    ],
)
def test_a_bad_comparison(work, tmp_path, refused, truth, options, message):
    write_image(tmp_path / "0001_depth.png", np.full((2, 4), 0.5), 16)
    path = work / "sim" / truth if truth in ("truth.npz", "frame.png") else tmp_path / truth
    assert message in refused("evaluate", work / "rel/depth.npz", path, *options)


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (KeyboardInterrupt(), 130, "endolab: interrupted; nothing was written\n"),
        (OSError("cannot write depth.npz: No space left"), 2, "endolab: cannot write depth.npz: No space"),
    ],
)
def test_a_failure_at_the_end_leaves_nothing(solve, tmp_path, monkeypatch, capsys, error, code, message):
    from endolab.reports import result as files

    def fail(*arguments):
        raise error

    monkeypatch.setattr(files, "save_depth", fail)
    assert solve("--out", tmp_path / "new/out") == code
    assert capsys.readouterr().err.startswith(message)
    assert names(tmp_path) == []


@pytest.mark.parametrize(
    "command", ["", "reconstruct", "sweep", "simulate", "evaluate", "tune", "lab", "target", "calibrate"]
)
def test_help(capsys, command):
    assert call(*command.split(), "--help") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert said.startswith("usage: endolab")
    if command == "reconstruct":
        named = said.split("--solver NAME ")[1].split("--xi ξ")[0]
        assert all(name in named for name in SOLVERS)
        assert f"{DEFAULT_SOLVER} (default)" in said


def test_a_frame_too_large_for_the_memory_is_refused(unsolved, monkeypatch):
    monkeypatch.setattr(posing, "BYTES_PER_PIXEL", 10**12)
    assert "needs about 19200000.4 GB of memory" in unsolved()


def test_what_a_large_frame_takes_is_said_before_it_is_begun(solve, tmp_path, capsys, monkeypatch):
    options = ("--solver", "facing", "--out", tmp_path / "out")
    assert solve(*options) == 0
    assert "GB" not in capsys.readouterr().out
    monkeypatch.setattr(cli_reconstruct, "LARGE", 10_000)
    monkeypatch.setattr(cli_reconstruct, "ENOUGH", 80)
    assert solve(*options) == 0
    first = capsys.readouterr().out.splitlines()[0]
    assert first == "160x120 px: about 0.077 s and 0.41 GB; --width 80 takes about 0.02 s"
    assert solve(*options, "--width", "80") == 0
    assert "GB" not in capsys.readouterr().out


def test_others_warnings_are_not_shown_and_its_own_are(tmp_path):
    script = (
        "import sys, warnings; from endolab.cli import main as cli; sys.argv[1:] = ['--version']\n"
        "try: cli.main()\nexcept SystemExit: pass\n"
        "for name in ('other', 'endolabour', 'endolab.model'):\n"
        "    warnings.warn_explicit(f'from {name}', UserWarning, 'a.py', 1, module=name)\n"
    )
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    environment.pop("PYTHONWARNINGS", None)
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=60)
    assert done.stderr == "a.py:1: UserWarning: from endolab.model\n"


def test_it_runs_as_a_module(tmp_path):
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-X", "importtime", "-m", "endolab", "--help"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0
    for word in ("reconstruct", "sweep", "simulate", "evaluate"):
        assert word in done.stdout
    loaded = [line.rpartition("|") for line in done.stderr.splitlines()]
    assert all(line.startswith("import time:") for line, _, _ in loaded)  # and nothing else on stderr
    slow = {"numpy", "cv2", "scipy", "numba", "matplotlib", "rerun", "open3d", "jupyterlab"}
    assert not slow & {name.strip() for _, _, name in loaded}


def test_a_refusal_is_one_line_also_from_what_is_not_python(sim, tmp_path):
    """Libraries that write to stderr by themselves are seen only from outside the process."""
    command = [sys.executable, "-m", "endolab", "reconstruct", str(sim / "frame.png"), "--solver", "none"]
    command += ["--calibration", str(sim / "endoscope.json"), "--out", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert (
        done.stderr
        == "endolab: unknown solver 'none'; choose facing, fast_marching, gauss_newton or primal_dual\n"
    )
    assert not (tmp_path / "out").exists()
