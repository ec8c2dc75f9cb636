"""Many reconstructions as one table: λ × ξ × order × frame, on as many cores or machines as there are."""

import itertools
import math
import os
import time
import warnings
import zlib
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import ExitStack, closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import joblib

from endolab.batch.table import MEASURED, Row, measure_result, read_rows, write_rows
from endolab.batch.workers import deaf_to_interrupts, end_with
from endolab.frames.frame import Frame
from endolab.io.atomic import PathLike, as_json
from endolab.io.images import read_frame
from endolab.io.surfaces import read_depth
from endolab.metrics.depth_errors import compare, resample_truth
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import FloatArray
from endolab.numerics.iteration import Status
from endolab.reconstruction.pipeline import reconstruct
from endolab.reconstruction.settings import Settings
from endolab.solvers.result import Result
from endolab.solvers.solvers import DEFAULT_SOLVER

KEY = ("frame", "xi", "regulariser", "lam", "solver", "options")
ERRORS = ("mean_mm", "median_mm", "mean_percent", "median_percent", "mean_degrees")
SWEEP_COLUMNS = (*KEY, "status", *MEASURED, *ERRORS, "error")

Truth = tuple[FloatArray, FloatArray | None] | FloatArray | PathLike
Key = tuple[object, ...]  # the values of `KEY`
Task = tuple[Frame | PathLike, Truth | None]


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
    n_jobs: int | None = None,
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
    n_jobs : int, optional
        How many at once, -1 for as many as cores; by default one, or what `joblib.parallel_config` says.
        They are joblib's processes, which share the cores; ``with joblib.parallel_config("dask"):`` takes
        the workers of Dask's client that is open, on other machines too.
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
    [(0.1, 'SETTLED'), (1.0, 'CONVERGED')]
    """
    settings = [
        Settings.of(
            {"xi": one, "regulariser": order, "lam": weight, "solver": solver} | options
        )
        for one, order, weight in itertools.product(xi, regulariser, lam)
    ]
    given = {name: value for name, value in sorted(options.items()) if value is not None}
    given = {"calibration": _checksum(calibration)} | given
    text = " ".join(f"{name}={value}" for name, value in given.items())
    tasks: dict[Key, Task] = {}
    for (name, task), one in itertools.product(_name_frames(frames, truth), settings):
        tasks[name, one.xi, one.regulariser, one.lam, one.solver, text] = task
    if not tasks:
        raise ValueError("a sweep needs at least one frame, lam, xi and regulariser")
    target = Path(table)
    rows = read_table(target) if os.path.lexists(target) else {}
    todo = [
        key
        for key, (_, known) in tasks.items()
        if _is_unfinished(rows.get(key), known is not None)
    ]
    done = len(tasks) - len(todo)
    # Its ray field stays here.
    calibration = replace(calibration, camera=replace(calibration.camera))
    solve = partial(_solve_row, calibration=calibration, options=options)
    write_rows(target, SWEEP_COLUMNS, rows.values())  # now, rather than after an hour's run
    try:
        with closing(_solve_all(solve, {key: tasks[key] for key in todo}, n_jobs)) as made:
            for row in made:
                if row["status"] == Status.STOPPED.name:
                    raise KeyboardInterrupt  # the user's, which ends more than this row
                rows[_key(row)] = row
                write_rows(target, SWEEP_COLUMNS, rows.values())
                done += 1
                if progress is not None:
                    progress(done, len(tasks), row)
    except (KeyboardInterrupt, BrokenExecutor) as failure:
        so_far = f"{done} of {len(tasks)} rows are in the table, the same command goes on"
        if isinstance(failure, KeyboardInterrupt):
            raise KeyboardInterrupt(f"interrupted; {so_far}") from failure
        raise OSError(
            f"a worker was lost, perhaps for want of memory; {so_far}"
        ) from failure
    return [rows[key] for key in tasks]


def _solve_all(
    solve: Callable[..., Row], tasks: dict[Key, Task], n_jobs: int | None
) -> Generator[Row]:
    """Give rows as joblib's workers make them, whose processes end with this one."""
    # Of processes.
    beginning = {
        "initializer": end_with,
        "initargs": (os.getpid(),),
    }
    parallel = joblib.Parallel(n_jobs, return_as="generator_unordered", **beginning)
    with ExitStack() as ending:
        with deaf_to_interrupts():
            solved = parallel(
                joblib.delayed(solve)(key, *task) for key, task in tasks.items()
            )
            ending.callback(_close, solved)
        yield from (row for row in solved)  # else it would be closed before what follows


def _close(solved: Generator[Row]) -> None:
    # Joblib's: that some of it was in vain.
    with warnings.catch_warnings(action="ignore"):
        solved.close()


def _checksum(calibration: Calibration) -> str:
    """Eight digits that tell calibrations apart, whatever they were found from."""
    return f"{zlib.crc32(as_json(replace(calibration, evidence={}).to_dict())):08x}"


def _name_frames(
    frames: Iterable[Frame | PathLike], truth: Sequence[Truth] | None
) -> list[tuple[str, Task]]:
    """Give every frame, and its truth, with its name, which is its own."""
    pictures = [_absolute(frame) for frame in frames]
    truths = [None] * len(pictures) if truth is None else list(map(_absolute, truth))
    if len(truths) != len(pictures):
        raise ValueError(
            f"expected a truth for each of {len(pictures)} frames, found {len(truths)}"
        )
    names = [frame.name for frame in pictures]  # of a file, too
    twice = sorted(name for name in set(names) if names.count(name) > 1)
    if twice:
        raise ValueError(
            f"two frames are called {twice[0]}: the table could not tell them apart"
        )
    return list(zip(names, zip(pictures, truths, strict=True), strict=True))


def _absolute(what: Any) -> Any:
    """Name a file so that workers find it, which may be in another folder."""
    return Path(what).absolute() if isinstance(what, str | os.PathLike) else what


def _key(row: Row) -> Key:
    return tuple(row[name] for name in KEY)


def _is_unfinished(row: Row | None, compared: bool) -> bool:
    if row is None or row["error"] or math.isnan(row["energy"]):
        return True
    return compared and math.isnan(row["mean_percent"])


def _solve_row(
    key: Key,
    frame: Frame | PathLike,
    truth: Truth | None,
    *,
    calibration: Calibration,
    options: dict[str, Any],
) -> Row:
    """Make one row; runs in a worker."""
    row: Row = dict(zip(KEY, key, strict=True))
    energy = {name: row[name] for name in KEY[1:5]}
    row |= dict.fromkeys((*MEASURED, *ERRORS), math.nan) | {"status": "", "error": ""}
    started = time.perf_counter()
    try:
        picture = frame if isinstance(frame, Frame) else read_frame(frame, calibration)
        result = reconstruct(picture, calibration, **energy, **options)
        errors = {} if truth is None else _errors(result, truth)
    except (ValueError, OSError, MemoryError) as error:
        return row | {"error": " ".join(str(error).split()) or "out of memory"}
    seconds = time.perf_counter() - started
    return row | measure_result(result) | {"seconds": seconds} | errors


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


def read_table(path: PathLike) -> dict[Key, Row]:
    """Read a table that `sweep` wrote: rows by their key, the values of `KEY`; an empty cell is nan.

    ValueError or OSError in one sentence, if it cannot be read or is another table.
    """
    words = ("frame", "xi", "regulariser", "solver", "options", "status", "error")
    return {_key(row): row for row in read_rows(path, SWEEP_COLUMNS, words)}
