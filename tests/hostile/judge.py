"""What must hold after a case: exit 0 or 2, one sentence, whole or nothing, and nothing left behind."""

import contextlib
import csv
import dis
import gc
import hashlib
import io
import json
import os
import re
import shutil
import tempfile
import threading
import time
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import psutil

from endolab.cli.streams import ONCE

RAISE = dis.opmap["RAISE_VARARGS"]
MARK = ".endolab.json"  # by which a folder of results is known as one
LONGEST = 700  # characters of a sentence; the command line cuts the middle out of a longer one
MOST_MEMORY = 600  # MB that a case, whose files are small, may take for a while
MOST_THREADS = 8  # that libraries may start in their pools while cases run, and keep
# What Python, NumPy and other libraries say to those who wrote the program.
INWARD = re.compile(
    r"Traceback|Warning|\[Errno|Exception ignored|<class|NoneType|object has no|object is not|np\.\w+\(|"
    r"\bindices\b|out of bounds|operands|broadcast|unsupported operand|could not convert|invalid literal|"
    r"Unable to allocate|not subscriptable|not iterable|unhashable|positional argument|unexpected keyword|"
    r"list index|ufunc|dtype\(|cannot reshape|setting an array|truth value|"
    r"libpng|OpenCV|panicked|numba|0x[0-9a-f]{8}"
)


# What is there ----------------------------------------------------------------------------------
def tree(folder):
    """Every file and folder below a folder, with what a change of it would change."""
    found = {}
    for path in sorted(Path(folder).rglob("*")):
        if path.is_symlink():
            told = f"to {os.readlink(path)}"
        elif path.is_dir():
            told = "folder"
        elif path.is_file():
            try:
                told = hashlib.blake2b(path.read_bytes()).hexdigest()
            except OSError:
                told = "unreadable"
        else:
            told = "special"
        found[path.relative_to(folder).as_posix()] = told
    return found


class Traces:
    """What a case may leave in its process: threads, other processes, open files, memory."""

    def __init__(self):
        self.threads = {thread.ident for thread in threading.enumerate()}
        self.tasks = _count("/proc/self/task")
        self.files = _open_files()
        self.processes = {child.pid for child in psutil.Process().children(recursive=True)}
        self.memory = _reset_peak()

    def left(self):
        """Say what is there that was not there before."""
        for patience in (0, 0, 0.05, 0.2, 0.75):  # what ends by itself may take a moment
            time.sleep(patience)
            found = list(self._found())
            if not found:
                break
            gc.collect()
        peak = _peak()
        if peak - self.memory > MOST_MEMORY:
            found.append(f"it took {peak - self.memory:.0f} MB")
        return found, peak

    def _found(self):
        for thread in threading.enumerate():
            if thread.ident not in self.threads:
                yield f"thread left: {thread.name}"
        for child in psutil.Process().children(recursive=True):
            if child.pid not in self.processes:
                yield f"process left: {' '.join(child.cmdline())[:80]}"
        tasks, files = _count("/proc/self/task"), _open_files()
        if tasks > self.tasks + MOST_THREADS:
            yield f"{tasks - self.tasks} threads of libraries left"
        if files > self.files:
            yield f"{files - self.files} open files left"


def _count(folder):
    return len(os.listdir(folder)) if os.path.isdir(folder) else 0


def _open_files():
    """How many files are open, but for the fonts that matplotlib keeps."""
    names = []
    for name in os.listdir("/proc/self/fd") if os.path.isdir("/proc/self/fd") else ():
        with contextlib.suppress(OSError):
            names.append(os.readlink(f"/proc/self/fd/{name}"))
    return sum(not name.endswith(".ttf") for name in names)


def _reset_peak():
    """Begin to measure the most memory anew, where the system can; MB that are taken now."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    return psutil.Process().memory_info().rss / 2**20


def _peak():
    """The most memory since then, MB."""
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        return psutil.Process().memory_info().rss / 2**20
    return int(re.search(r"VmHWM:\s+(\d+)", status)[1]) / 1024


# Sentences ----------------------------------------------------------------------------------------
def raised_on_purpose(error):
    """Say where an exception comes from; "" if it is a `raise` in endolab, and so a sentence for people."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    if trace is None:
        return ""
    code = trace.tb_frame.f_code
    if "endolab" in Path(code.co_filename).parts and code.co_code[trace.tb_lasti] == RAISE:
        return ""
    return f"{type(error).__name__} of {Path(code.co_filename).name}, line {trace.tb_lineno}, was not meant"


def wrong_words(status, out, err, names):
    """Say what is wrong with what was printed."""
    err = err.replace(f"{ONCE}\n", "")  # which a first run may say
    if status not in (0, 2):
        yield f"exit status {status!r}"
    if status == 0 and err.strip():
        yield f"something on stderr: {err.strip()[:200]}"
    if status == 2:
        lines = err.splitlines()
        if len(lines) != 1:
            yield f"{len(lines)} lines on stderr: {err[:200]!r}"
        sentence = lines[-1] if lines else ""
        if not sentence.startswith("endolab: ") or len(sentence) < 15:
            yield f"no sentence: {sentence[:200]!r}"
        if len(sentence) > LONGEST:
            yield f"a sentence of {len(sentence)} characters: {sentence[:200]!r}"
        if any(not char.isprintable() for char in sentence):
            yield f"unprintable characters: {sentence[:200]!r}"
        if names and not any(name in sentence for name in names):
            yield f"it names none of {', '.join(names)}: {sentence[:200]!r}"
    inward = INWARD.search(out + err)
    if inward:
        around = (out + err)[max(0, inward.start() - 120) : inward.end() + 80]
        yield f"words for programmers ({inward[0]}): {around!r}"
    if status == 0 and re.search(r"\b(nan|inf)\b", out):
        yield f"a number that is none: {out[:200]!r}"


# Files --------------------------------------------------------------------------------------------
def wrong_files(before, after, status, case):
    """Say which files are changed, left over, missing or broken, of two trees."""

    def within(name, roots):
        return any(
            name == root or name.startswith(root + "/") or root.startswith(name + "/") for root in roots
        )

    allowed = case.kept + (case.new if status == 0 else ())
    for name in sorted({*before, *after}):
        if before.get(name) == after.get(name):
            continue
        hidden = any(part.startswith(".") and part != MARK for part in name.split("/"))
        if hidden or not within(name, allowed) or name in case.safe:
            what = "left over" if name not in before else "gone" if name not in after else "changed"
            yield f"{what}: {name}"
        elif name in after and after[name] not in ("folder", "special") and name not in case.any:
            yield from broken(Path(name))
    if status == 0:
        yield from (f"missing: {name}" for name in case.new if name not in after)


def broken(path):
    """Say why a result cannot be read back whole."""
    reader = READERS.get(path.suffix)
    if reader is None:
        return [f"left over: {path}"]
    try:
        reader(path)
    except Exception as error:  # whatever a reader says to a broken file
        return [f"broken: {path}: {type(error).__name__} {str(error)[:150]}"]
    return []


def _check(good, what):
    if not good:
        raise ValueError(what)


def _arrays(path):
    with np.load(path, allow_pickle=False) as archive:
        maps = {name: archive[name] for name in archive.files}
    _check(maps, "nothing in it")
    if path.name not in ("depth.npz", "truth.npz"):
        return
    mask, distance, z, normals = maps["mask"], maps["distance"], maps["z"], maps["normals"]
    _check(
        mask.dtype == bool and mask.any() and distance.shape == mask.shape == z.shape, "shapes or no pixel"
    )
    inside = distance[mask]
    _check(np.isfinite(inside).all() and (inside > 0).all(), "a distance that is none")
    _check(np.isfinite(z[mask]).all(), "a z that is none")
    lengths = np.linalg.norm(normals[mask], axis=-1)
    _check(np.allclose(lengths[np.isfinite(lengths)], 1, atol=1e-3) and np.isfinite(lengths).any(), "normals")
    _check(maps["metric"].dtype == bool, "metric")


def _strict(text):
    def refuse(word):
        raise ValueError(f"{word} is no JSON")

    return json.loads(text, parse_constant=refuse)


def _table(path):
    rows = list(csv.reader(io.StringIO(path.read_bytes().decode(errors="surrogateescape"), newline="")))
    _check(
        rows and len(rows[0]) > 1 and all(len(row) == len(rows[0]) for row in rows),
        "rows of different lengths",
    )


def _picture(path):
    import cv2

    _check(
        cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_UNCHANGED) is not None,
        "no picture",
    )


def _cloud(path):
    content = path.read_bytes()
    head, _, body = content.partition(b"end_header\n")
    lines = head.decode().splitlines()
    sizes = {"float": 4, "uchar": 1}
    count = next(int(line.split()[2]) for line in lines if line.startswith("element vertex"))
    faces = sum(int(line.split()[2]) for line in lines if line.startswith("element face"))
    stride = sum(
        sizes[line.split()[1]] for line in lines if line.startswith("property") and " list " not in line
    )
    _check(count > 0 and len(body) == count * stride + faces * 13, "a length that its header does not say")
    places = np.frombuffer(body[: count * stride], np.uint8).reshape(count, stride)[:, :12].copy().view("<f4")
    _check(np.isfinite(places).all(), "points that are none")


def _recording(path):
    _check(path.read_bytes()[:3] == b"RRF", "no recording")
    try:
        import rerun as rr
    except ImportError:
        return
    with tempfile.TemporaryDirectory() as folder:  # its name may be one that Rerun does not take
        copy = Path(shutil.copy(path, Path(folder) / "copy.rrd"))
        _check(list(rr.chunk.RrdReader(copy).stream().to_chunks()), "nothing in it")


def _video(path):
    _check(_frames(path) > 0, "no video")


def _lines(path):
    text = path.read_text(encoding="utf-8")
    _check(text.endswith("\n"), "a line that is cut off")
    for line in text.splitlines():
        _strict(line)


def _ends(*ends):
    def reader(path):
        _check(path.read_bytes().rstrip().endswith(ends), "cut off")

    return reader


def _json(path):
    content = _strict(path.read_text(encoding="utf-8"))
    if path.name == "truth.json":  # of a calibration video: there is one for each of its frames
        count = len(list(path.parent.glob("*.png"))) or _frames(path.parent / "sheet.mkv")
        _check(len(content["frames"]) == count, f"{len(content['frames'])} truths of {count} frames")
        _check(all(frame["gain"] > 0 and frame["poses"] for frame in content["frames"]), "a gain or a pose")


def _frames(path):
    import cv2

    capture, count = cv2.VideoCapture(str(path)), 0
    while capture.grab():
        count += 1
    capture.release()
    return count


READERS = {
    ".npz": _arrays,
    ".json": _json,
    ".jsonl": _lines,
    ".csv": _table,
    ".png": _picture,
    ".ply": _cloud,
    ".rrd": _recording,
    ".mkv": _video,
    ".pdf": _ends(b"%%EOF"),
    ".svg": lambda path: ElementTree.fromstring(path.read_bytes()),
    ".html": _ends(b"</html>"),
    ".obj": lambda path: _check(path.read_text(encoding="utf-8").endswith("\n"), "cut off"),
    ".py": lambda path: compile(path.read_text(encoding="utf-8"), str(path), "exec"),
}
