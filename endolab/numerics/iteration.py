"""One driver for everything that comes nearer step by step: depth solvers and calibration fits alike.

They are generators that yield their steps and return the `Status` with which they ended. Who wants
to see the steps is an observer: any callable ``step -> bool | None``, whose True ends the run.
"""

import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from enum import Enum
from typing import Any, TypeVar

from endolab.numerics.checks import excerpt

Step = TypeVar("Step")
Value = TypeVar("Value")


class Status(Enum):
    """Why a run ended."""

    CONVERGED = "The solver reached its goal."
    SETTLED = "The surface has come to rest."
    MAX_ITERATIONS = "The solver ran out of iterations before it converged."
    STOPPED = "An observer or the user stopped the run."
    STALLED = "The solver could not improve the result any more, short of its goal."
    NON_FINITE = "The solver produced a value that is not finite."

    @property
    def is_done(self) -> bool:
        """Whether the run ended by itself, where it was to end."""
        return self in (Status.CONVERGED, Status.SETTLED)


class Stopped(RuntimeError):
    """An observer has stopped what has nothing to tell yet."""


class Clock:
    """Tells seconds, without those that loops were being compiled: `compiled` adds them up."""

    compiled = 0.0

    def now(self) -> float:
        """Seconds from some time on."""
        return time.perf_counter() - self.compiled


CLOCK = Clock()


def drive(
    steps: Generator[Step, None, Status],
    observers: Sequence[Callable[[Step], bool | None]],
    keep: Callable[[Step, float], None],
    tells: Callable[[Step], bool] = lambda step: True,
) -> Status:
    """Take steps to the end, or until an observer or the user stops.

    `keep` is given every step, and the seconds that the steps took so far but for compiling, before the
    observers see it. An interrupt after the first step that `tells` something counts as a stop; one before
    it is passed on.
    """
    seconds = 0.0
    begun = False
    try:
        while True:
            started = CLOCK.now()
            try:
                step = next(steps)
            except StopIteration as end:
                status: Status = end.value
                return status
            finally:
                seconds += CLOCK.now() - started
            keep(step, seconds)
            begun = begun or tells(step)
            # All see it, whatever one says.
            wishes = [observer(step) for observer in observers]
            if any(wishes):
                return Status.STOPPED
    except KeyboardInterrupt:
        if not begun:
            raise
        return Status.STOPPED
    finally:
        steps.close()


def finish(
    steps: Generator[Step, None, Value], keep: Callable[[Step], object] = lambda step: None
) -> Value:
    """Run a generator to its end and return what it returns; `keep` is given every step."""
    while True:
        try:
            keep(next(steps))
        except StopIteration as end:
            value: Value = end.value
            return value


@contextmanager
def close_observers(observers: Any) -> Iterator[list[Any]]:
    """Give the observers, if all can be called, else ValueError; at the end close those that can be closed.

    All are closed, even if another fails to.
    """
    given: list[Any] = list(observers) if isinstance(observers, Iterable) else [None]
    if not all(map(callable, given)):
        raise ValueError(
            f"observers must be several that can be called, got {excerpt(observers)}"
        )
    with ExitStack() as ending:
        for observer in given:
            if hasattr(observer, "close"):
                ending.callback(observer.close)
        yield given
