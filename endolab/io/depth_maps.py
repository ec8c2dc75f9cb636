"""Depth maps as other programs write them: arrays of NumPy, 16-bit pictures, TIFF of floats."""

import io
import logging
import re
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from endolab.io.atomic import PathLike, name_damage, read_bytes
from endolab.io.images import quiet, read_stored
from endolab.io.surfaces import read_arrays, read_depth
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import shorten, unknown_name

SUFFIXES = (".npz", ".npy", ".png", ".tif", ".tiff", ".exr", ".pfm", ".bin")  # in folders
TEXTS = (".csv", ".txt")
WHAT = (
    "a depth map (.npz, .npy, .png of 8 or 16 bits, .tif of 8 or 16 bits or of floats of 32, .pfm, COLMAP's "
    ".bin, rows of numbers as .csv or .txt)"
)
log = logging.getLogger("endolab")


@dataclass(frozen=True, eq=False)
class DepthMap:
    """A depth map that a file or an array holds."""

    values: FloatArray  # (H, W), nan where unknown
    kind: str  # "z" or "distance", Euclidean, from the optical centre
    metric: bool  # in mm, not in a unit that nobody named
    is_inverse: bool = False  # whether the values are one over what was held
    # What else the file tells, if it does.
    cos_alpha: FloatArray | None = None  # (H, W), z over distance
    normals: FloatArray | None = None  # (H, W, 3)
    sigma: FloatArray | None = None  # (H, W), of the distance


def read_depth_map(
    source: PathLike | np.ndarray, kind: str | None = None, unit: float | None = None
) -> DepthMap:
    """Read a depth map that any program wrote.

    Parameters
    ----------
    source : path or (H, W) array
        What `save_depth` wrote; or an .npy, an .npz (of an array called depth, z, distance …, or of one
        array), a PNG of 8 or 16 bits, a TIFF of integers or floats, of which a third channel is z, a PFM,
        COLMAP's .bin, or rows of numbers. EXR is read where OpenCV is built for it.
    kind : {"z", "distance", "disparity"}, optional
        What it holds, if neither the file nor the name of its array says: z by default. A disparity is one
        over z, up to a factor.
    unit : float, optional
        The mm that 1 stands for: 1000 if it is in metres, 1/256 if a PNG holds 256 times the mm.

    Returns
    -------
    DepthMap
        What is no positive number is unknown, nan; where all are negative, they are turned, which is logged.

    Raises
    ------
    OSError, ValueError
        In one sentence, if it cannot be read, or holds something else.
    """
    kinds = ("z", "distance", "disparity")
    if kind not in (None, *kinds):
        raise unknown_name("kind", kind, kinds)
    stored_kind = "z"
    if isinstance(source, np.ndarray):
        stored = source
        source = "the array"
    elif Path(source).suffix.lower() == ".npz":
        content = io.BytesIO(read_bytes(source))
        with name_damage(source, WHAT), np.load(content, allow_pickle=False) as archive:
            names = archive.files
        if {"distance", "z"} <= {*names}:
            maps = read_depth(source)
            distance = maps["distance"].astype(np.float64)
            more = {name: maps.get(name) for name in ("normals", "sigma")}
            metric = bool(maps.get("metric", True))
            cosine = maps["z"] / distance
            return DepthMap(distance, "distance", metric, False, cosine, **more)
        name, stored_kind = _choose_array(source, names)
        stored = read_arrays(source, WHAT, [name])[name]
    else:
        stored = _read_numbers(Path(source))
    values = np.squeeze(stored)
    if values.ndim == 3 and np.all(values == values[..., :1]):
        values = values[..., 0]
    if values.ndim != 2 or values.dtype.kind not in "fiu":
        found = f"{stored.dtype} of shape {stored.shape}"
        raise ValueError(f"{source}: expected one number for each pixel, found {found}")
    with np.errstate(invalid="ignore"):  # of nan that signal
        values = values.astype(np.float64)
    if np.any(values < 0) and not np.any(values > 0):
        log.warning(
            "%s: all its numbers are negative, as z is where a camera looks along -z",
            source,
        )
        values = -values
    values[~(np.isfinite(values) & (values > 0))] = np.nan
    is_inverse = (kind or stored_kind) == "disparity"
    if is_inverse:
        values = 1 / values
    values *= 1.0 if unit is None else unit
    return DepthMap(
        values, "z" if is_inverse else kind or stored_kind, unit is not None, is_inverse
    )


def _read_numbers(source: Path) -> np.ndarray:
    """Read a file of numbers, other than an .npz; of three that are floats, the third, which is z."""
    suffix = source.suffix.lower()
    if suffix == ".png":
        return read_stored(source)[0]
    content = read_bytes(source)
    with name_damage(source, WHAT), quiet():
        if suffix == ".npy":
            return np.asarray(np.load(io.BytesIO(content), allow_pickle=False))
        if suffix in TEXTS:
            return np.loadtxt(
                re.sub("[,;]", " ", content.decode("utf-8-sig")).splitlines(), ndmin=2
            )
        colmap = re.match(rb"(\d+)&(\d+)&1&", content)
        if colmap:
            shape = int(colmap[2]), int(colmap[1])
            return np.frombuffer(content[colmap.end() :], "<f4").reshape(shape)
        stored = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
        if stored is None:
            raise ValueError
        is_xyz = stored.dtype.kind == "f" and stored.shape[2:] == (3,)
        return stored[..., 0] if is_xyz else stored  # OpenCV's order is the third first


def _choose_array(source: PathLike, names: list[str]) -> tuple[str, str]:
    """Choose the array of an .npz that is the depth map; return its name and what it holds."""
    plain = {name.lower().removesuffix("map").rstrip("_"): name for name in names}
    # The best first; "depth_map" counts as "depth".
    for known in ("distance", "z", "depth", "pred", "prediction", "arr_0", "data"):
        if known in plain:
            return plain[known], "distance" if known == "distance" else "z"
    if len(names) == 1:
        return names[0], "disparity" if names[0].lower().startswith(
            ("disp", "inv")
        ) else "z"
    found = shorten(", ".join(names))
    raise ValueError(
        f"{source}: expected an array called depth, z or distance, found {found}"
    )
