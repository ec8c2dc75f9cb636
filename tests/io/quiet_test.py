"""What others print is silenced while they read, and not before or after."""

import logging
import os
import subprocess
import sys
import threading

import cv2

from endolab.io.quiet import FFMPEG_LEVEL, quiet
from tests.conftest import ROOT


def state():
    return (
        cv2.utils.logging.getLogLevel(),
        dict(os.environ),
        list(logging.getLogger("PIL").handlers),
    )


IMPORTED = """
import cv2, logging, os
def state():
    return cv2.utils.logging.getLogLevel(), dict(os.environ), list(logging.getLogger("PIL").handlers)
before = state()
import endolab.io.images, endolab.io.video
assert state() == before
"""


def test_importing_silences_nobody():
    subprocess.run([sys.executable, "-c", IMPORTED], check=True, timeout=120, cwd=ROOT)


def test_what_the_user_set_stays(monkeypatch):
    monkeypatch.setenv(FFMPEG_LEVEL, "16")
    with quiet:
        assert os.environ[FFMPEG_LEVEL] == "16"
    assert os.environ[FFMPEG_LEVEL] == "16"


def test_it_is_quiet_until_the_last_thread_is_out():
    before = state()
    inside = threading.Event()
    leave = threading.Event()

    def stay():
        with quiet:
            inside.set()
            leave.wait(10)

    with quiet:
        other = threading.Thread(target=stay)
        other.start()
        assert inside.wait(10)
    assert cv2.utils.logging.getLogLevel() == cv2.utils.logging.LOG_LEVEL_SILENT
    leave.set()
    other.join()
    assert state() == before


PRINTS = """
import sys
from endolab.io.video import open_frames
try:
    print([image is None for _, image in open_frames(sys.argv[1])])
except ValueError as error:
    print(error)
"""


def test_nothing_is_printed_of_a_damaged_video(tmp_path, rng):
    path = tmp_path / "a.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 25, (64, 48))
    for _ in range(9):
        writer.write(rng.integers(0, 256, (48, 64, 3)).astype("uint8"))
    writer.release()
    content = bytearray(path.read_bytes())
    start = content.index(b"mdat")
    for at in range(start + 100, start + 9000, 97):
        content[at] ^= 0x5A
    path.write_bytes(content)
    plain = {name: value for name, value in os.environ.items() if name != FFMPEG_LEVEL}
    how = {
        "capture_output": True,
        "text": True,
        "timeout": 120,
        "cwd": ROOT,
        "env": plain,
    }
    read = "import cv2, sys\nc = cv2.VideoCapture(sys.argv[1])\nwhile c.grab(): pass"
    loud = subprocess.run([sys.executable, "-c", read, path], **how, check=True)
    assert loud.stderr  # without endolab
    done = subprocess.run([sys.executable, "-c", PRINTS, path], **how, check=True)
    assert done.stderr == ""
