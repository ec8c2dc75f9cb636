"""Commands that are killed at a random moment of their work, and then run again.

Afterwards what is there is whole; the same command makes of it what it makes without an interruption,
bit for bit; and no process, temporary file or piece of shared memory is left.
"""

import contextlib
import csv
import hashlib
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import zlib
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import psutil

from tests.hostile import judge
from tests.hostile.guard import ROOT, Outcome

WEIGHTS = ",".join(f"{0.1 * k:.1f}" for k in range(1, 25))
KNOWN = ("--calibration", "cal.json")
# Of each command: its words, what it writes, and of that what may be there before all is done.
COMMANDS = {
    "reconstruct": (
        ("reconstruct", "wide.png", "--calibration", "wide.json", "--solver", "primal_dual", "--out", "out"),
        ("out",),
        (),
    ),
    "video": (("reconstruct", "pictures", *KNOWN, "--out", "out"), ("out",), ("out",)),
    "sweep": (
        ("sweep", "frame.png", *KNOWN, "--lam", WEIGHTS, "--jobs", "2", "--out", "out.csv"),
        ("out.csv",),
        ("out.csv",),
    ),
    "calibrate": (
        ("calibrate", "sheet", "--target", "vicalib_small", "--every", "2", "--out", "new.json"),
        ("new.json", "new_report"),
        ("new_report",),
    ),
    "simulate": (("simulate", "colon", "--width", "320", "--texture", "0.1", "--out", "out"), ("out",), ()),
    "simulate sheet": (
        ("simulate", "sheet", "--width", "160", "--frames", "24", "--video", "--out", "out"),
        ("out",),
        (),
    ),
}
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
PATIENCE = 5  # s until every process that a killed command started is gone
ENDING = 20  # s until it has ended itself: it finishes a step, and says where it was
LONGEST = 120  # s for a command that is not killed


@dataclass
class Kills:
    """Runs commands and kills them; use it as a context."""

    package: Path | None = None
    place: Path = field(default_factory=lambda: Path(tempfile.mkdtemp(prefix="hostile-kills-")))
    keep: bool = False
    _server: subprocess.Popen | None = None
    _whole: dict = field(default_factory=dict)  # what a command makes without interruption, and its seconds

    def __enter__(self):
        argv = [
            sys.executable,
            "-m",
            "tests.hostile.forks",
            *([] if self.package is None else [str(self.package)]),
        ]
        environment = os.environ | {
            "MPLBACKEND": "Agg",
            "CI": "1",
            "OPENBLAS_NUM_THREADS": "1",
            "ENDOLAB_THREADS": "1",
        }
        environment["PYTHONPATH"] = str(self.package or ROOT)
        log = (self.place / "log").open("wb")
        self._server = subprocess.Popen(
            argv, cwd=ROOT, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log
        )
        log.close()
        self._hear()
        self._make_given()
        return self

    def __exit__(self, *_):
        self._server.stdin.close()
        self._server.wait()
        self._server.stdout.close()
        if not self.keep:
            shutil.rmtree(self.place, ignore_errors=True)

    def kill(self, name, seed):
        """Start a command, kill it, look at what it leaves, and run it again; what came of it."""
        whole, usual = self._uninterrupted(name)
        rng = np.random.default_rng([zlib.crc32(name.encode()), seed])
        number, share = SIGNALS[int(rng.integers(len(SIGNALS)))], float(rng.uniform(0.05, 0.95))
        folder = self._folder(f"{name.replace(' ', '-')}-{seed}")
        started, process = time.monotonic(), self._start(name, folder)
        time.sleep(share * usual)
        with contextlib.suppress(ProcessLookupError):
            os.kill(process, number)
        status, wrong = self._wait(process, ENDING), []
        if status is None:
            wrong.append(f"it went on for {ENDING} s")
            os.kill(process, signal.SIGKILL)
            self._wait(process, PATIENCE)
        wrong += self._left(folder)
        wrong += _words_after(
            status, number, folder, essence(folder, COMMANDS[name][1]).keys() == whole.keys()
        )
        there = sorted(path for path in judge.tree(folder) if path.split("/")[0] in COMMANDS[name][1])
        wrong += self._partial(name, folder, whole)
        second = self._start(name, folder)
        status_again = self._wait(second, LONGEST)
        said = Path(f"{folder}.err").read_text(errors="replace").strip()[:300]
        if status_again != 0:
            wrong.append(f"run again, it ends with {status_again!r}: {said}")
        else:
            wrong += _differences(whole, essence(folder, COMMANDS[name][1]))
        wrong += self._left(folder)
        wrong += [
            f"left after the second run: {path}"
            for path in judge.tree(folder)
            if "/." in f"/{path}" and Path(path).name != judge.MARK
        ]
        wrong += [f"temporary file left: {path}" for path in judge.tree(f"{folder}.tmp")]
        wrong += [f"shared memory left: {path}" for path in _shared_memory(process, second)]
        told = (
            f"endolab {' '.join(COMMANDS[name][0])[:120]}, {number.name} after {share:.0%} of {usual:.1f} s"
        )
        told += f", when there were {len(there)} files and folders"
        if not self.keep and not wrong:
            shutil.rmtree(folder)
        return Outcome(f"kill {name}", seed, told, status, said, tuple(wrong), time.monotonic() - started)

    def _uninterrupted(self, name):
        if name not in self._whole:
            folder, started = self._folder(f"whole-{name.replace(' ', '-')}"), time.monotonic()
            status = self._wait(self._start(name, folder), LONGEST)
            if status != 0:
                raise RuntimeError(f"{name} ends with {status}: {Path(f'{folder}.err').read_text()}")
            self._whole[name] = essence(folder, COMMANDS[name][1]), time.monotonic() - started
        return self._whole[name]

    def _folder(self, name):
        """A folder with the good files, links to which will do, as commands leave them alone."""
        folder = self.place / name
        for suffix in ("", ".tmp"):
            shutil.rmtree(f"{folder}{suffix}", ignore_errors=True)
            Path(f"{folder}{suffix}").mkdir()
        for given in (self.place / "given").iterdir():
            (folder / given.name).symlink_to(given)
        return folder

    def _make_given(self):
        folder = self.place / "given"
        folder.mkdir()
        Path(f"{folder}.tmp").mkdir()
        for words in (
            "simulate colon --width 64 --out colon --seed 1",
            "simulate colon --width 128 --out wide --seed 1",
            "simulate sheet --width 240 --frames 8 --target vicalib_small --out sheet",
        ):
            process = self._ask(argv=words.split(), folder=str(folder))
            if self._wait(process, LONGEST) != 0:
                raise RuntimeError(f"{words}: {Path(f'{folder}.err').read_text()}")
        shutil.copy(folder / "colon/frame.png", folder / "frame.png")
        shutil.copy(folder / "colon/endoscope.json", folder / "cal.json")
        shutil.copy(folder / "wide/frame.png", folder / "wide.png")
        shutil.copy(folder / "wide/endoscope.json", folder / "wide.json")
        (folder / "pictures").mkdir()
        frame = cv2.imread(str(folder / "frame.png"))
        for number in range(8):  # the same colon, ever darker
            cv2.imwrite(
                str(folder / f"pictures/{number:02d}.png"),
                np.round(frame * (1 - 0.01 * number)).astype(np.uint8),
            )

    # The server -------------------------------------------------------------------------------

    def _start(self, name, folder):
        return self._ask(argv=list(COMMANDS[name][0]), folder=str(folder))

    def _wait(self, process, seconds):
        return self._ask(wait=process, seconds=seconds)

    def _ask(self, **request):
        self._server.stdin.write(json.dumps(request).encode() + b"\n")
        self._server.stdin.flush()
        return self._hear()

    def _hear(self):
        line = self._server.stdout.readline()
        if not line:
            raise RuntimeError(f"the server of forks ended: {(self.place / 'log').read_text()[-1000:]}")
        return json.loads(line)

    # What is left -----------------------------------------------------------------------------

    def _left(self, folder):
        """Name processes of a command that are still there when it has ended, and end them."""
        until = time.monotonic() + PATIENCE
        while True:
            found = [process for process in psutil.process_iter() if _belongs(process, folder)]
            if not found or time.monotonic() > until:
                break
            time.sleep(0.02)
        told = []
        for process in found:
            with contextlib.suppress(psutil.Error):
                told.append(f"process left: {' '.join(process.cmdline())[:100]}")
                process.kill()
        return told

    def _partial(self, name, folder, whole):
        """Say what of the results is broken, or there alone where it should be all or nothing."""
        _, writes, grows = COMMANDS[name]
        wrong, there = [], set()
        for path, what in judge.tree(folder).items():
            if path.split("/")[0] not in writes or what in ("folder", "special"):
                continue
            if any(part.startswith(".") for part in path.split("/")):
                continue  # not a result; a later run takes it away
            there.add(path)
            # A line that is being added may be cut off: the next run looks at that frame again.
            if not path.endswith(".jsonl"):
                wrong += judge.broken(folder / path)
        missing = {path for path in whole if path.split("/")[0] not in grows} - there
        some = {path for path in there if path.split("/")[0] not in grows}
        if some and missing:
            wrong.append(f"{', '.join(sorted(some))} without {', '.join(sorted(missing))}")
        return wrong


def _belongs(process, folder):
    """Whether a process was started by a command in a folder."""
    with contextlib.suppress(psutil.Error, OSError):
        if process.environ().get("HOSTILE") == str(folder):
            return process.status() != psutil.STATUS_ZOMBIE
        return process.cwd() == str(folder) and process.status() != psutil.STATUS_ZOMBIE
    return False


def _shared_memory(*processes):
    """What processes have left in shared memory, where others' may be, too."""
    place = Path("/dev/shm")
    names = [path.name for path in place.iterdir()] if place.is_dir() else []
    marks = [mark for process in processes for mark in (f"_{process}_", f"-{process}-")]
    return sorted(name for name in names if any(mark in name for mark in marks))


def _words_after(status, number, folder, done):
    """Say what is wrong with how a command ended; once all is `done`, Python may be killed as it leaves."""
    out, err = (Path(f"{folder}.{name}").read_text(errors="replace") for name in ("out", "err"))
    if done and status in (0, -number) and "in _shutdown" in err:  # all is said and written by then
        err = ""
    if status in (-signal.SIGKILL, -signal.SIGTERM):  # joblib's tracker tells what such a process left to it
        err = re.sub(r".*resource_tracker.*leaked.*\n(\s+warnings\.warn.*\n)?", "", err)
    if status == 0 or (done and status == -number):
        return list(judge.wrong_words(0, out, err, ()))
    if number is signal.SIGKILL:
        expected, lines = -signal.SIGKILL, (0,)
    elif number is signal.SIGTERM:
        expected, lines = (-signal.SIGTERM, 143), (0, 1)
    else:
        expected, lines = 130, (1,)
    wrong = []
    if status not in np.atleast_1d(expected):
        wrong.append(f"exit status {status} after {number.name}")
    if len(err.splitlines()) not in lines or "Traceback" in err:
        wrong.append(f"after {number.name} it says {err[-300:]!r}")
    return wrong


# What a result comes to -------------------------------------------------------------------------
def essence(folder, names):
    """Of every result its content, but for what differs from run to run: seconds and where the folder is."""
    found = {}
    for name in names:
        root = Path(folder) / name
        for path in sorted(root.rglob("*")) if root.is_dir() else [root]:
            relative = path.relative_to(folder).as_posix()
            if path.is_file() and not any(part.startswith(".") for part in relative.split("/")):
                found[relative] = hashlib.blake2b(_content(path, str(folder))).hexdigest()
    return found


def _content(path, folder):
    if path.suffix == ".npz":
        with np.load(path) as archive:
            return b"".join(name.encode() + archive[name].tobytes() for name in sorted(archive.files))
    if path.suffix in (".rrd", ".html"):  # both tell when they were made
        return b"there"
    if path.suffix == ".mkv":
        capture, frames = cv2.VideoCapture(str(path)), []
        while (shown := capture.read())[0]:
            frames.append(shown[1].tobytes())
        capture.release()
        return b"".join(frames)
    content = path.read_bytes().replace(folder.encode(), b"")
    if path.suffix == ".json":
        return json.dumps(_timeless(json.loads(content))).encode()
    if path.suffix == ".jsonl":
        return b"\n".join(sorted(content.splitlines()[1:]))
    if path.suffix == ".csv":
        rows = sorted(
            csv.DictReader(io.StringIO(content.decode())), key=lambda row: [row["frame"], row.get("lam")]
        )
        return json.dumps(
            [{key: value for key, value in row.items() if key != "seconds"} for row in rows]
        ).encode()
    return content


def _timeless(document):
    if isinstance(document, dict):
        return {
            key: _timeless(value)
            for key, value in document.items()
            if key not in ("seconds", "clock", "created")
        }
    return [_timeless(value) for value in document] if isinstance(document, list) else document


def _differences(whole, again):
    for name in sorted({*whole, *again}):
        if whole.get(name) != again.get(name):
            what = "missing" if name not in again else "more" if name not in whole else "another"
            yield f"{what} than without an interruption: {name}"
