"""Depth maps as other programs write them: arrays of NumPy, 16-bit pictures, TIFF of floats."""

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from endolab.io.archives import array_names, read_arrays
from endolab.io.atomic import PathLike, name_damage, read_bytes
from endolab.io.images import read_floats, read_stored
from endolab.io.surfaces import read_depth
from endolab.model.schema import shorten, unknown_name
from endolab.numerics.arrays import FloatArray

KINDS = ("z", "distance")
SUFFIXES = (".npz", ".npy", ".png", ".tif", ".tiff", ".exr")
# Names of an array in an .npz, the best first; "depth_map" counts as "depth".
ARRAYS = ("distance", "z", "depth", "pred", "prediction", "arr_0", "data")
INVERSE = ("disp", "inv")  # what else its name may begin with, if it holds no depth
WHAT = "a depth map (.npz, .npy, .png of 8 or 16 bits, .tif of 8 or 16 bits or of floats)"


@dataclass(frozen=True)
class DepthMap:
    """A depth map that a file holds."""

    values: FloatArray  # (H, W), nan where unknown
    kind: str  # "z" or "distance", Euclidean, from the optical centre
    metric: bool  # in mm, not in a unit that nobody named
    # What else the file tells, if it does.
    cos_alpha: FloatArray | None = None  # (H, W), z over distance
    normals: FloatArray | None = None  # (H, W, 3)
    sigma: FloatArray | None = None  # (H, W), of the distance


def read_depth_map(
    path: PathLike, kind: str | None = None, unit: float | None = None
) -> DepthMap:
    """Read a depth map that any program wrote.

    Parameters
    ----------
    path : path
        What `save_depth` wrote; or an .npy, an .npz (of an array called depth, z, distance …, or of one
        array), a PNG of 8 or 16 bits, a TIFF of integers or floats. EXR is read where OpenCV is built for it.
    kind : {"z", "distance"}, optional
        What it holds, if neither the file nor the name of its array says: z by default.
    unit : float, optional
        The mm that 1 stands for: 1000 if it is in metres, 1/256 if a PNG holds 256 times the mm.

    Returns
    -------
    DepthMap
        What is no positive number is unknown, nan.

    Raises
    ------
    OSError, ValueError
        In one sentence, if it cannot be read, or holds something else, such as disparities.
    """
    if kind not in (None, *KINDS):
        raise unknown_name("kind", kind, KINDS)
    source = Path(path)
    suffix = source.suffix.lower()
    held = "z"
    if suffix == ".npz":
        names = array_names(source, WHAT)
        if {"distance", "z"} <= {*names}:
            return _read_own(source)
        name, held = _choose_array(source, names)
        stored = read_arrays(source, WHAT, [name])[name]
    elif suffix == ".npy":
        with name_damage(source, WHAT):
            stored = np.load(io.BytesIO(read_bytes(source)), allow_pickle=False)
    elif suffix == ".png":
        stored = read_stored(source)
    else:
        stored = read_floats(source, WHAT)
    return _as_map(stored, source, kind or held, unit)


def _read_own(source: Path) -> DepthMap:
    """Read what `save_depth` wrote."""
    maps = read_depth(source)
    distance = maps["distance"].astype(np.float64)
    more = {name: maps.get(name) for name in ("normals", "sigma")}
    metric = bool(maps.get("metric", True))
    return DepthMap(distance, "distance", metric, maps["z"] / distance, **more)


def _choose_array(source: Path, names: list[str]) -> tuple[str, str]:
    """Choose the array of an .npz that is the depth map; return its name and what it holds."""
    for known in ARRAYS:
        for name in names:
            if name.lower().removesuffix("map").rstrip("_") == known:
                return name, "distance" if known == "distance" else "z"
    inverse = [name for name in names if name.lower().startswith(INVERSE)]
    if len(names) == 1 and not inverse:
        return names[0], "z"
    reason = "; what falls with the distance is not read" if inverse else ""
    found = shorten(", ".join(names))
    raise ValueError(
        f"{source}: expected an array called depth, z or distance, found {found}{reason}"
    )


def _as_map(stored: np.ndarray, source: Path, kind: str, unit: float | None) -> DepthMap:
    """Make a map of numbers, (H, W), whatever axes of length 1 there are beside."""
    numbers = np.squeeze(stored)
    if numbers.ndim != 2 or stored.dtype.kind not in "fiu":
        raise ValueError(
            f"{source}: expected one number for each pixel, found {stored.dtype} of shape {stored.shape}"
        )
    values = numbers.astype(np.float64) * (1.0 if unit is None else unit)
    values[~(np.isfinite(values) & (values > 0))] = np.nan
    return DepthMap(values, kind, unit is not None)
