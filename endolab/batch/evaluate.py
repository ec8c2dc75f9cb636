"""How far depth maps in files, of any program, are from the truth."""

import json
import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from endolab.frames.frame import check_size
from endolab.io.atomic import PathLike
from endolab.io.datasets.folders import depth_layout, true_z
from endolab.io.depth_maps import SUFFIXES, DepthMap, read_depth_map
from endolab.io.images import read_mask
from endolab.metrics.coverage import Coverage, coverage_of
from endolab.metrics.depth_errors import Errors, compare, resample_truth
from endolab.model.cameras import Camera
from endolab.numerics.checks import number


@dataclass(frozen=True)
class Evaluation:
    """How far a depth map is from the truth."""

    name: str  # of the depth map; in a folder, the path from there
    kind: str  # of what is compared, and `errors` are of: "distance", or "z" if no camera is known
    scale: str  # as of `compare`
    errors: Errors
    coverage: Coverage | None  # of the depth map's σ, if it has one

    def as_dict(self) -> dict[str, Any]:
        """Return it as JSON can hold it; None for what is not known."""
        facts = asdict(self.errors) | {"depth": self.name, "kind": self.kind}
        if self.coverage is not None:
            facts["coverage"] = asdict(self.coverage)
        known: dict[str, Any] = json.loads(json.dumps(facts), parse_constant=lambda _: None)
        return known


def evaluate(
    prediction: PathLike,
    truth: PathLike,
    *,
    kind: str | None = None,
    unit: float | None = None,
    truth_kind: str | None = None,
    truth_unit: float | None = None,
    camera: Camera | None = None,
    mask: PathLike | None = None,
    scale: str | None = None,
    max_angle: float = 90.0,
) -> Evaluation:
    """Compare a depth map with the truth, files that `read_depth_map` reads; the truth may be a data set's.

    Parameters
    ----------
    prediction, truth : path
    kind, unit, truth_kind, truth_unit : optional
        As for `read_depth_map`. A truth without a unit is in mm.
    camera : Camera, optional
        Of the picture, of any size of its proportions. Needed if one file holds z and the other distance, and
        neither both; without any, z is compared with z.
    mask : path, optional
        A picture of the truth's size, bright where it counts.
    scale : {"none", "median", "medians"}, optional
        As for `compare`; median by default for a depth map without a unit, else none.
    max_angle : float
        Only pixels so near to the camera's axis count, degrees.

    Returns
    -------
    Evaluation

    Raises
    ------
    OSError, ValueError
        In one sentence, if a file cannot be read, the two are not of one picture, or a camera or a unit is
        missing.

    Examples
    --------
    >>> import endolab as el
    >>> import numpy as np
    >>> np.save("depth.npy", np.full((4, 5), 0.022))  # m
    >>> np.save("truth.npy", np.full((4, 5), 20.0))  # mm
    >>> made = el.evaluate("depth.npy", "truth.npy", unit=1000)
    >>> round(made.errors.mean_percent, 6)
    10.0
    """
    depth = read_depth_map(prediction, kind, unit)
    if truth_kind is None and truth_unit is None and depth_layout(truth):
        true = DepthMap(true_z(truth), "z", True)
    else:
        true = read_depth_map(truth, truth_kind, truth_unit)
    rows, columns = shape = depth.values.shape
    cosine = depth.cos_alpha  # z over distance
    if camera is not None:
        if rows != round(camera.height * columns / camera.width):
            check_size("the depth map", (columns, rows), camera)
        cosine = camera.resize(columns, rows).field.cos_alpha
    elif cosine is None and true.cos_alpha is not None:
        cosine = resample_truth(true.cos_alpha, shape)
    if cosine is None and (depth.kind != true.kind or max_angle < 90):
        raise ValueError(
            f"{prediction} holds {depth.kind}, {truth} {true.kind}, and no camera: give one (--calibration)"
        )
    if mask is not None:
        inside = read_mask(mask)
        if inside.shape != true.values.shape:
            rows, columns = true.values.shape
            raise ValueError(f"{mask} must have the truth's size, {columns}x{rows} px")
        true.values[~inside] = np.nan
    compared = depth.kind if cosine is None else "distance"
    if cosine is None:
        cosine = np.full(shape, 1.0 if compared == "z" else np.nan)
    estimate = depth.values if depth.kind == compared else depth.values / cosine
    actual = resample_truth(true.values, shape)
    if true.kind != compared:
        actual = actual / cosine
    scale = scale or ("none" if depth.metric else "median")
    if scale == "none" and not depth.metric:
        raise ValueError(
            f"{prediction} is in relative units: compare it with --scale median, or say its --unit"
        )
    # nan, where nobody asked for the angle, counts.
    near = ~(cosine < np.cos(np.deg2rad(number("--max-angle", max_angle, 0, 180))))
    errors = compare(
        estimate,
        actual,
        cosine,
        mask=near,
        scale=scale,
        normals=depth.normals,
        true_normals=None if true.normals is None else resample_truth(true.normals, shape),
    )
    trusted = None
    if depth.sigma is not None:
        trusted = coverage_of(estimate, depth.sigma, actual, near, scale)
    return Evaluation(str(prediction), compared, scale, errors, trusted)


# Folders --------------------------------------------------------------------------------
def evaluate_folder(
    predictions: PathLike, truths: PathLike, **options: Any
) -> tuple[list[Evaluation], list[str]]:
    """Compare the depth maps of a folder with those of another, paired by name, or else by number.

    Parameters
    ----------
    predictions, truths : path
        Folders, with folders in them or not. Where there are depth maps by endolab, or of a data set by
        their names, other files beside them are left out.
    **options
        Of `evaluate`.

    Returns
    -------
    evaluations : list of Evaluation
        In the order of the names in `predictions`.
    alone : list of str
        Paths of the depth maps, in either, that have no partner.

    Raises
    ------
    OSError, ValueError
        In one sentence, as for `evaluate`, or if there is no pair.
    """
    left, right = _find_maps(Path(predictions)), _find_maps(Path(truths))
    if not left.keys() & right.keys():
        left, right = _by_number(left), _by_number(right)
    made = [evaluate(left[key], right[key], **options) for key in left if key in right]
    if not made:
        raise ValueError(
            f"no depth map in {predictions} has the name or number of one in {truths}"
        )
    alone = left.keys() ^ right.keys()
    return made, [
        str(path) for key, path in [*left.items(), *right.items()] if key in alone
    ]


def _find_maps(folder: Path) -> dict[str, Path]:
    """Find the files of a folder that may be depth maps, by their paths from there without a suffix."""
    files = [path for path in sorted(folder.rglob("*")) if path.suffix.lower() in SUFFIXES]
    own = [p for p in files if depth_layout(p) or p.name in ("depth.npz", "truth.npz")]
    return {p.relative_to(folder).with_suffix("").as_posix(): p for p in own or files}


def _by_number(maps: dict[str, Path]) -> dict[str, Path]:
    """Find depth maps by the last number of their names, or by their names where there is none."""
    found = {
        (re.findall(r"0*(\d+)", name) or [name])[-1]: path for name, path in maps.items()
    }
    if len(found) < len(maps):
        raise ValueError(f"{next(iter(maps.values()))}: another depth map has its number")
    return found
