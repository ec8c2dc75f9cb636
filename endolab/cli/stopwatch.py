"""Where the time of a command goes: stages one after the other, whose sum is the wall clock."""

import os
import time
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

STARTTIME = 19  # field of /proc/PID/stat after the name: when it began, in ticks since the machine did
MOST = 60.0  # s that a process may take to begin; more is a container's other clock


class Stopwatch:
    """Counts seconds from `began`, a reading of `time.perf_counter`."""

    def __init__(self, began: float) -> None:
        self.stages: dict[str, float] = {}
        self._last = began

    def lap(self, stage: str) -> float:
        """Add the time since the last call to a stage, and return it."""
        now = time.perf_counter()
        passed, self._last = now - self._last, now
        self.stages[stage] = self.stages.get(stage, 0.0) + passed
        return passed

    def share(self, stage: str, parts: Iterable[tuple[str, float]]) -> None:
        """Give parts of a stage's time, each with its seconds, to stages of their own."""
        for part, seconds in parts:
            self.stages[part] = self.stages.get(part, 0.0) + seconds
            self.stages[stage] -= seconds

    @property
    def total(self) -> float:
        """Seconds of all stages."""
        return sum(self.stages.values())


def process_began() -> float:
    """When this process began, as `time.perf_counter` would have told; to be asked soon after.

    Linux knows it, to 0.01 s. Elsewhere, what was computed since is how long it has been: it hardly waited.
    """
    age = least = time.process_time()
    with suppress(OSError, ValueError, IndexError, AttributeError):
        fields = Path("/proc/self/stat").read_text().rpartition(")")[2].split()
        ticks = int(fields[STARTTIME]) / os.sysconf("SC_CLK_TCK")
        age = time.clock_gettime(time.CLOCK_BOOTTIME) - ticks
    return time.perf_counter() - (age if least <= age < MOST else least)
