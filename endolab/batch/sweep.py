"""Many reconstructions as one table: λ × ξ × order × frame, on as many cores or machines as there are."""

import itertools
import math
import os
import time
import warnings
import zlib
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError
from contextlib import closing, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from endolab._extras import MissingPackage
from endolab.batch.table import MEASURED, Row, measure_result, read_rows, write_rows
from endolab.batch.workers import end_with
from endolab.frames.frame import Frame
from endolab.io.atomic import PathLike, as_json
from endolab.io.images import read_frame
from endolab.io.surfaces import read_depth
from endolab.metrics.depth_errors import compare, resample_truth
from endolab.model.endoscope import Calibration
from endolab.model.schema import unknown_name
from endolab.model.surface import check_xi
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import number
from endolab.numerics.iteration import Status
from endolab.reconstruction.reconstruct import reconstruct
from endolab.solvers.problem import REGULARISERS
from endolab.solvers.result import Result
from endolab.solvers.solvers import DEFAULT_SOLVER, check_solver_options

KEY = ("frame", "xi", "regulariser", "lam", "solver", "options")
ERRORS = ("mean_mm", "median_mm", "mean_percent", "median_percent", "mean_degrees")
SWEEP_COLUMNS = (*KEY, "status", *MEASURED, *ERRORS, "error")

Truth = tuple[FloatArray, FloatArray | None] | FloatArray | PathLike
Task = tuple[Row, Frame | PathLike, Truth | None]


def sweep(
    frames: Iterable[Frame | PathLike],
    calibration: Calibration,
    *,
    lam: Iterable[float] = (1.0,),
    xi: Iterable[str] = ("1/d",),
    regulariser: Iterable[str] = ("auto",),
    solver: str = DEFAULT_SOLVER,
    truth: Sequence[Truth] | None = None,
    table: PathLike = "sweep.csv",
    n_jobs: int = 1,
    backend: str = "loky",
    progress: Callable[[int, int, Row], object] | None = None,
    **options: Any,
) -> list[Row]:
    """Reconstruct every frame with every setting, and write one tidy table.

    Parameters
    ----------
    frames : iterable of Frame or path
        Their names tell the rows apart, so that no two may be alike. Paths are read where the work
        is done.
    calibration : Calibration
        Of all frames.
    lam, xi, regulariser : iterables
        Values of these settings of `endolab.reconstruct`, each with each.
    solver, **options
        The same for all, see `endolab.reconstruct`; the column `options` tells them.
    truth : sequence, optional
        For each frame the true distances (H, W), mm, or a pair of these and the normals (H, W, 3),
        or the path of a ``truth.npz``; resampled if the frame is shrunk.
    table : path
        CSV with the columns `SWEEP_COLUMNS`, a row for every reconstruction: errors in mm, % and degrees
        (of results in relative units after scaling by the median); an error is one sentence. It is
        replaced whole after each reconstruction. Rows that are there already are not made again,
        but for those with an error and those that lack a truth which is given now; other rows of
        it are kept. A checksum in the column `options` tells calibrations apart.
    n_jobs, backend
        How many at once, -1 for as many as cores, and by what: ``"loky"``, joblib's processes, which share
        the cores; ``"threading"``; or ``"dask"``, by workers here, or those of the client that is open or
        of the scheduler that ``DASK_SCHEDULER_ADDRESS`` names.
    progress : callable, optional
        Called as ``progress(done, total, row)`` after each reconstruction.

    Returns
    -------
    list of dict
        The rows asked for, in order, a value that is not known as nan.

    Raises
    ------
    ValueError, OSError
        In one sentence, if the table is none of ours or cannot be written, if frames share a name,
        or if there is nothing to do. What is in the table stays.

    Examples
    --------
    >>> import endolab as el
    >>> sample = el.load_traced("matt")  # a frame that comes with endolab
    >>> rows = el.sweep([sample.frame], sample.calibration, lam=[0.1, 1], width=96, table="sweep.csv")
    >>> [(row["lam"], row["status"]) for row in rows]
    [(0.1, 'CONVERGED'), (1.0, 'CONVERGED')]
    """
    check_solver_options(solver, {})
    backends = ("loky", "threading", "dask")
    if backend not in backends:
        raise unknown_name("backend", backend, backends)
    if n_jobs == 0:
        raise ValueError(
            "n_jobs (--jobs) must be at least 1, or -1 for as many as cores, got 0"
        )
    xi = [check_xi(name) for name in xi]
    regulariser = list(regulariser)
    for name in regulariser:
        if name not in ("auto", *REGULARISERS):
            raise unknown_name("regulariser", name, REGULARISERS)
    fixed = {name: value for name, value in sorted(options.items()) if value is not None}
    fixed = {"calibration": _checksum(calibration)} | fixed
    last = solver, " ".join(f"{name}={value}" for name, value in fixed.items())
    weights = map(partial(number, "lam"), lam)
    settings = list(itertools.product(*map(dict.fromkeys, (xi, regulariser, weights))))
    tasks = [
        (dict(zip(KEY, (name, *setting, *last), strict=True)), frame, known)
        for name, frame, known in _name_frames(list(frames), truth)
        for setting in settings
    ]
    if not tasks:
        raise ValueError("a sweep needs at least one frame, lam, xi and regulariser")
    target = Path(table)
    rows = read_table(target) if os.path.lexists(target) else {}
    # Of a row, whoever is done first.
    place = {_key(task[0]): number for number, task in enumerate(tasks)}

    def write() -> None:
        write_rows(
            target,
            SWEEP_COLUMNS,
            (rows[key] for key in sorted(rows, key=lambda key: place.get(key, -1))),
        )

    todo = [
        task
        for task in tasks
        if _is_unfinished(rows.get(_key(task[0])), task[2] is not None)
    ]
    total = len(tasks)
    done = total - len(todo)
    # Its ray field stays here.
    calibration = replace(calibration, camera=replace(calibration.camera))
    solve = partial(_solve_row, calibration=calibration, options=options)
    write()  # now, rather than after an hour's run
    try:
        rows_made = (
            _by_dask(todo, solve)
            if backend == "dask"
            else _by_joblib(todo, solve, n_jobs, backend)
        )
        with closing(rows_made):
            for row in rows_made:
                if row["status"] == Status.STOPPED.name:
                    raise KeyboardInterrupt  # the user's, which ends more than this row
                rows[_key(row)] = row
                write()
                done += 1
                if progress is not None:
                    progress(done, total, row)
    except (KeyboardInterrupt, BrokenExecutor) as failure:
        so_far = f"{done} of {total} rows are in the table, the same command goes on"
        if isinstance(failure, KeyboardInterrupt):
            raise KeyboardInterrupt(f"interrupted; {so_far}") from failure
        raise OSError(
            f"a worker was lost, perhaps for want of memory; {so_far}"
        ) from failure
    return [rows[_key(task[0])] for task in tasks]


def _by_joblib(
    todo: Sequence[Task], solve: Callable[..., Row], n_jobs: int, backend: str
) -> Generator[Row]:
    """Give rows as threads, or processes which end with this one, make them."""
    import joblib

    jobs = n_jobs if n_jobs < 1 else min(n_jobs, max(1, len(todo)))  # all are started
    beginning = {"initializer": end_with, "initargs": (os.getpid(),)}  # of processes
    parallel = joblib.Parallel(
        n_jobs=jobs, backend=backend, return_as="generator_unordered", **beginning
    )
    solved = parallel(joblib.delayed(solve)(*task) for task in todo)
    try:
        yield from (row for row in solved)  # else it would be closed before what follows
    finally:
        with warnings.catch_warnings(
            action="ignore"
        ):  # joblib's: that some of it was in vain
            solved.close()


def _by_dask(todo: Sequence[Task], solve: Callable[..., Row]) -> Generator[Row]:
    """Give rows as Dask's workers make them."""
    try:
        import dask
        import distributed
    except ModuleNotFoundError as error:
        raise MissingPackage(
            f"{error.name} is not installed; pip install distributed brings it"
        ) from error
    try:
        opened: Any = nullcontext(distributed.get_client())
    except ValueError:
        scheduler = dask.config.get("scheduler-address", None)
        opened = (
            distributed.Client(scheduler)
            if scheduler
            else distributed.Client(dashboard_address=None)
        )
    with opened as client:
        futures = [client.submit(solve, *task, pure=False) for task in todo]
        try:
            for future in distributed.as_completed(futures):
                yield future.result()
        except (
            CancelledError,
            distributed.KilledWorker,
            distributed.comm.CommClosedError,
        ) as error:
            raise BrokenExecutor(str(error)) from error
        finally:
            client.cancel(futures)


def _checksum(calibration: Calibration) -> str:
    """Eight digits that tell calibrations apart, whatever they were found from."""
    return f"{zlib.crc32(as_json(replace(calibration, evidence={}).to_dict())):08x}"


def _name_frames(
    frames: list[Frame | PathLike], truth: Sequence[Truth] | None
) -> Iterator[tuple[str, Frame | PathLike, Truth | None]]:
    """Give every frame with its name, which is its own, and its truth."""
    names = [
        frame.name if isinstance(frame, Frame) else Path(frame).name for frame in frames
    ]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(
            f"two frames are called {twice[0]}: the table could not tell them apart"
        )
    truths = [None] * len(names) if truth is None else list(truth)
    if len(truths) != len(names):
        raise ValueError(
            f"expected a truth for each of {len(names)} frames, found {len(truths)}"
        )
    return zip(names, map(_absolute, frames), map(_absolute, truths), strict=True)


def _absolute(what: Any) -> Any:
    """Name a file so that workers find it, which may be in another folder."""
    return Path(what).absolute() if isinstance(what, str | os.PathLike) else what


def _key(row: Row) -> tuple[object, ...]:
    return tuple(row[name] for name in KEY)


def _is_unfinished(row: Row | None, compared: bool) -> bool:
    if row is None or row["error"] or math.isnan(row["energy"]):
        return True
    return compared and math.isnan(row["mean_percent"])


def _solve_row(
    key: Row,
    frame: Frame | PathLike,
    truth: Truth | None,
    *,
    calibration: Calibration,
    options: dict[str, Any],
) -> Row:
    """Make one row; runs in a worker."""
    row: Row = (
        key | dict.fromkeys((*MEASURED, *ERRORS), math.nan) | {"status": "", "error": ""}
    )
    started = time.perf_counter()
    energy = {name: key[name] for name in ("xi", "regulariser", "lam", "solver")}
    try:
        picture = frame if isinstance(frame, Frame) else read_frame(frame, calibration)
        result = reconstruct(picture, calibration, **energy, **options)
        errors = {} if truth is None else _errors(result, truth)
    except (ValueError, OSError, MemoryError) as error:
        return row | {"error": " ".join(str(error).split()) or "out of memory"}
    return (
        row | measure_result(result) | {"seconds": time.perf_counter() - started} | errors
    )


def _errors(result: Result, truth: Truth) -> Row:
    if isinstance(truth, str | os.PathLike):
        maps = read_depth(truth, ("distance",))
        truth = maps["distance"], maps.get("normals")
    distance, normals = truth if isinstance(truth, tuple) else (truth, None)
    shape = result.mask.shape
    cos_alpha = result.problem.field.cos_alpha
    distance = resample_truth(distance, shape)
    normals = None if normals is None else resample_truth(normals, shape)
    scale = "none" if result.metric else "median"
    errors = compare(
        result.distance,
        distance,
        cos_alpha,
        normals=result.normals,
        true_normals=normals,
        scale=scale,
    )
    return {name: getattr(errors, name) for name in ERRORS}


def read_table(path: PathLike) -> dict[tuple[object, ...], Row]:
    """Read a table that `sweep` wrote: rows by their key, the values of `KEY`; an empty cell is nan.

    ValueError or OSError in one sentence, if it cannot be read or is another table.
    """
    words = ("frame", "xi", "regulariser", "solver", "options", "status", "error")
    return {_key(row): row for row in read_rows(path, SWEEP_COLUMNS, words)}
