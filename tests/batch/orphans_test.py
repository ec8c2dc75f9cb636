"""A sweep that is killed leaves no worker, no memory and no file behind."""

import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

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
