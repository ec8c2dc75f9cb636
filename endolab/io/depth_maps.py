"""Depth maps as other programs write them: arrays of NumPy, 16-bit pictures, TIFF of floats."""

import io
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from endolab.io.archives import array_names, read_arrays
from endolab.io.atomic import PathLike, name_damage, read_bytes
from endolab.io.datasets.folders import depth_layout, true_z
from endolab.io.images import read_stored
from endolab.io.quiet import quiet
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
        What `save_depth` wrote; a depth map of C3VD, SimCol3D or UCL 2019, told by its name; or an .npy, an
        .npz (of an array called depth, z, distance …, or of one array), a PNG of 8 or 16 bits, a TIFF of
        integers or floats. Three channels are X, Y and Z. EXR is read where OpenCV is built for it.
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
    if kind is None and unit is None and depth_layout(source):
        return DepthMap(true_z(source), "z", True)
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
        stored = read_floats(source)
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


def read_floats(source: Path) -> np.ndarray:
    """Read a TIFF of integers or floats, or an EXR if OpenCV can; channels in the file's order."""
    content = np.frombuffer(read_bytes(source), np.uint8)
    with name_damage(source, WHAT), quiet:
        stored: np.ndarray | None = cv2.imdecode(content, cv2.IMREAD_UNCHANGED)
    if stored is None:
        hint = "; this OpenCV may not read EXR" if source.suffix.lower() == ".exr" else ""
        raise ValueError(f"{source}: expected {WHAT}{hint}")
    return stored[..., ::-1] if stored.ndim == 3 else stored


def _as_map(stored: np.ndarray, source: Path, kind: str, unit: float | None) -> DepthMap:
    """Make a map of numbers: (H, W), whatever axes of length 1 there are beside; or (H, W, 3), X, Y, Z."""
    numbers = np.squeeze(stored)
    is_points = numbers.ndim == 3 and numbers.shape[2] == 3 and stored.dtype.kind == "f"
    if not (numbers.ndim == 2 or is_points) or stored.dtype.kind not in "fiu":
        raise ValueError(
            f"{source}: expected one number for each pixel, found {stored.dtype} of shape {stored.shape}"
        )
    values = numbers.astype(np.float64) * (1.0 if unit is None else unit)
    metric = unit is not None
    if is_points:
        distance = np.linalg.norm(values, axis=-1)
        distance[~(np.isfinite(distance) & (values[..., 2] > 0))] = np.nan
        return DepthMap(distance, "distance", metric, values[..., 2] / distance)
    values[~(np.isfinite(values) & (values > 0))] = np.nan
    return DepthMap(values, kind, metric)
