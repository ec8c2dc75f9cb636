"""Commands that are killed, or find the disk full: what they leave is whole, and no process is left."""

import contextlib
import os
import signal
import subprocess
import sys
import time

import numpy as np
import psutil
import pytest

from tests.hostile.conftest import EXAMPLES, run, sentences, whole

KNOWN = "--calibration endoscope.json"
RESULT = {"cloud.ply", "depth.npz", "endoscope.json", "overview.png", "recording.rrd"}
SIMULATED = {"endoscope.json", "frame.png", "truth.npz"}
# Of each command: its words, what it writes, and the files that come together or not at all.
COMMANDS = {
    "reconstruct": (
        f"reconstruct frame.png {KNOWN} --solver primal_dual",
        "out",
        RESULT,
    ),
    "video": (f"reconstruct pictures {KNOWN}", "out", None),
    "calibrate": ("calibrate sheet --target vicalib_small", "out.json", None),
    "simulate": ("simulate colon --width 320", "out", SIMULATED),
    "simulate sheet": (
        "simulate sheet --width 160 --frames 12 --video",
        "out",
        {"sheet.mkv", "truth.json"},
    ),
}
LAMS = ",".join(f"{0.01 * number:g}" for number in range(1, 100))
SWEEP = (f"sweep pictures/0.png {KNOWN} --lam {LAMS} --jobs 2", "out.csv", None)
KILLED = COMMANDS | {"sweep": SWEEP}
SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGKILL)
TIMES = max(EXAMPLES // 100, 1)  # that each command is killed
PATIENCE = 5  # s until every process that a killed command started is gone


def check(folder, together):
    """All that is there is whole, and complete if it must be."""
    found = [path for path in folder.rglob("*") if path.is_file()]
    found = [path for path in found if "/." not in str(path)]
    assert [path.name for path in found if not whole(path)] == []
    names = {path.name for path in found} - {"report.json"}
    assert together is None or names in (set(), together)


def left(session):
    """The processes of a session that still live."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, ProcessLookupError):
            if os.getsid(process.pid) == session and process.status() != "zombie":
                found.append(process.name())
    return found


@pytest.mark.parametrize("name", KILLED)
@pytest.mark.parametrize("seed", range(TIMES))
def test_a_killed_command_leaves_what_is_whole_and_no_process(
    name, seed, given, tmp_path
):
    words, out, together = KILLED[name]
    number = SIGNALS[(seed + list(KILLED).index(name)) % len(SIGNALS)]
    words = [*words.split(), "--out", tmp_path / out]
    process = subprocess.Popen(
        [sys.executable, "-m", "endolab", *words],
        cwd=given,
        env=os.environ | {"ENDOLAB_THREADS": "1"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
        text=True,
    )
    while process.poll() is None and not any(tmp_path.iterdir()):
        time.sleep(0.01)  # until it has begun
    time.sleep(np.random.default_rng(seed).uniform(0, 0.8))
    with contextlib.suppress(ProcessLookupError):  # as a terminal does: to all of them
        kill = os.killpg if number is signal.SIGINT else os.kill
        kill(process.pid, number)
    _, output = process.communicate(timeout=30)
    assert "Traceback" not in output
    if number is not signal.SIGKILL:
        assert len(sentences(output)) <= 1
    until = time.monotonic() + PATIENCE
    while left(process.pid) and time.monotonic() < until:
        time.sleep(0.05)
    assert left(process.pid) == []
    check(tmp_path, together)
    if number is not signal.SIGKILL:
        assert not list(tmp_path.rglob(".endolab*"))


@pytest.fixture(params=[0, 60])
def disk(request, tmp_path):
    """A small disk, of which so many kB are free."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "none", place]
    if subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("no disk can be mounted here")
    (place / ".full").write_bytes(bytes((64 - request.param) * 1024))
    yield place
    subprocess.run(["umount", "--lazy", place], check=True)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_full_disk_is_one_sentence_and_nothing_half_written(name, given, disk, capfd):
    words, out, together = COMMANDS[name]
    with contextlib.chdir(given):
        status = run(f"{words} --out {disk / out}")
    output = capfd.readouterr().err
    assert (status, len(sentences(output))) in ((0, 0), (2, 1)), output
    assert status == 0 or "No space left" in output or "disk may be full" in output
    check(disk, together)
    assert not list(disk.rglob(".endolab*"))
