"""Compiled loops on several cores: how many, and who may use them.

A loop that `on_cores` compiles runs over bands of rows, always the same ones, and what bands write does not
depend on which comes first. So its results are the same, bit for bit, on any number of threads.

As many threads as this process has cores are used, or as `ENDOLAB_THREADS` says, or fewer inside
`limited_threads`. Joblib tells its workers their share of the cores by `NUMBA_NUM_THREADS`. Where two
threads of one process solve at once, one has the cores and the other goes on by itself; so does a forked
process.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache, update_wrapper
from types import FunctionType
from typing import Any

import numba

from endolab.numerics.checks import whole
from endolab.numerics.compiled import COMPILED, kernel

VARIABLE = "ENDOLAB_THREADS"
ENOUGH = 12_000  # pixels; with fewer, waking other cores takes longer than what they would do
ROWS = 16  # of a band

# Turns, some microseconds, that a thread waits for the next loop before it sleeps. OpenMP's own choice,
# milliseconds, takes the cores from other programs, and from the very threads that are waited for.
os.environ.setdefault("GOMP_SPINCOUNT", "10000")

# OpenMP first: Numba would rather have TBB, and warns if another package has loaded one that is too old.
numba.config.THREADING_LAYER_PRIORITY = ["omp", "tbb", "workqueue"]  # type: ignore[attr-defined]

_limit: ContextVar[int | None] = ContextVar("limit", default=None)
_cores = threading.Lock()
_forked = False


def _note_fork() -> None:
    """OpenMP does not survive a fork: a child that used it would be killed."""
    global _forked, _cores
    _forked, _cores = True, threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_note_fork)


@cache
def cores() -> int:
    """How many cores this process may keep busy, by its affinity and its container's share of time."""
    import joblib  # a twentieth of a second, which small frames do without

    return int(joblib.cpu_count())


def threads() -> int:
    """How many threads compiled loops take; ValueError if `ENDOLAB_THREADS` is no such number."""
    limit, told = _limit.get(), os.environ.get(VARIABLE)
    most = int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
    count = min(cores(), most)
    if told:
        if not (told.isascii() and told.isdigit() and int(told) > 0):
            raise ValueError(f"{VARIABLE} must be a positive number of threads, found {told!r}")
        count = min(int(told), most)
    return count if limit is None else min(count, limit)


@contextmanager
def limited_threads(count: int | None) -> Iterator[None]:
    """Take at most so many threads inside; None changes nothing. ValueError if it is no positive number."""
    token = _limit.set(_limit.get() if count is None else whole("threads", count, 1))
    try:
        yield
    finally:
        _limit.reset(token)


@kernel
def bands(rows: int) -> int:
    """How many bands so many rows make."""
    return (rows + ROWS - 1) // ROWS


@kernel
def band_rows(band: int, first: int, last: int) -> tuple[int, int]:
    """First row of a band, and the one after its last, of rows from `first` to before `last`."""
    return first + band * ROWS, min(first + band * ROWS + ROWS, last)


class _OnCores:
    """A compiled loop over bands, for one thread and for several; its first argument is a map of its size."""

    def __init__(self, function: FunctionType) -> None:
        update_wrapper(self, function)
        self.serial: Any = numba.njit(**COMPILED)(function)
        several = FunctionType(function.__code__, function.__globals__, function.__name__)
        several.__qualname__ = f"{function.__qualname__}_on_cores"  # caches go by this name
        self.parallel: Any = numba.njit(parallel=True, **COMPILED)(several)

    def __call__(self, first: Any, *others: Any) -> Any:
        if first.shape[-1] * first.shape[-2] < ENOUGH or _forked:
            return self.serial(first, *others)
        count = threads()
        if count == 1 or not _cores.acquire(blocking=False):
            return self.serial(first, *others)
        try:
            numba.set_num_threads(count)
            return self.parallel(first, *others)
        finally:
            _cores.release()


def on_cores(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function whose `numba.prange` is over bands of rows, such that all cores take part."""
    assert isinstance(function, FunctionType)
    return _OnCores(function)
