"""Many reconstructions as one table: λ × ξ × order × frame, on as many cores or machines as there are."""

import itertools
import math
import os
import re
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import joblib

from endolab.batch.table import MEASURED, Row, measure_result, write_rows
from endolab.frames.frame import Frame
from endolab.io.atomic import PathLike, check_new, check_writable
from endolab.io.images import read_frame
from endolab.io.surfaces import read_depth
from endolab.metrics.depth_errors import compare, resample_truth
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import list_of
from endolab.numerics.iteration import Status, finish
from endolab.reconstruction.found import Found
from endolab.reconstruction.pipeline import find, reconstruct, solve_found
from endolab.reconstruction.problem_of_frame import check_frame
from endolab.reconstruction.settings import Settings
from endolab.solvers.result import Result
from endolab.solvers.solvers import DEFAULT_SOLVER

ERRORS = ("mean_mm", "median_mm", "mean_percent", "median_percent", "mean_degrees")
SWEEP_COLUMNS = (
    "frame",
    "xi",
    "regulariser",
    "lam",
    "solver",
    "options",
    "found",
    "status",
    *MEASURED,
    *ERRORS,
    "error",
)
Truth = tuple[FloatArray, FloatArray | None] | FloatArray | PathLike


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
    overwrite: bool = False,
    recording: PathLike | None = None,
    anew: bool = False,
    n_jobs: int | None = None,
    progress: Callable[[int, int, Row], object] | None = None,
    **options: Any,
) -> list[Row]:
    """Reconstruct every frame with every setting, and write one tidy table.

    Parameters
    ----------
    frames : iterable of Frame or path
        Paths are read where the work is done.
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
        replaced whole after each reconstruction, from the first that could be made on.
    overwrite : bool
        Replace a file of that name.
    recording : path, optional
        Of the answers for one frame, to scrub through λ; a run beside the others for each ξ and regulariser.
        They are solved one after the other, with the light and the contours that the first has found.
    anew : bool
        Find them anew for each row, as without a recording. The column `found` tells: anew or held.
    n_jobs : int, optional
        How many at once, -1 for as many as cores; by default one, or what `joblib.parallel_config` says.
        They are joblib's processes, which share the cores; ``with joblib.parallel_config("dask"):`` takes
        the workers of Dask's client that is open, on other machines too.
    progress : callable, optional
        Called as ``progress(done, total, row)`` after each reconstruction.

    Returns
    -------
    list of dict
        The rows, in order, a value that is not known as nan.

    Raises
    ------
    ValueError, OSError
        In one sentence, if the table or the recording is there already or cannot be written, if a recording
        is asked for of several frames, or if no row could be made; then there is neither.

    Examples
    --------
    >>> import endolab as el
    >>> sample = el.load_traced("matt")  # a frame that comes with endolab
    >>> rows = el.sweep([sample.frame], sample.calibration, lam=[0.1, 1.0], width=96, table="sweep.csv")
    >>> [(row["lam"], row["status"]) for row in rows]
    [(0.1, 'SETTLED'), (1.0, 'CONVERGED')]
    """
    frames = list_of("frames", "frames", frames)
    truths = [None] * len(frames) if truth is None else list_of("truths", "truth", truth)
    calls = []
    for (frame, true), *energy in itertools.product(
        zip(frames, truths, strict=True),
        list_of("words", "xi", xi),
        list_of("words", "regulariser", regulariser),
        list_of("numbers", "lam", lam),
    ):
        setting = dict(zip(("xi", "regulariser", "lam"), energy, strict=True))
        setting["solver"] = solver
        Settings.of(setting | options)  # refused now, rather than in a row
        calls.append((frame, true, calibration, setting, options))
    read = [one for one in (*frames, *truths) if isinstance(one, str | os.PathLike)]
    check_new(table, overwrite, read)
    check_writable(table)
    answers: Any = nullcontext()
    if recording is not None:
        if len(frames) != 1:
            raise ValueError(f"a recording is of one frame, got {len(frames)}")
        check_new(recording, overwrite)
        from endolab.workbench.recording.recorder import record_lambda  # Rerun is asked for

        shown = None if truths[0] is None else _read_truth(truths[0])[0]
        answers = record_lambda(recording, shown)
        n_jobs = 1
    rows: list[Row] = []
    solve = joblib.delayed(_solve_row)
    parallel = joblib.Parallel(
        n_jobs, return_as="generator", initializer=_end_with, initargs=(os.getpid(),)
    )
    with answers as recorder:
        several = len({(call[3]["xi"], call[3]["regulariser"]) for call in calls}) > 1
        recorded = None if recorder is None else _RecordedSweep(recorder, anew, several)
        for row in parallel(solve(*call, recorded) for call in calls):
            if row["status"] == Status.STOPPED.name:
                raise KeyboardInterrupt  # the user's, which ends more than this row
            rows.append(row)
            made = [row for row in rows if not row["error"]]
            if made:
                write_rows(table, SWEEP_COLUMNS, rows)
            if progress is not None:
                progress(len(rows), len(calls), row)
        if not made:
            raise ValueError(f"no row could be made; the first: {rows[0]['error']}")
    return rows


def _read_truth(truth: Truth) -> tuple[FloatArray, FloatArray | None]:
    """Distances, and normals if they are known."""
    if isinstance(truth, str | os.PathLike):
        maps = read_depth(truth, ("distance",))
        return maps["distance"], maps.get("normals")
    return truth if isinstance(truth, tuple) else (truth, None)


def _end_with(parent: int) -> None:
    """End this process when the one that it works for is gone; joblib's own would work on for nobody."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.2)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@dataclass(eq=False)
class _RecordedSweep:
    """Solves the rows of a recording one after the other."""

    recorder: Any
    anew: bool
    several: bool  # ξ or regularisers, each with a run of its own
    runs: dict[str, Any] = field(default_factory=dict)
    found: Found | None = None  # light and contours, by the last row that found its own

    def solve(self, frame: Frame, calibration: Calibration, **options: Any) -> Result:
        """Solve as `reconstruct` does, or with what was found, and record the answer."""
        calibration = calibration.for_size(frame.width, frame.height)
        if self.anew or self.found is None:
            settings = Settings.of(options)
            check_frame(frame, calibration, settings)
            self.found = finish(find(frame, calibration, settings))
        asked = {name: options[name] for name in options.keys() - {"width", "cuts"}}
        result = solve_found(self.found, calibration, **asked)
        name = re.sub(r"\W", "_", "{regulariser} xi {xi}".format(**options))
        if name not in self.runs:
            self.runs[name] = self.recorder.run(name) if self.several else self.recorder
        self.runs[name](replace(result.iterate, k=0, stage="sweep"))
        return result


def _solve_row(
    frame: Frame | PathLike,
    truth: Truth | None,
    calibration: Calibration,
    setting: Row,
    options: dict[str, Any],
    recorded: _RecordedSweep | None,
) -> Row:
    """Make one row; runs in a worker."""
    row: Row = dict.fromkeys(SWEEP_COLUMNS, math.nan)
    row |= setting | {"status": "", "error": ""}
    row["frame"] = frame.name if isinstance(frame, Frame) else Path(frame).name
    row["options"] = " ".join(f"{name}={options[name]}" for name in sorted(options))
    started = time.perf_counter()
    try:
        picture = frame if isinstance(frame, Frame) else read_frame(frame, calibration)
        before = recorded.found if recorded else None
        solve = recorded.solve if recorded else reconstruct
        result = solve(picture, calibration, **setting, **options)
        row["found"] = "held" if recorded and recorded.found is before else "anew"
        row |= measure_result(result) | {"seconds": time.perf_counter() - started}
        if truth is not None:
            distance, normals = _read_truth(truth)
            shape = result.mask.shape
            errors = compare(
                result.distance,
                resample_truth(distance, shape),
                result.problem.field.cos_alpha,
                normals=result.normals,
                true_normals=None if normals is None else resample_truth(normals, shape),
                align="none" if result.metric else "scale",
            )
            row |= {name: getattr(errors, name) for name in ERRORS}
    except (ValueError, OSError, MemoryError) as error:
        row["error"] = " ".join(str(error).split()) or "out of memory"
    return row
