"""A sweep that is killed leaves no worker, no memory and no file behind; a killed worker is said."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

import endolab as el
from endolab.batch import sweep as sweeps
from endolab.batch.sweep import read_table

SWEEP = """
import sys
from dataclasses import replace
import numpy as np
import endolab as el

calibration = el.load_calibration("paper", width=320)
scene = el.render(el.SCENES["colon"], calibration.camera, calibration.photometry)
known = el.Calibration(scene.camera, scene.photometry)
frames = [el.Frame(scene.image, scene.mask, str(number)) for number in range(2)]
el.sweep(frames, known, lam=np.geomspace(0.01, 100, 100), table=sys.argv[1], n_jobs=2, backend="loky")
"""
PATIENCE = 60  # seconds after which a test gives up


def until(condition):
    end = time.monotonic() + PATIENCE
    while not condition() and time.monotonic() < end:
        time.sleep(0.05)
    return condition()


def memories(pid):
    """What a process has in shared memory, where that is a folder."""
    folder = Path("/dev/shm")
    names = [path.name for path in folder.iterdir()] if folder.is_dir() else []
    return [
        name for name in names if name.startswith((f"joblib_memmapping_folder_{pid}_", f"sem.loky-{pid}-"))
    ]


@pytest.mark.parametrize("early", [True, False], ids=["while the workers start", "while they solve"])
def test_workers_end_with_a_sweep_that_is_killed(early, tmp_path):
    table = tmp_path / "t.csv"
    program = subprocess.Popen([sys.executable, "-c", SWEEP, str(table)], stderr=subprocess.PIPE)
    sweep = psutil.Process(program.pid)

    def is_under_way():
        if program.poll() is not None:
            return True
        rows = table.read_text(encoding="utf-8").count("\n") if table.exists() else 0
        return len(sweep.children()) >= 2 and (early or rows > 2)

    until(is_under_way)
    assert program.poll() is None, program.communicate()[1].decode()
    workers = sweep.children(recursive=True)
    assert early or memories(program.pid) or not Path("/dev/shm").is_dir()
    program.kill()
    program.communicate()  # to the end: workers have it too
    gone, alive = psutil.wait_procs(workers, PATIENCE)
    for worker in alive:
        worker.kill()
    assert (len(gone), alive) == (len(workers), [])
    assert until(lambda: not memories(program.pid)), memories(program.pid)
    assert [path.name for path in tmp_path.iterdir()] == ["t.csv"]


@pytest.fixture(scope="module")
def seen():
    calibration = el.load_calibration("simple", width=64)
    scene = el.render(el.SCENES["tube"], calibration.camera, calibration.photometry)
    return [el.Frame(scene.image, scene.mask, "tube")], el.Calibration(scene.camera, scene.photometry)


def workers_of_loky():
    children = psutil.Process().children(recursive=True)
    return [child for child in children if "popen_loky" in " ".join(child.cmdline())]


def test_a_worker_that_is_killed_is_one_sentence_and_the_next_sweep_goes_on(seen, tmp_path):
    how = {"lam": np.geomspace(0.01, 100, 12), "table": tmp_path / "t.csv", "n_jobs": 2, "backend": "loky"}

    def kill(done, total, row):
        if done == 2:
            for worker in workers_of_loky():
                worker.kill()

    with pytest.raises(
        OSError, match=r"a worker was lost.*; \d+ of 12 rows are in the table, the same command"
    ):
        el.sweep(*seen, **how, progress=kill)
    assert len(read_table(tmp_path / "t.csv")) >= 2
    assert len(el.sweep(*seen, **how)) == 12


@pytest.mark.filterwarnings("ignore")  # of Dask's own
def test_other_machines_find_the_same(seen, tmp_path):
    distributed = pytest.importorskip(
        "distributed", reason='Dask is not installed: pip install "distributed"'
    )
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster),
    ):
        far = el.sweep(*seen, lam=(0.1, 1.0), table=tmp_path / "far.csv", backend="dask")
    far += el.sweep(*seen, lam=(10.0,), table=tmp_path / "far.csv", backend="dask")  # with workers of its own
    near = el.sweep(*seen, lam=(0.1, 1.0, 10.0), table=tmp_path / "near.csv", n_jobs=1)
    assert [row["energy"] for row in far] == pytest.approx([row["energy"] for row in near])
    assert {row["error"] for row in far} == {""}


@pytest.mark.filterwarnings("ignore")  # of Dask's own
def test_a_worker_of_dask_that_dies_again_and_again_is_a_sentence(seen, tmp_path, monkeypatch):
    distributed = pytest.importorskip(
        "distributed", reason='Dask is not installed: pip install "distributed"'
    )
    dask = pytest.importorskip("dask")
    monkeypatch.setattr(sweeps, "_solved", dies)
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster),
        pytest.raises(OSError, match=r"a worker was lost.*; 0 of 2 rows are in the table, the same command"),
    ):
        el.sweep(*seen, lam=(0.1, 1.0), table=tmp_path / "far.csv", backend="dask")


def dies(*_):
    os._exit(1)
