"""A result as a folder of files."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from endolab.depth.result import Result
from endolab.io.atomic import PathLike, as_json, staged_folder, write_atomically
from endolab.io.images import write_figure
from endolab.io.surfaces import save_depth, write_cloud, write_mesh
from endolab.plots.scales import in_colour
from endolab.reconstruction.assumptions import meaning
from endolab.reconstruction.mesh import make_mesh
from endolab.reconstruction.scale import scale_of

if TYPE_CHECKING:
    from endolab.preprocessing.prepare import Prepared


def report(result: Result) -> dict[str, Any]:
    """What `report.json` holds: status, energy, settings, the range of distances and what they mean."""
    known = result.distance[result.mask]
    photometry = result.problem.photometry
    return {
        "status": result.status.name,
        "ended": result.status.value,
        "iterations": result.iterations,
        "energy": result.energy,
        "terms": dict(result.iterate.terms),
        "seconds": result.seconds,
        "stages": [asdict(stage) for stage in result.stages],
        "unit": result.problem.unit,
        "metric": result.metric,
        "scale": scale_of(result),
        "meaning": list(meaning(result)),
        "distance": {
            "median": float(np.median(known)),
            "least": float(known.min()),
            "greatest": float(known.max()),
        },
        "pixels": int(known.size),
        "photometry": {"k": photometry.k, "gamma": photometry.gamma, "gain": photometry.gain},
        "settings": result.problem.settings,
    }


def result_files(mesh: bool = False, prepared: bool = False) -> tuple[str, ...]:
    """Name what `save_result` writes."""
    more = ("mesh.ply",) * mesh + ("preparation.png",) * prepared
    return "cloud.ply", "depth.npz", "overview.png", "report.json", *more


def save_result(
    result: Result,
    folder: PathLike,
    *,
    mesh: bool = False,
    prepared: Prepared | None = None,
    overwrite: bool = False,
) -> None:
    """Write `depth.npz`, `cloud.ply`, `overview.png` and `report.json` into a folder.

    Parameters
    ----------
    result : Result
    folder : path
        Made if need be. Either all files are written or none.
    mesh : bool
        Whether to write `mesh.ply` too, with triangles that are torn at folds.
    prepared : Prepared, optional
        What `endolab.prepare` came to, to be drawn in `preparation.png`.
    overwrite : bool
        Whether to replace files that endolab did not write there, or that were changed since.

    Raises
    ------
    OSError
        In one sentence, if they cannot be written or another file is in the way.
    """
    from endolab.plots.maps import overview
    from endolab.plots.preparation import prepare_figure

    files = result_files(mesh, prepared is not None)
    with staged_folder(folder, files, overwrite=overwrite) as staging:
        save_depth(staging / "depth.npz", result, result.metric)
        colour, inside = in_colour(result.problem.shown), result.mask
        write_cloud(staging / "cloud.ply", result.points[inside], result.normals[inside], colour[inside])
        write_atomically(staging / "report.json", as_json(report(result)))
        write_figure(staging / "overview.png", overview(result))
        if prepared is not None:
            write_figure(staging / "preparation.png", prepare_figure(prepared, result))
        if mesh:
            write_mesh(staging / "mesh.ply", make_mesh(result))
