"""How far depth maps in files, of any program, are from the truth."""

import json
import logging
import re
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from endolab.frames.frame import check_size
from endolab.io.atomic import PathLike
from endolab.io.datasets.published import depth_layout
from endolab.io.depth_maps import SUFFIXES, TEXTS, DepthMap, read_depth_map
from endolab.io.images import read_mask
from endolab.metrics.coverage import Coverage, coverage_of
from endolab.metrics.depth_errors import (
    Errors,
    compare,
    known_in_all,
    rank_correlation,
    resample_truth,
)
from endolab.model.cameras import Camera
from endolab.numerics.checks import PATH, mask_array, number

log = logging.getLogger("endolab")


@dataclass(frozen=True)
class Evaluation:
    """How far a depth map is from the truth."""

    name: str  # of the depth map; in a folder, the path from there
    kind: str  # of what is compared, and `errors` are of: "distance", or "z" if no camera is known
    align: str  # as of `compare`
    rank_correlation: float  # of depth map and truth; nan if either is constant
    errors: Errors
    coverage: Coverage | None  # of the depth map's σ, if it has one

    def as_dict(self) -> dict[str, Any]:
        """Return it as JSON can hold it; None for what is not known."""
        own = {"depth": self.name, "kind": self.kind, "align": self.align}
        facts = asdict(self.errors) | own | {"rank_correlation": self.rank_correlation}
        if self.coverage is not None:
            facts["coverage"] = asdict(self.coverage)
        known: dict[str, Any] = json.loads(json.dumps(facts), parse_constant=lambda _: None)
        return known


def evaluate(
    prediction: PathLike | np.ndarray,
    truth: PathLike | np.ndarray,
    *,
    kind: str | None = None,
    unit: float | None = None,
    truth_kind: str | None = None,
    truth_unit: float | None = None,
    camera: Camera | None = None,
    mask: PathLike | np.ndarray | None = None,
    align: str | None = None,
    max_angle: float = 90.0,
    max_depth: float | None = None,
) -> Evaluation:
    """Compare a depth map with the truth, which may be a data set's.

    Parameters
    ----------
    prediction, truth : path or (H, W) array
        What `read_depth_map` reads.
    kind, unit, truth_kind, truth_unit : optional
        As for `read_depth_map`. A truth without a unit is in mm. One number that the farthest hundredth of it
        has, 1.2 times the next or more, is unknown, which is logged.
    camera : Camera, optional
        Of the picture, of any size of its proportions. Needed if one file holds z and the other distance, and
        neither both; without any, z is compared with z.
    mask : path or (H, W) array, optional
        Of the truth's size: a picture, bright where it counts, or bool, 0 and 1, or whole numbers.
    align : {"none", "scale", "affine"}, optional
        As for `compare`, disparities as disparities; scale by default for a depth map without a unit, else
        none. A disparity is compared as z, what is affine as the kind that it is.
    max_angle : float
        Only pixels so near to the camera's axis count, degrees.
    max_depth : float, optional
        Only pixels whose truth is at most this count, mm, of whichever kind the truth is.

    Returns
    -------
    Evaluation

    Raises
    ------
    OSError, ValueError
        In one sentence, if a file cannot be read, the two are not of one picture, a camera or a unit is
        missing, or a unit leads to what no endoscope sees.

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
    name, true_name = (
        what if isinstance(given, np.ndarray) else str(given)
        for given, what in ((prediction, "the depth map"), (truth, "the truth"))
    )
    depth = read_depth_map(prediction, kind, unit)
    layout = None if truth_kind or truth_unit else depth_layout(true_name)
    if layout is None:
        true = read_depth_map(truth, truth_kind, truth_unit)
        _leave_out_largest(true, true_name)
    else:
        true = DepthMap(layout.read_depth(true_name)[0], "z", True)
        _warn_of_unit(Path(true_name).parent, layout.name.upper())
        true_name += f", by its name in the unit of {layout.name.upper()}"
    _check_unit(true, true_name, "--truth-unit")
    if depth.metric and depth.cos_alpha is None:
        _check_unit(depth, name, "--unit")
    if max_depth is not None:
        true.values[true.values > number("--max-depth", max_depth, 0)] = np.nan
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
            f"{name} holds {depth.kind}, the truth {true.kind}, and no camera: give one (--calibration)"
        )
    if mask is not None:
        inside = read_mask(mask) if isinstance(mask, PATH) else mask_array("mask", mask)
        if inside.shape != true.values.shape:
            rows, columns = true.values.shape
            raise ValueError(f"the mask must have the truth's size, {columns}x{rows} px")
        true.values[~inside] = np.nan
    align = align or ("none" if depth.metric else "scale")
    if align == "none" and not depth.metric:
        raise ValueError(
            f"{name} is in relative units: compare it with --align scale, or say its --unit"
        )
    is_plain = not depth.is_inverse and align != "affine"
    compared = "distance" if is_plain and cosine is not None else depth.kind
    if cosine is None:
        cosine = np.full(shape, np.nan)
    factor = cosine if compared == "z" else 1 / cosine
    estimate = depth.values if depth.kind == compared else depth.values * factor
    actual = resample_truth(true.values, shape)
    if true.kind != compared:
        actual = actual * factor
    # nan, where nobody asked for the angle, counts.
    near = ~(cosine < np.cos(np.deg2rad(number("--max-angle", max_angle, 0, 180))))
    errors = compare(
        estimate,
        actual,
        np.ones(shape) if compared == "z" else cosine,
        mask=near,
        align=align,
        as_disparity=depth.is_inverse,
        normals=depth.normals,
        true_normals=None if true.normals is None else resample_truth(true.normals, shape),
    )
    known = known_in_all(near, prediction=estimate, truth=actual)
    correlation = rank_correlation(estimate[known], actual[known])
    if correlation < -0.1:
        other = "z" if depth.is_inverse else "disparity"
        message = (
            "%s falls where the truth rises (rank correlation %.2f): it may be of --kind %s"
        )
        log.warning(message, name, correlation, other)
    trusted = None
    if depth.sigma is not None and align != "affine":
        trusted = coverage_of(estimate, depth.sigma, actual, near, align)
    return Evaluation(name, compared, align, correlation, errors, trusted)


def _leave_out_largest(true: DepthMap, name: str) -> None:
    """Make unknown the one largest number, if many pixels have it and it lies far beyond the next."""
    two = np.unique(true.values[np.isfinite(true.values)])[-2:]
    is_most = true.values == two[-1:].max(initial=0)
    if len(two) == 2 and is_most.mean() >= 0.01 and two[1] >= 1.2 * two[0]:
        true.values[is_most] = np.nan
        message = (
            "%s: %.3g %% of it has one number, far beyond all others, and counts as unknown"
        )
        log.warning(message, name, 100 * is_most.mean())


@lru_cache(maxsize=1)  # once for a folder
def _warn_of_unit(folder: Path, data_set: str) -> None:
    message = "%s: the truth is, by its name, in the unit of %s; --truth-unit says another"
    log.warning(message, folder, data_set)


def _check_unit(depth: DepthMap, name: str, option: str) -> None:
    median = np.nanmedian(depth.values) if np.isfinite(depth.values).any() else 2
    if not 2 <= median <= 1000:
        raise ValueError(
            f"{name}: its median is {median:.3g} mm, and endoscopes see 2 to 1000: "
            f"{option} is the mm that 1 stands for"
        )


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
    alone = sorted(left.keys() ^ right.keys())
    return made, [str((left | right)[key]) for key in alone]


def _find_maps(folder: Path) -> dict[str, Path]:
    """Find the files of a folder that may be depth maps, by their paths from there without a suffix."""
    files = sorted(folder.rglob("*"))
    own = [p for p in files if depth_layout(p) or p.name in ("depth.npz", "truth.npz")]
    maps, rows = (
        [p for p in files if p.suffix.lower() in kinds] for kinds in (SUFFIXES, TEXTS)
    )
    found = own or maps or rows  # text may be notes beside them
    return {p.relative_to(folder).with_suffix("").as_posix(): p for p in found}


def _by_number(maps: dict[str, Path]) -> dict[str, Path]:
    """Find depth maps by the last number of their names, or by their names where there is none."""
    found = {
        (re.findall(r"0*(\d+)", name) or [name])[-1]: path for name, path in maps.items()
    }
    if len(found) < len(maps):
        raise ValueError(f"{next(iter(maps.values()))}: another depth map has its number")
    return found
