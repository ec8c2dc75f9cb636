"""Where the time of a command goes: stages one after the other, whose sum is the wall clock."""

import time
from collections.abc import Iterable


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

    Until then it has hardly waited: what it has computed is how long it has been there.
    """
    return time.perf_counter() - time.process_time()
