"""The command line: what it writes and prints, and how it ends."""

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import termios

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import endolab as el
from endolab.cli import main as cli
from endolab.io.images import read_image, write_image
from endolab.io.settings import SolvingSettings, write_settings

OUTPUTS = ["cloud.ply", "depth.npz", "endoscope.json", "overview.png"]
OUTPUTS += ["recording.rrd", "report.json"]


def call(words):
    """The exit code of a command."""
    return cli.main(words.split())


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


# What it does ---------------------------------------------------------------------------
def test_simulate_writes_a_frame_and_its_truth(sim):
    assert names(sim) == ["endoscope.json", "frame.png", "report.json", "truth.npz"]
    truth = maps(sim / "truth.npz")
    assert read_image(sim / "frame.png").shape == truth["normals"].shape
    rays = el.load_calibration(sim / "endoscope.json").camera.field.rays
    exact = el.SCENES["curved"].distance(rays)
    assert_allclose(truth["distance"], exact, rtol=1e-6)


def test_reconstruct_writes_a_whole_folder(work):
    out = work / "out"
    assert names(out) == OUTPUTS
    depth = maps(out / "depth.npz")
    mask = depth["mask"]
    for name in ("distance", "z", "normals"):
        assert np.all(np.isfinite(depth[name][mask]))
        assert np.all(np.isnan(depth[name][~mask]))
    content = report(out)
    assert content["settings"]["channel"] == "separated"
    assert content["pixels"] == mask.sum()
    assert f"element vertex {mask.sum()}\n".encode() in (out / "cloud.ply").read_bytes()


def test_a_mesh_and_a_preparation_come_if_they_are_asked_for_and_change_no_bit(
    work, tmp_path, rng
):
    """Of a lumen where noise says more than the wall, too, which a preparation cut away once."""
    picture = read_image(work / "sim/frame.png")
    picture[40:80, 60:100] = 10 / 255
    noisy = picture + rng.normal(scale=3 / 255, size=picture.shape)
    write_image(tmp_path / "dark.png", np.clip(noisy, 0, 1))
    known = f"--calibration {work}/sim/endoscope.json --solver facing"
    for out in ("plain", "more --mesh --prepare"):
        assert (
            call(f"reconstruct {tmp_path}/dark.png {known} --out {tmp_path}/{out}") == 0
        )
    assert names(tmp_path / "more") == sorted([*OUTPUTS, "mesh.ply", "preparation.png"])
    plain, more = (maps(tmp_path / out / "depth.npz") for out in ("plain", "more"))
    assert_array_equal(more["distance"], plain["distance"])


def test_snapshots_come_and_a_length_is_asked_for(solve, capsys):
    assert solve("--width 80 --solver fast_marching --out m", "unknown.json") == 0
    out, error = capsys.readouterr()
    assert error == ""
    for word in ("CONVERGED", "12 iterations", "--median-distance", "written to m"):
        assert word in out


def test_trust_comes_if_it_is_asked_for(solve, sim, tmp_path, capsys):
    assert solve("--width 80 --out out --uncertainty --mesh") == 0
    assert set(names(tmp_path / "out")) > {"mesh.ply", "mesh_uncertainty.ply"}
    depth = maps(tmp_path / "out/depth.npz")
    assert (depth["sigma"][depth["mask"]] > 0).all()
    assert report(tmp_path / "out")["uncertainty"]["status"] == "CONVERGED"
    capsys.readouterr()
    assert call(f"evaluate out/depth.npz {sim}/truth.npz --json") == 0
    assert 0 < json.loads(capsys.readouterr().out)["coverage"]["within_one"] <= 100


REPORTS = "endolab.workbench.reports.result"
RECORDING = "endolab.workbench.recording"
# Where drawing fails, by what it is of.
DRAWING = {
    f"{REPORTS}.overview": "overview.png",
    f"{REPORTS}.prepare_figure": "preparation.png",
    f"{RECORDING}.recorder.paint": "recording.rrd",  # at the first iterate
    f"{RECORDING}.recorder._settings": "recording.rrd",  # at the end
    f"{RECORDING}.stream.layout": "recording.rrd",
}


def fail_with(error):
    def fail(*given, **options):
        raise error

    return fail


@pytest.mark.parametrize("place", DRAWING)
def test_what_cannot_be_drawn_costs_no_answer(
    place, solve, tmp_path, caplog, monkeypatch
):
    monkeypatch.setattr(place, fail_with(ValueError("no such\ncolour")))
    assert solve("--solver facing --out out --prepare") == 0
    lost = DRAWING[place]
    assert set(names(tmp_path / "out")) == {*OUTPUTS, "preparation.png"} - {lost}
    sentence = report(tmp_path / "out")["warnings"][-1]
    assert lost in sentence
    assert "colour" in sentence
    assert sentence.isprintable()
    assert [one.getMessage() for one in caplog.records] == [sentence]


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), 2),
        (MemoryError(), 2),
        (KeyboardInterrupt(), cli.INTERRUPTED),
    ],
)
@pytest.mark.parametrize("place", [*DRAWING][::3])
def test_a_full_disk_no_memory_and_an_interrupt_while_drawing_leave_nothing(
    place, error, status, solve, tmp_path, monkeypatch
):
    monkeypatch.setattr(place, fail_with(error))
    assert solve("--solver facing --out out --prepare") == status
    assert names(tmp_path) == []


def test_options_arrive(solve, tmp_path):
    write_image(tmp_path / "mask.png", np.arange(160) < np.full((120, 1), 80))
    options = "--mask mask.png --regulariser first --width 80 --median-distance 33"
    assert solve(f"--out o {options} --contours no --albedo 0.4", "unknown.json") == 0
    content = report(tmp_path / "o")
    assert (content["settings"]["regulariser"], content["metric"]) == ("first", True)
    assert content["field"]["px"] == [80, 120]
    depth = maps(tmp_path / "o/depth.npz")
    assert depth["distance"].shape == (60, 80)
    assert depth["mask"][:, :39].mean() > 0.9
    assert not depth["mask"][:, 41:].any()
    assert np.nanmedian(depth["distance"]) == pytest.approx(33, rel=1e-4)


def test_a_settings_file_gives_what_options_give_and_options_win(solve, tmp_path):
    light = {"k": 2.0, "albedo": 0.5}
    options = {"lam": 0.1 + 0.2, "xi": "d", "channel": "green", "width": 48}
    options |= {"contours": False, "known_distance": (30.0, 32.5, 20.0)}
    write_settings(SolvingSettings(options, light), tmp_path / "s.json")
    write_settings(SolvingSettings({}, light), tmp_path / "light.json")
    typed = f"--lam {0.1 + 0.2} --xi d --channel green --width 48 --contours no"
    typed += " --known-distance 30,32.5,20 --settings light.json"
    assert solve("--settings s.json --out file") == solve(f"{typed} --out typed") == 0
    win = "--lam 1 --settings s.json --median-distance 20 --out both"
    assert solve(win) == 0
    runs = [tmp_path / name for name in ("file", "typed", "both")]
    one, two, both = [report(run)["settings"] for run in runs]
    assert one == two
    assert (both["lam"], both["xi"], both["known_distance"]) == (1, "d", None)
    found = [maps(run / "depth.npz")["distance"] for run in runs]
    assert_array_equal(found[0], found[1])
    assert np.nanmedian(found[2]) == pytest.approx(20, rel=1e-6)


def test_the_same_command_with_a_results_own_endoscope_gives_its_answer(
    solve, tmp_path
):
    for out, known in (
        ("one", "sim/endoscope.json"),
        ("two", tmp_path / "one/endoscope.json"),
    ):
        assert solve(f"--crop 40,30,80,60 --solver facing --out {out}", known) == 0
    one, two = (maps(tmp_path / out / "depth.npz")["z"] for out in ("one", "two"))
    assert_array_equal(one, two)


@pytest.fixture
def film(work, tmp_path, monkeypatch):
    """Words that name the calibration; beside the folder `film`, in which one of three pictures is broken."""
    monkeypatch.chdir(tmp_path)
    for number in range(3):
        (tmp_path / "film").mkdir(exist_ok=True)
        shutil.copy(work / "sim/frame.png", tmp_path / f"film/{number}.png")
    (tmp_path / "film/2.png").write_bytes(b"broken")
    return f"--calibration {work}/unknown.json --width 48 --solver facing"


def test_a_video_goes_on_and_tells_what_became_of_it(film, tmp_path, capsys):
    words = f"reconstruct film --out o {film}"
    assert call(f"{words} --every 2 --limit 1") == call(words) == 0
    output, error = capsys.readouterr()
    assert error == ""
    for word in (
        "2 of 3",
        "earlier call: 1",
        "not done: film/2.png",
        "relative",
        ".rrd",
    ):
        assert word in output
    assert len((tmp_path / "o/frames.csv").read_text().splitlines()) == 4


def test_a_sweep_tells_what_became_of_it(film, tmp_path, capsys):
    assert call(f"sweep film/0.png none.png --lam 0.1,1 --xi d {film}") == 0
    output = capsys.readouterr().out
    assert ("2 of 4 rows" in output, "none.png" in output) == (True, True)
    assert len((tmp_path / "sweep.csv").read_text().splitlines()) == 5


def test_evaluate_compares_with_the_truth(work, capsys):
    words = f"evaluate {work}/rel/depth.npz {work}/sim/truth.npz"
    assert call(f"{words} --json") == 0
    errors = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)
    assert (errors["scale"] > 10, errors["mean_percent"] < 0.6) == (True, True)
    assert call(f"{words} --max-angle 20") == 0
    assert "%" in capsys.readouterr().out


def test_evaluate_compares_folders(sim, tmp_path, capsys):
    """A row each, their mean and median; what has no partner is said."""
    true = maps(sim / "truth.npz")["z"]
    factors = {"a/1": 1.1, "a/2": 1.2, "a/4": 1.6, "b/1": 1, "b/2": 1}
    for name, factor in factors.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        np.save(tmp_path / f"{name}.npy", factor * true)
    assert call(f"evaluate {tmp_path}/a {tmp_path}/b --unit 1") == 0
    _, *rows, alone = capsys.readouterr().out.splitlines()
    percent = [float(row.split()[1]) for row in rows]
    assert percent == pytest.approx([10, 20, 15, 15], abs=1e-3)
    assert "4.npy" in alone


# As a process of its own ----------------------------------------------------------------
@pytest.fixture
def process(tmp_path):
    """Start the command line in a process of its own."""

    def start(words, stderr=subprocess.PIPE, **environment):
        return subprocess.Popen(
            [sys.executable, "-m", "endolab", *words.split()],
            cwd=tmp_path,
            env=os.environ | environment,
            stdout=subprocess.PIPE,
            stderr=stderr,
        )

    return start


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_told_to_end_it_writes_the_best_so_far(tmp_path, process, number):
    words = f"simulate colon --calibration simple --width 640 --out {tmp_path}/s"
    assert call(words) == 0
    terminal, end = os.openpty()
    termios.tcsetwinsize(terminal, (24, 80))
    words = "reconstruct s/frame.png --calibration s/endoscope.json --out o"
    words += " --solver primal_dual --max-iterations 1000000"
    with process(words, stderr=end) as running:
        os.close(end)
        content = b""
        while content.count(b"energy") < 5:  # on the bar
            content += os.read(terminal, 1000)
        running.send_signal(number)
        assert running.wait(60) == 0
    assert report(tmp_path / "o")["status"] == "STOPPED"
    assert names(tmp_path / "o") == OUTPUTS


def test_nobody_needs_to_read_what_is_printed(work, process):
    words = f"evaluate {work}/out/depth.npz {work}/out/depth.npz"
    with process(words, PYTHONUNBUFFERED="1") as running:
        running.stdout.close()  # as after `| head -1`
        assert running.stderr.read() == b""


def test_help_is_quick_and_loads_nothing_large(process):
    with process("--help", PYTHONPROFILEIMPORTTIME="1") as running:
        out, error = running.communicate(timeout=60)
    for word in (b"reconstruct", b"sweep", b"simulate", b"evaluate"):
        assert word in out
    slow = {"cv2", "scipy", "numba", "matplotlib", "rerun", "open3d", "jupyterlab"}
    slow |= {"numpy", "ipywidgets"}
    loaded = {line.rpartition("|")[2].strip() for line in error.decode().splitlines()}
    assert not slow & loaded
