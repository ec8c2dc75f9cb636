"""Sweeps: one tidy table, on one core or more, gone on with after a break; no worker is left behind."""

import csv
import math
import os
import subprocess
import sys
import time
from dataclasses import replace

import joblib
import numpy as np
import psutil
import pytest

import endolab as el
from endolab import datasets
from endolab.batch.sweep import KEY, SWEEP_COLUMNS, read_table, sweep

BASE = datasets.load_calibration("simple", 64)
GREEN = replace(BASE.photometry.channel("green"), gain=900.0)
CALIBRATION = el.Calibration(BASE.camera, GREEN)
SETTINGS = {"lam": (0.1, 1.0), "xi": ("1/d", "d"), "regulariser": ("first", "second")}
PATIENCE = 60  # seconds after which a test gives up
KILLED = """
import sys
import numpy as np
import endolab as el

calibration = el.load_calibration("paper", width=320)
scene = el.render(el.SCENES["colon"], calibration.camera, calibration.photometry)
known = el.Calibration(scene.camera, scene.photometry)
frames = [el.Frame(scene.image, scene.mask, str(number)) for number in range(2)]
el.sweep(frames, known, lam=np.geomspace(0.01, 100, 100), table=sys.argv[1], n_jobs=2)
"""


@pytest.fixture(scope="module")
def seen():
    return {
        name: el.render(el.SCENES[name], BASE.camera, GREEN, noise=1.0)
        for name in ("plane", "tube")
    }


@pytest.fixture
def frames(seen):
    return [el.Frame(one.image, one.mask, name) for name, one in seen.items()]


class Made:
    """Notes which rows are made, and may stop after so many."""

    def __init__(self, most=math.inf, failure=KeyboardInterrupt):
        self.rows = []
        self.most = most
        self.failure = failure

    def __call__(self, done, total, row):
        self.rows.append((row["frame"], row["lam"]))
        if done == self.most:
            raise self.failure


def test_each_with_each_is_one_row(frames, seen, tmp_path):
    truth = [(one.distance, one.normals) for one in seen.values()]
    path = tmp_path / "t.csv"
    rows = sweep(frames, CALIBRATION, **SETTINGS, truth=truth, table=path)
    assert len(rows) == 16
    with open(path, newline="", encoding="utf-8") as stream:
        stored = list(csv.DictReader(stream))
    assert tuple(stored[0]) == SWEEP_COLUMNS
    assert len({tuple(row[name] for name in KEY) for row in stored}) == 16
    assert [float(row["energy"]) for row in stored] == [row["energy"] for row in rows]
    for row in rows:
        assert row["energy"] == pytest.approx(row["data"] + row["regulariser_energy"])
        if row["regulariser"] == "second":  # the first order wants a smaller λ
            assert 0 < row["mean_percent"] < 10
            assert 0 < row["mean_degrees"] < 20
        assert row["error"] == ""
        assert row["seconds"] > 0
    one = el.reconstruct(frames[1], CALIBRATION, lam=0.1, xi="d", regulariser="first")
    same = [
        row
        for row in rows
        if (row["frame"], row["lam"], row["xi"]) == ("tube", 0.1, "d")
    ]
    assert same[0]["energy"] == pytest.approx(one.energy, rel=1e-9)


def test_a_second_call_makes_only_what_is_not_there(frames, seen, tmp_path):
    path = tmp_path / "t.csv"
    made = Made()
    first = sweep(frames[:1], CALIBRATION, lam=(0.1, 1), table=path)
    again = sweep(frames, CALIBRATION, lam=(0.1, 1, 10), table=path, progress=made)
    assert made.rows == [("plane", 10.0)] + [("tube", x) for x in (0.1, 1, 10)]
    assert again[:2] == [pytest.approx(row, nan_ok=True) for row in first]
    (row,) = sweep(frames[:1], CALIBRATION, lam=(0.1,), width=48, table=path)
    assert "width=48" in row["options"]
    darker = replace(CALIBRATION, photometry=replace(GREEN, brdf=el.Lambertian(0.2)))
    sweep(frames[:1], darker, lam=(0.1,), table=path)
    assert len(read_table(path)) == 8
    how = {"lam": (0.1,), "table": path, "truth": [seen["plane"].distance]}
    for _ in range(2):  # of what was compared with no truth
        (row,) = sweep(frames[:1], darker, **how, progress=made)
        assert row["mean_percent"] > 0
        assert len(made.rows) == 5


def test_an_interrupted_sweep_goes_on_to_the_same_table(frames, tmp_path):
    def written(path):
        with open(path, newline="", encoding="utf-8") as stream:
            return [row | {"seconds": ""} for row in csv.DictReader(stream)]

    how = {"lam": (0.1, 1), "max_iterations": 3}
    sweep(frames, CALIBRATION, table=tmp_path / "whole.csv", **how)
    with pytest.raises(KeyboardInterrupt, match="3 of 4 rows"):
        sweep(frames, CALIBRATION, table=tmp_path / "t.csv", progress=Made(3), **how)
    assert len(read_table(tmp_path / "t.csv")) == 3
    sweep(frames, CALIBRATION, table=tmp_path / "t.csv", **how)
    assert written(tmp_path / "t.csv") == written(tmp_path / "whole.csv")


def test_an_interrupt_is_all_that_is_heard_of_tasks_under_way(frames, tmp_path):
    """Joblib warns of what was in vain, and here warnings are errors."""
    weights = np.geomspace(0.1, 1, 8)
    how = {"table": tmp_path / "t.csv", "progress": Made(1), "n_jobs": 2}
    with pytest.raises(KeyboardInterrupt, match="in the table"):
        sweep(frames, CALIBRATION, lam=weights, **how)


HEAD = ",".join(SWEEP_COLUMNS) + "\n"


@pytest.mark.parametrize(
    "content", ["a,b\n1,2\n", "\xff", HEAD + "x,y\n", HEAD + '"' + "x" * 200_000]
)
def test_another_table_is_left_alone(frames, tmp_path, content):
    (tmp_path / "t.csv").write_text(content)
    with pytest.raises(ValueError, match=r"t\.csv"):
        sweep(frames, CALIBRATION, table=tmp_path / "t.csv")
    assert (tmp_path / "t.csv").read_text() == content


def test_a_frame_that_cannot_be_used_is_a_row_with_a_sentence(frames, tmp_path):
    path = tmp_path / "t.csv"
    made = Made()
    dark = el.Frame(np.zeros((48, 64)), np.ones((48, 64), bool), "dark")
    rows = sweep([dark, frames[0], tmp_path / "none.png"], CALIBRATION, table=path)
    assert [row["status"] for row in rows] == ["", "CONVERGED", ""]
    assert "dark" in rows[0]["error"]
    assert "none.png" in rows[2]["error"]
    sweep([dark, frames[0]], CALIBRATION, table=path, progress=made)
    assert made.rows == [("dark", 1.0)]  # tried again


@pytest.mark.parametrize("backend", ["loky", "threading"])
def test_workers_find_the_same(frames, tmp_path, backend):
    alone = sweep(frames, CALIBRATION, table=tmp_path / "1.csv")
    with joblib.parallel_config(backend, n_jobs=2):
        together = sweep(frames, CALIBRATION, table=tmp_path / "2.csv")
    for a, b in zip(alone, together, strict=True):
        assert a["frame"] == b["frame"]
        assert a["energy"] == pytest.approx(b["energy"], rel=1e-6)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"lam": ()}, "lam"),
        ({"lam": [math.nan]}, "lam"),
        ({"xi": ["w"]}, "xi"),
        ({"solver": "smoke"}, "solver"),
        ({"truth": []}, "truth"),
        ({"frames": ["a/x.png", "b/x.png"]}, r"x\.png"),
    ],
)
def test_a_sweep_that_cannot_be(frames, tmp_path, change, named):
    options = {"frames": frames, "table": tmp_path / "t.csv"} | change
    with pytest.raises(ValueError, match=named):
        sweep(options.pop("frames"), CALIBRATION, **options)
    assert os.listdir(tmp_path) == []


# Workers --------------------------------------------------------------------------------
def until(condition):
    end = time.monotonic() + PATIENCE
    while not condition() and time.monotonic() < end:
        time.sleep(0.05)
    return condition()


def test_workers_end_with_a_sweep_that_is_killed(tmp_path):
    table = tmp_path / "t.csv"
    program = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(table)], stderr=subprocess.PIPE
    )
    running = psutil.Process(program.pid)

    def is_under_way():
        rows = table.read_text(encoding="utf-8").count("\n") if table.exists() else 0
        return program.poll() is not None or (len(running.children()) >= 2 and rows > 2)

    until(is_under_way)
    assert program.poll() is None, program.communicate()[1].decode()
    workers = running.children(recursive=True)
    program.kill()
    program.communicate()  # to the end: workers have it too
    gone, alive = psutil.wait_procs(workers, PATIENCE)
    for worker in alive:
        worker.kill()
    assert (len(gone), alive) == (len(workers), [])
    kept = (f"joblib_memmapping_folder_{program.pid}_", f"sem.loky-{program.pid}-")
    assert until(
        lambda: not [name for name in os.listdir("/dev/shm") if name.startswith(kept)]
    )
    assert [path.name for path in tmp_path.iterdir()] == ["t.csv"]


def test_a_worker_that_is_killed_is_one_sentence_and_the_next_sweep_goes_on(
    frames, tmp_path
):
    how = {"lam": np.geomspace(0.01, 100, 12), "table": tmp_path / "t.csv", "n_jobs": 2}

    def kill(done, total, row):
        children = psutil.Process().children(recursive=True) if done == 2 else []
        for worker in children:
            if "popen_loky" in " ".join(worker.cmdline()):
                worker.kill()

    with pytest.raises(OSError, match=r"worker.*\d+ of 12 rows"):
        sweep(frames[:1], CALIBRATION, **how, progress=kill)
    assert len(read_table(tmp_path / "t.csv")) >= 2
    assert len(sweep(frames[:1], CALIBRATION, **how)) == 12
