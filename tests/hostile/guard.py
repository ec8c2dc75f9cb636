"""Watches a worker from outside: limits its time, says how it died, starts another."""

import contextlib
import json
import os
import select
import subprocess
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import psutil

ROOT = Path(__file__).resolve().parents[2]
LIMIT = 20  # s for one case
STARTING = 280  # s until a worker is warm; the first one of all compiles


@dataclass(frozen=True)
class Outcome:
    """What came of a case."""

    name: str
    seed: int
    told: str = ""
    status: object = None
    said: str = ""
    wrong: tuple[str, ...] = ()
    seconds: float = 0.0
    peak: float = 0.0  # MB

    def __str__(self):
        what = "; ".join(self.wrong) or "survived"
        case = f"--only '{self.name}' --seed {self.seed}"
        return f"{case}: {what}\n    {self.told[:300]}\n    {self.status}: {self.said}"


@dataclass
class Guard:
    """Runs cases in a worker; use it as a context."""

    package: Path | None = None  # another checkout of endolab
    limit: float = LIMIT
    keep: bool = False  # the folders of the cases
    prefix: tuple[str, ...] = ()  # of the worker's command
    program: tuple[str, ...] = ("-m", "tests.hostile.worker")
    place: Path = field(default_factory=lambda: Path(tempfile.mkdtemp(prefix="hostile-")))
    _worker: subprocess.Popen | None = None
    _started: int = 0
    _read: bytes = b""

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stop()
        if not self.keep:
            _remove(self.place)

    def run(self, name, seed):
        """Run one case; a worker that dies or hangs is a case that was not survived."""
        if self._worker is None:
            self.start()
        self._worker.stdin.write(f"{name} {seed}\n".encode())
        self._worker.stdin.flush()
        told = self._answer(self.limit)
        answer = None if told is None else self._answer(self.limit)
        if answer is None:
            died = self._worker.poll()
            what = (
                f"no end after {self.limit} s"
                if died is None
                else f"the process died ({died}): {self._log()}"
            )
            self.stop()
            return Outcome(name, seed, told or "", wrong=(what,))
        if not answer["wrong"] and not self.keep:
            _remove(self.place / str(self._started) / f"{name}-{seed}")
        return Outcome(name, seed, told, **answer | {"wrong": tuple(answer["wrong"])})

    def run_all(self, name, seeds):
        """Run cases of a class."""
        return [self.run(name, seed) for seed in seeds]

    def stop(self):
        """End the worker, and whatever it started."""
        if self._worker is None:
            return
        with contextlib.suppress(psutil.NoSuchProcess):
            for process in [
                *psutil.Process(self._worker.pid).children(recursive=True),
                psutil.Process(self._worker.pid),
            ]:
                with contextlib.suppress(psutil.NoSuchProcess):
                    process.kill()
        self._worker.wait()
        self._worker.stdin.close()
        self._worker.stdout.close()
        self._worker = None

    def start(self):
        """Start a worker, which takes some seconds until it is warm."""
        self._started, self._read = self._started + 1, b""
        place = self.place / str(self._started)
        place.mkdir()
        argv = [*self.prefix, sys.executable, *self.program, str(place)]
        argv += [] if self.package is None else [str(self.package)]
        environment = os.environ | {"MPLBACKEND": "Agg", "CI": "1", "OPENBLAS_NUM_THREADS": "1"}
        environment["PYTHONPATH"] = str(self.package or ROOT)
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": (place / "errors").open("wb")}
        self._worker = subprocess.Popen(argv, cwd=ROOT, env=environment, **pipes)
        pipes["stderr"].close()
        if self._answer(STARTING) is None:
            told = self._log()
            self.stop()
            raise RuntimeError(f"the worker did not start: {told}")

    def _answer(self, limit):
        """What the next line of the worker says; None if it died or the time is over."""
        while b"\n" not in self._read:
            ready, _, _ = select.select([self._worker.stdout], [], [], limit)
            part = os.read(self._worker.stdout.fileno(), 1 << 20) if ready else b""
            if not part:
                if ready:
                    self._worker.wait()
                return None
            self._read += part
        line, _, self._read = self._read.partition(b"\n")
        return json.loads(line)

    def _log(self):
        """The end of what the worker printed."""
        place = self.place / str(self._started)
        texts = [
            (place / name).read_text(errors="replace")
            for name in ("log", "errors", "err")
            if (place / name).exists()
        ]
        return " ".join("".join(texts)[-500:].split())


def _remove(folder):
    # Not shutil's, which calls itself for each of a thousand folders in each other.
    subprocess.run(["rm", "-rf", str(folder)], check=False)


def told(outcomes):
    """A sentence for every case that was not survived, those of one kind together."""
    failed = [outcome for outcome in outcomes if outcome.wrong]
    kinds = Counter(outcome.wrong[0][:40] for outcome in failed)
    return [f"{kinds[outcome.wrong[0][:40]]} like it: {outcome}" for outcome in failed]
