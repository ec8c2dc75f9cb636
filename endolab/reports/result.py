"""A result as a folder of files."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from endolab.depth.result import Result
from endolab.io.atomic import PathLike, as_json, staged_folder, write_atomically
from endolab.io.images import write_figure
from endolab.io.surfaces import save_depth, write_cloud, write_mesh
from endolab.plots.contents import Page, page_of
from endolab.plots.scales import DECIDERS, in_colour
from endolab.reconstruction.assumptions import meaning
from endolab.reconstruction.mesh import make_mesh
from endolab.reconstruction.scale import scale_of
from endolab.reports.draughtsman import drawn

if TYPE_CHECKING:
    from endolab.preprocessing.prepare import Prepared
    from endolab.uncertainty.trust import Trust


Task = Callable[[Path], object]  # writes one output into a folder


def report(
    result: Result, clock: Mapping[str, Any] | None = None, trust: Trust | None = None
) -> dict[str, Any]:
    """What `report.json` holds: status, energy, settings, the range of distances and what they mean.

    `clock` tells where the time of the whole command went, `trust` how far the distances can be trusted.
    """
    known = result.distance[result.mask]
    photometry, curve = result.problem.photometry, result.problem.origin.lam_curve
    return {
        "status": result.status.name,
        "ended": result.status.value,
        "iterations": result.iterations,
        "energy": result.energy,
        "terms": dict(result.iterate.terms),
        "seconds": result.seconds,
        "stages": [asdict(stage) for stage in result.stages],
        **({} if clock is None else {"clock": dict(clock)}),
        "unit": result.problem.unit,
        "metric": result.metric,
        "scale": scale_of(result),
        "meaning": list(meaning(result)),
        "distance": {
            "median": float(np.median(known)),
            "least": float(known.min()),
            "greatest": float(known.max()),
        },
        **({} if trust is None else {"trust": trusted(result, trust)}),
        "pixels": int(known.size),
        "photometry": {"k": photometry.k, "gamma": photometry.gamma, "gain": photometry.gain},
        "settings": result.problem.settings,
        **({} if curve is None else {"lam_curve": curve.numbers}),
    }


def trusted(result: Result, trust: Trust) -> dict[str, Any]:
    """Sum a `Trust` up in numbers, in % of the distance; of pixels, percentiles and medians."""
    inside = result.mask
    low, middle, high = np.percentile(100 * (trust.sigma / result.distance)[inside], [10, 50, 90])
    decided = trust.decided_by[inside]
    return {
        "sigma_percent": {"10th": float(low), "median": float(middle), "90th": float(high)},
        "sigma_shape_percent": float(np.median(100 * (trust.sigma_shape / result.distance)[inside])),
        "sigma_scale_percent": 100 * trust.sigma_scale,
        "decided_by": {name: float((decided == k).mean()) for k, name in enumerate(DECIDERS, 1)},
        "causes_percent": {name: float(100 * np.median(a[inside])) for name, a in trust.causes.items()},
        "scale_causes_percent": {name: 100 * value for name, value in trust.scales.items()},
        "factor": trust.factor,
        "draws": trust.draws,
        "status": trust.status.name,
        "notes": list(trust.notes),
    }


def result_files(mesh: bool = False, prepared: bool = False, trust: bool = False) -> tuple[str, ...]:
    """Name what `save_result` writes."""
    more = ("mesh.ply",) * mesh + ("mesh_trust.ply",) * (mesh and trust) + ("preparation.png",) * prepared
    return "cloud.ply", "depth.npz", "overview.png", "report.json", *more


def save_result(
    result: Result,
    folder: PathLike,
    *,
    mesh: bool = False,
    prepared: Prepared | None = None,
    trust: Trust | None = None,
    overwrite: bool = False,
) -> None:
    """Write `depth.npz`, `cloud.ply`, `overview.png` and `report.json` into a folder.

    Parameters
    ----------
    result : Result
    folder : path
        Made if need be. Either all files are written or none.
    mesh : bool
        Whether to write `mesh.ply` too, with triangles that are torn at folds; and, if `trust` is given,
        `mesh_trust.ply`, whose colours tell σ.
    prepared : Prepared, optional
        What `endolab.prepare` came to, to be drawn in `preparation.png`.
    trust : Trust, optional
        How far the result can be trusted, as `endolab.trust_of` tells: in `depth.npz`, `report.json` and
        `overview.png`.
    overwrite : bool
        Whether to replace files that endolab did not write there, or that were changed since.

    Raises
    ------
    OSError
        In one sentence, if they cannot be written or another file is in the way.
    """
    files = result_files(mesh, prepared is not None, trust is not None)
    with staged_folder(folder, files, overwrite=overwrite) as staging:
        write_outputs(outputs_of(result, mesh, prepared, trust=trust), staging)
        write_report(result, staging, trust=trust)


def outputs_of(
    result: Result,
    mesh: bool = False,
    prepared: Prepared | None = None,
    draw: Callable[[Page], bytes] = drawn,
    trust: Trust | None = None,
) -> dict[str, Task]:
    """Name what writes each file of a result but its report, the slowest first; `draw` draws the overview.

    They share nothing but the result, so that they can be written at the same time.
    """
    page = page_of(result, trust=trust)
    colour, inside = in_colour(result.problem.shown), result.mask

    def write_figures(folder: Path) -> None:
        write_atomically(folder / "overview.png", draw(page))
        if prepared is not None:
            from endolab.plots.preparation import prepare_figure

            write_figure(folder / "preparation.png", prepare_figure(prepared, result))

    def write_points(folder: Path) -> None:
        write_cloud(folder / "cloud.ply", result.points[inside], result.normals[inside], colour[inside])

    tasks: dict[str, Task] = {"overview.png": write_figures}
    tasks["depth.npz"] = lambda folder: save_depth(folder / "depth.npz", result, result.metric, trust)
    tasks["cloud.ply"] = write_points
    if mesh:
        tasks["mesh.ply"] = lambda folder: write_mesh(folder / "mesh.ply", make_mesh(result))
        if trust is not None:
            coloured = "mesh_trust.ply"
            tasks[coloured] = lambda folder: write_mesh(folder / coloured, make_mesh(result, trust=trust))
    return tasks


def write_outputs(tasks: Mapping[str, Task], folder: Path) -> dict[str, float]:
    """Write outputs at the same time, and return the seconds that each took; the first error is raised.

    The first is written by this thread. Files, compression and who else draws leave Python to the others.
    """

    def timed(task: Task) -> float:
        started = time.perf_counter()
        task(folder)
        return time.perf_counter() - started

    first, *others = tasks
    with ThreadPoolExecutor() as pool:
        jobs = {name: pool.submit(timed, tasks[name]) for name in others}
        return {first: timed(tasks[first])} | {name: job.result() for name, job in jobs.items()}


def write_report(
    result: Result, folder: Path, clock: Mapping[str, Any] | None = None, trust: Trust | None = None
) -> None:
    """Write `report.json` into a folder; parameters as of `report`."""
    write_atomically(folder / "report.json", as_json(report(result, clock, trust)))
