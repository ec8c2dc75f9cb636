"""The command that compares depth maps with the truth."""

import json
import os
from typing import Annotated, Any, Literal

from cyclopts import Parameter


def evaluate(
    depth: str,
    truth: str,
    /,
    *,
    align: Literal["none", "scale", "affine"] | None = None,
    kind: Literal["z", "distance", "disparity"] | None = None,
    unit: float | None = None,
    truth_kind: Literal["z", "distance", "disparity"] | None = None,
    truth_unit: float | None = None,
    calibration: str | None = None,
    mask: str | None = None,
    max_angle: float = 90.0,
    max_depth: float | None = None,
    as_json: Annotated[bool, Parameter(name="--json")] = False,
) -> None:
    """Compare a depth map, or those of a folder, with the truth.

    - endolab evaluate result/depth.npz sim/truth.npz
    - endolab evaluate result/depth.npz sim/truth.npz --max-angle 60 --json
    - endolab evaluate result/depth.npz 0001_depth.png --align scale
    - endolab evaluate predictions truths --unit 1000 --calibration cal.json

    Parameters
    ----------
    depth : path
        depth.npz, .npy, .npz, .png, .tif, .pfm, .bin, .csv, .txt of any program, or a folder.
    truth : path
        The same, or a depth map of a published data set.
    align : str
        By the median of d*/d (default for relative units), or also a shift.
    kind : str
        What the depth map holds, if no name says so (z); a disparity is aligned as such.
    unit : float
        Millimetres that 1 in it stands for; without it, it is relative.
    truth_kind : str
        The same of the truth.
    truth_unit : float
        The same of the truth (1).
    calibration : path
        endoscope.json, or a name: turns z into distance.
    mask : path
        A picture, bright where it counts, of the truth's size.
    max_angle : float
        Only pixels this near the axis, degrees.
    max_depth : float
        Only pixels whose truth is not farther, mm.
    as_json : bool
        Print JSON.
    """
    import numpy as np

    import endolab as el

    is_folder = os.path.isdir(depth)
    compare = el.evaluate_folder if is_folder else el.evaluate
    made: Any = compare(
        depth,
        truth,
        kind=kind,
        unit=unit,
        truth_kind=truth_kind,
        truth_unit=truth_unit,
        camera=None if calibration is None else el.load_calibration(calibration).camera,
        mask=mask,
        align=align,
        max_angle=max_angle,
        max_depth=max_depth,
    )
    found, alone = made if is_folder else ([made], [])
    if as_json:
        frames = [one.as_dict() for one in found]
        content = {"frames": frames, "without_partner": alone} if is_folder else frames[0]
        print(json.dumps(content, indent=2))
        return
    columns = {
        "mean_percent": "AbsRel %",
        "median_percent": "median %",
        "rmse_mm": "RMSE mm",
        "rmse_z_mm": "RMSE z mm",
        "within_125": "δ<1.25 %",
        "within_125_squared": "δ<1.25² %",
        "within_125_cubed": "δ<1.25³ %",
        "mean_degrees": "normals °",
        "scale": "scale",
    }
    rows = {one.name: [getattr(one.errors, name) for name in columns] for one in found}
    if is_folder:
        values = [*rows.values()]
        rows |= {"mean": np.mean(values, axis=0), "median": np.median(values, axis=0)}
    wide = max(map(len, rows))
    print(" " * wide + "".join(f"{title:>11}" for title in columns.values()))
    for label, row in rows.items():
        print(f"{label:<{wide}}" + "".join(f"{value:>11.4g}" for value in row))
    for one in found:
        if one.coverage is not None:
            line = "{within_one:.0f} % within 1 σ, {within_two:.0f} % within 2 σ (68 and 95 if right)"
            print(line.format(**vars(one.coverage)))
    if alone:
        print(f"{len(alone)} without a partner: {', '.join(alone)}")
