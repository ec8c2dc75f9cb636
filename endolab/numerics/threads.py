"""Compiled loops on several cores: how many, and who may use them.

A loop of `on_cores` does the rows that it is told to, and what it writes does not depend on who does the
others. So its results are the same, bit for bit, on any number of threads.

As many threads as this process has cores are used, or as `ENDOLAB_THREADS` says, or fewer inside
`limit_threads`. Joblib tells its workers their share of the cores by `NUMBA_NUM_THREADS`. Where two
threads of one process solve at once, one has the cores and the other goes on by itself.

BLAS takes one thread inside `limit_threads`. Its products are small here, and its other threads would go on
spinning after each, on the cores that loops want: a picture of 320 px takes a fifth longer then.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache, wraps
from typing import Any

import numba
from threadpoolctl import ThreadpoolController

from endolab.numerics.arrays import Span
from endolab.numerics.checks import check_int
from endolab.numerics.compiled import kernel

THREADS_VARIABLE = "ENDOLAB_THREADS"
BAND_ROWS = 16  # of a band, see `on_cores`

_limit: ContextVar[int | None] = ContextVar("limit", default=None)
_cores = threading.Lock()
_blas_is_held = threading.Lock()


@cache
def cores() -> int:
    """How many cores this process may keep busy, by its affinity and its container's share of time."""
    import joblib  # a twentieth of a second, which small frames do without

    return int(joblib.cpu_count())


def threads() -> int:
    """How many threads compiled loops take; ValueError if `ENDOLAB_THREADS` is no such number."""
    limit = _limit.get()
    wanted = os.environ.get(THREADS_VARIABLE)
    most = int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
    count = min(cores(), most)
    if wanted:
        if not (wanted.isascii() and wanted.isdigit() and int(wanted) > 0):
            raise ValueError(
                f"{THREADS_VARIABLE} must be a positive number of threads, found {wanted!r}"
            )
        count = min(int(wanted), most)
    return count if limit is None else min(count, limit)


@cache
def _blas() -> ThreadpoolController:
    return ThreadpoolController().select(user_api="blas")


@contextmanager
def _one_blas_thread() -> Iterator[None]:
    """Hold BLAS to one thread, if nobody does so: its number of threads is the whole process's."""
    if not _blas_is_held.acquire(blocking=False):
        yield
        return
    try:
        with _blas().limit(limits=1):
            yield
    finally:
        _blas_is_held.release()


@contextmanager
def limit_threads(count: int | None) -> Iterator[None]:
    """Take at most so many threads inside, BLAS one; None: as many as outside.

    ValueError if it is no positive number.
    """
    token = _limit.set(_limit.get() if count is None else check_int("threads", count, 1))
    try:
        with _one_blas_thread():
            yield
    finally:
        _limit.reset(token)


@cache
def _pool(_process: int) -> ThreadPoolExecutor:
    """The threads of a process: one that was forked has those of its parent no more."""
    return ThreadPoolExecutor(max(cores() - 1, 1))


def on_cores(cost: float) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Compile loop(rows, map, ...), such that all cores take part where that is worth it.

    `rows` are the first and the one after the last that it is to do, of as many as the map has. `cost` is
    what it takes for a pixel, about, in nanoseconds.
    """

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        loop = kernel(function)

        @wraps(function)
        def on_all_rows(first: Any, *others: Any) -> None:
            rows = first.shape[-2]
            # So many ns a turn must take, or waking a second core, 50 µs or more, does not pay.
            is_worth_it = rows * first.shape[-1] * cost >= 300_000
            count = threads() if is_worth_it else 1
            if count == 1 or not _cores.acquire(blocking=False):
                loop((0, rows), first, *others)
                return
            step = -(-rows // (BAND_ROWS * count)) * BAND_ROWS
            parts = [(start, min(start + step, rows)) for start in range(0, rows, step)]
            try:
                submit = _pool(os.getpid()).submit
                helped = [submit(loop, part, first, *others) for part in parts[1:]]
                try:
                    loop(parts[0], first, *others)
                finally:
                    wait(helped)
                for done in helped:
                    done.result()  # or what it raised, such as that memory ran out
            finally:
                _cores.release()

        return on_all_rows

    return decorate


@kernel
def rows_within(rows: Span, first: int, last: int) -> Span:
    """Rows that are to be done, of those from `first` to before `last`."""
    return max(rows[0], first), min(rows[1], last)
