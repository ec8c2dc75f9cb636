"""A result as a folder of files."""

from dataclasses import asdict
from typing import Any

import numpy as np

from endolab.io.atomic import (
    PathLike,
    as_json,
    say_undrawn,
    stage_folder,
    write_atomically,
)
from endolab.io.descriptions import write_calibration
from endolab.io.images import write_figure
from endolab.io.surfaces import save_depth, write_mesh
from endolab.model.mesh import Mesh
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import PATH, check_kinds
from endolab.reconstruction.report import meaning, warnings
from endolab.reconstruction.scale import scale_of
from endolab.reconstruction.uncertainty import Uncertainty
from endolab.solvers.mesh import make_mesh
from endolab.solvers.result import Result
from endolab.workbench.plots.maps import overview, prepare_figure
from endolab.workbench.plots.scales import SOURCE_COLOURS, in_colour


def report(result: Result, uncertainty: Uncertainty | None = None) -> dict[str, Any]:
    """What `report.json` holds: status, energy, settings, the range of distances and what they mean.

    `uncertainty` tells how far the distances can be trusted: in % of the distance, of pixels percentiles and
    medians.
    """
    known = result.distance[result.mask]
    problem = result.problem
    facts: dict[str, Any] = {
        "endolab": 1,
        "status": result.status.name,
        "ended": result.status.value,
        "iterations": result.iterations,
        "energy": result.energy,
        "left": result.left,
        "terms": dict(result.iterate.terms),
        "seconds": result.seconds,
        "stages": [asdict(stage) for stage in result.stages],
        "unit": problem.unit,
        "metric": result.metric,
        "scale": scale_of(result),
        "meaning": list(meaning(result)),
        "warnings": list(warnings(result)),
        "distance": _percentiles(known, median=50, least=0, greatest=100),
        "pixels": known.size,
        "field": result.report.field_seen,
        "photometry": {
            name: getattr(problem.photometry, name) for name in ("k", "gamma", "gain")
        },
        "settings": result.report.settings,
    }
    if uncertainty is not None:
        percent = 100 / result.distance
        decided = uncertainty.dominant_source[result.mask]
        causes = uncertainty.causes.items()
        facts["uncertainty"] = {
            "sigma_percent": _percentiles(
                percent * uncertainty.sigma, **{"10th": 10, "median": 50, "90th": 90}
            ),
            "sigma_shape_percent": float(np.nanmedian(percent * uncertainty.sigma_shape)),
            "sigma_scale_percent": 100 * uncertainty.sigma_scale,
            "dominant_source": {
                name: float(np.mean(decided == k))
                for k, name in enumerate(SOURCE_COLOURS, 1)
            },
            "causes_percent": {k: float(100 * np.nanmedian(part)) for k, part in causes},
            "scale_causes_percent": {k: 100 * v for k, v in uncertainty.scales.items()},
            "draws": uncertainty.draws,
            "status": uncertainty.status.name,
            "notes": list(uncertainty.notes),
        }
    return facts


def _percentiles(values: FloatArray, **which: float) -> dict[str, float]:
    found = np.nanpercentile(values, list(which.values()))
    return dict(zip(which, found.tolist(), strict=True))


@check_kinds(result=Result, folder=PATH)
def save_result(
    result: Result,
    folder: PathLike,
    *,
    mesh: bool = False,
    prepare: bool = False,
    uncertainty: Uncertainty | None = None,
    overwrite: bool = False,
    undrawn: list[str] | None = None,
) -> None:
    """Write `depth.npz`, `cloud.ply`, `overview.png`, `endoscope.json` and `report.json` into a folder.

    `endoscope.json` is the calibration as it was used: by it the result can be made again.

    Parameters
    ----------
    result : Result
    folder : path
        Made if need be. Either all files are written or none.
    mesh : bool
        Whether to write `mesh.ply`, cut at folds, and with `uncertainty` also `mesh_uncertainty.ply`,
        whose colours show σ.
    prepare : bool
        Whether to write `preparation.png`: what was solved of the frame (`endolab.prepare`).
    uncertainty : Uncertainty, optional
        What `endolab.uncertainty_of` has found, for `depth.npz`, `report.json` and `overview.png`.
    overwrite : bool
        Whether to write into a folder that holds files of others, and replace them.
    undrawn : list of str, optional
        What could not be drawn before, a sentence each (`Recorder.undrawn`), for the `warnings` of
        `report.json`. A figure that cannot be drawn is added; all else is written.

    Raises
    ------
    OSError
        In one sentence, if they cannot be written or the folder holds files of others.

    Examples
    --------
    >>> import endolab as el
    >>> sample = el.load_traced("matt")  # a frame that comes with endolab
    >>> el.save_result(el.reconstruct(sample.frame, sample.calibration, width=96, channel="green"), "out")
    >>> from pathlib import Path
    >>> sorted(path.name for path in Path("out").iterdir())
    ['cloud.ply', 'depth.npz', 'endoscope.json', 'overview.png', 'report.json']
    """
    inside = result.mask
    cloud = Mesh(
        result.points[inside],
        np.empty((0, 3), int),
        in_colour(result.problem.shown)[inside],
        result.normals[inside],
        result.problem.unit,
    )
    undrawn = [] if undrawn is None else undrawn
    with stage_folder(folder, overwrite=overwrite) as staging:
        save_depth(staging / "depth.npz", result, result.metric, uncertainty)
        with say_undrawn(staging / "overview.png", undrawn) as path:
            write_figure(path, overview(result, uncertainty=uncertainty))
        if prepare:
            with say_undrawn(staging / "preparation.png", undrawn) as path:
                write_figure(path, prepare_figure(result))
        write_mesh(staging / "cloud.ply", cloud)
        if mesh:
            write_mesh(staging / "mesh.ply", make_mesh(result))
        if mesh and uncertainty is not None:
            coloured = make_mesh(result, sigma=uncertainty.sigma)
            write_mesh(staging / "mesh_uncertainty.ply", coloured)
        if result.report.calibration is not None:
            write_calibration(result.report.calibration, staging / "endoscope.json")
        facts = report(result, uncertainty)
        facts["warnings"] += undrawn
        write_atomically(staging / "report.json", as_json(facts))
