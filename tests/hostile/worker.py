"""A process that runs cases, one after another, with endolab imported and its loops compiled.

It reads lines "CLASS SEED" and answers each with two of JSON: what is run, and what came of it. What
a case prints is caught at the file descriptors, where libraries in C and Rust print too. Its time is
limited from outside, by `guard`; its memory by the system.
"""

import json
import os
import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
import zlib
from pathlib import Path

import numpy as np

from tests.hostile import judge

ROOM = 5  # GB of addresses that a case may take beyond those of the warm process


def opened(descriptor, **how):
    """A stream of text to a descriptor, as Python makes them for its output."""
    return os.fdopen(descriptor, "w", encoding="utf-8", closefd=False, **how)


class Errors:
    """Stands for sys.stderr: remembers the exception that was at hand when something was printed."""

    def __init__(self, stream):
        self.stream, self.error = stream, None

    def write(self, text):
        self.error = sys.exc_info()[1] or self.error
        return self.stream.write(text)

    def __getattr__(self, name):
        return getattr(self.stream, name)


class Worker:
    """Runs cases in folders of their own below `place`."""

    def __init__(self, place):
        from tests.hostile import classes, given  # not before it is known which endolab this is

        self.place = Path(place)
        self.temporary = self.place / "temporary"
        self.temporary.mkdir()
        tempfile.tempdir = os.environ["TMPDIR"] = str(self.temporary)
        self.caught = [
            os.open(self.place / name, os.O_RDWR | os.O_CREAT | os.O_APPEND) for name in ("out", "err")
        ]
        stock = self.place / "given"
        stock.mkdir()
        self.given = given.make(stock)
        self.classes = classes.CLASSES
        shutil.rmtree(self.temporary)
        self.temporary.mkdir()
        limit_memory()

    def begin(self, name, seed):
        """Make a case in a folder of its own, which becomes the working folder."""
        folder = self.place / f"{name}-{seed}"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        os.chdir(folder)
        rng = np.random.default_rng([zlib.crc32(name.encode()), seed])
        return self.classes[name](rng, self.given)

    def run(self, case):
        """Run a case; what came of it."""
        before, traces = judge.tree("."), judge.Traces()
        started = time.perf_counter()
        status, out, err, unmeant = self.caught_run(case)
        seconds = time.perf_counter() - started
        wrong, peak = traces.left()
        case.after()
        if not case.loose:
            wrong += judge.wrong_words(status, out, err, case.names)
            if case.status not in (None, status):
                wrong.append(f"exit status {status!r}, where {case.status} was expected: {err[:200]!r}")
            if status == 2 and unmeant:
                wrong.append(f"{unmeant}: {err.strip()[:200]}")
        wrong += judge.wrong_files(before, judge.tree("."), status, case)
        wrong += [f"temporary file left: {name}" for name in judge.tree(self.temporary)]
        shutil.rmtree(self.temporary)
        self.temporary.mkdir()
        os.chdir(self.place)
        return {"status": status, "said": err.strip()[:300], "wrong": wrong, "seconds": seconds, "peak": peak}

    def caught_run(self, case):
        """Exit status, what was printed, and where that came from if nobody meant it."""
        sys.stdout.flush(), sys.stderr.flush()
        saved = [os.dup(1), os.dup(2)]
        for descriptor, caught in zip((1, 2), self.caught, strict=True):
            os.ftruncate(caught, 0)
            os.dup2(caught, descriptor)
        streams = sys.stdout, sys.stderr
        sys.stdout = opened(1)
        sys.stderr = errors = Errors(opened(2, errors="backslashreplace", buffering=1))
        try:
            status = case.run()
        except SystemExit as exit:  # the parser's complaints are on purpose
            status, errors.error = exit.code, None
        except KeyboardInterrupt:
            status = "KeyboardInterrupt"
        except BaseException as error:  # what Python would print
            status, errors.error = 1, error
            last = traceback.extract_tb(error.__traceback__)[-1]
            errors.write(
                f"Traceback: {type(error).__name__}: {error} ({Path(last.filename).name}:{last.lineno})\n"
            )
        finally:
            sys.stdout.flush(), sys.stderr.flush()
            sys.stdout, sys.stderr = streams
            for descriptor, back in zip((1, 2), saved, strict=True):
                os.dup2(back, descriptor)
                os.close(back)
        texts = [os.pread(caught, 100_000, 0).decode(errors="replace") for caught in self.caught]
        unmeant = "" if errors.error is None else judge.raised_on_purpose(errors.error)
        return status, *texts, unmeant


def limit_memory():
    """No address space beyond what is taken now, and some room."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[0])
    except OSError:
        return
    limit = pages * resource.getpagesize() + ROOM * 2**30
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def main(place, package=None):
    """Serve until there is no more input."""
    requests, answers = os.fdopen(os.dup(0)), os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(os.open(Path(place) / "log", os.O_WRONLY | os.O_CREAT | os.O_APPEND), 1)
    os.dup2(1, 2)
    if package is not None:
        sys.path.insert(0, package)
    # As Python shows them, but each time and not only the first.
    warnings.simplefilter("always", RuntimeWarning)
    warnings.simplefilter("always", UserWarning)
    worker = Worker(place)
    print("{}", file=answers, flush=True)
    for line in requests:
        name, seed = line.split()
        case = worker.begin(name, int(seed))
        print(json.dumps(case.told), file=answers, flush=True)
        print(json.dumps(worker.run(case)), file=answers, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
