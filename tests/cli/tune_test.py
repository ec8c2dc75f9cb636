"""``endolab tune``: what it is given, and a sentence about whatever is wrong; browser tests open it."""

import re
import shutil
import socket
import subprocess
import sys
import threading
import time

import cv2
import numpy as np
import psutil
import pytest

import endolab as el
from endolab.cli import main as cli
from endolab.cli.solving import tunnel
from endolab.cli.tune import find_pictures, read_truth
from endolab.io.surfaces import read_depth


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    options = ["--calibration", "simple", "--width", "64", "--out"]
    assert cli.main(["simulate", "curved", *options, str(folder / "sim")]) == 0
    (folder / "several").mkdir()
    for name in ("f10.png", "f9.png", "0001_depth.png", ".hidden.png"):
        shutil.copy(folder / "sim/frame.png", folder / "several" / name)
    (folder / "several/notes.txt").write_text("no picture")
    return folder


def test_pictures_of_a_folder_come_by_number_and_depth_maps_do_not(made):
    assert [path.name for path in find_pictures(made / "several")] == [
        "f9.png",
        "f10.png",
    ]
    assert find_pictures(made / "sim/frame.png") == [made / "sim/frame.png"]


def test_the_truth_is_a_distance(made):
    calibration = el.load_calibration(made / "sim/endoscope.json")
    expected = read_depth(made / "sim/truth.npz")
    found = read_truth(made / "sim/truth.npz", calibration)
    np.testing.assert_array_equal(found, expected["distance"])
    stored = np.round(expected["z"] * 655.35)  # as C3VD stores it
    cv2.imwrite(str(made / "0001_depth.png"), stored.astype(np.uint16))
    found = read_truth(made / "0001_depth.png", calibration)
    known = np.isfinite(found)
    assert known.mean() > 0.9
    np.testing.assert_allclose(found[known], expected["distance"][known], rtol=1e-3)


def test_over_ssh_it_says_what_to_type(monkeypatch):
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.delenv("SSH_CONNECTION", raising=False)
    assert not tunnel(8877)
    monkeypatch.setenv("SSH_CONNECTION", "10.0.0.2 50000 10.0.0.1 22")
    assert re.search(r"ssh -L 8877:127\.0\.0\.1:8877 \S+@10\.0\.0\.1$", tunnel(8877))


def test_it_prints_a_link_on_the_next_free_port_and_ends_by_interrupt(made):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        command = [sys.executable, "-m", "endolab", "tune", str(made / "sim/frame.png")]
        command += ["--no-browser", f"--port={port}", "--width=64"]
        command += ["--calibration", str(made / "sim/endoscope.json")]
        how = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        with subprocess.Popen(command, **how) as process:
            watch = threading.Timer(120, process.kill)
            watch.start()
            line = process.stdout.readline()
            found = re.fullmatch(r"tuner: http://127\.0\.0\.1:(\d+)/(\w{48})/\n", line)
            assert found, line
            assert port < int(found[1])
            own = psutil.Process(process.pid)
            at = {one.laddr for one in own.net_connections("tcp") if not one.raddr}
            assert at == {("127.0.0.1", int(found[1]))}
            assert found[2] not in " ".join(own.cmdline())
            time.sleep(0.5)
            process.send_signal(2)
            out, error = process.communicate(timeout=60)
            watch.cancel()
    assert (process.returncode, out.splitlines()[-1], error) == (0, "ended", "")


def test_a_frame_of_twelve_megapixels_opens_without_gigabytes(tmp_path):
    """At the tuner's width, in a process of its own; 0.3 GB of it is the picture in double precision."""
    known = el.load_calibration("paper").resize(4000, 3000)
    el.write_calibration(known, tmp_path / "large.json")
    small = known.resize(400, 300)
    seen = el.render(el.SCENES["tube"], small.camera, small.photometry)
    stored = np.uint8(255 * cv2.resize(seen.image, (4000, 3000)))
    cv2.imwrite(str(tmp_path / "large.png"), stored)
    code = """
import re
from pathlib import Path
import endolab as el
from endolab.workbench.tuning.widget import TunerBox
known = el.load_calibration("large.json")
app = TunerBox(el.read_frame("large.png", known), known, width=160)
app.engine.wait(200)
outcome = app.answer
app.close()
# Of this program alone: ru_maxrss begins with that of the one which started it.
peak = re.search("VmHWM:\\s+(\\d+) kB", Path("/proc/self/status").read_text())[1]
print(outcome.result.mask.shape[1], peak)
"""
    how = {"cwd": tmp_path, "capture_output": True, "text": True, "timeout": 250}
    done = subprocess.run([sys.executable, "-c", code], **how)
    assert done.returncode == 0, done.stderr
    width, peak = map(int, done.stdout.split())
    assert width == 160
    assert peak < 1_000_000  # kB
