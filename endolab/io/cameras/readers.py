"""One function for each kind of calibration file: the cameras that it holds, by their names.

Each takes what `read_document` returns, the file's name for errors, and the size of the pictures, px, for
files that hold none. Each returns what makes the cameras, so that one that endolab does not have does not
keep others from being read.

Pixels: endolab, OpenCV, ROS, Kalibr, mrcal and OCamCalib's text count from 0 at the centre of the first
pixel, COLMAP from 0 at its corner, MATLAB from 1 at its centre. Vicalib does not say, and is taken as OpenCV.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

from endolab.io.cameras.documents import ROWS
from endolab.model.cameras import BrownConrady, Camera, KannalaBrandt, Pinhole, Scaramuzza
from endolab.model.schema import LONGEST_VALUE, Section, quote, shorten

Size = tuple[int, int]  # columns and rows, px
Cameras = dict[str, Callable[[], Camera]]
BROWN = "brown"
FISHEYE = "fisheye"

# Of each program, its lenses by name: their kind, and how many coefficients or parameters they have.
Lenses = dict[str, tuple[str, int]]
KALIBR: Lenses = {
    "none": (BROWN, 0),
    "radtan": (BROWN, 4),
    "equi": (FISHEYE, 4),
    "equidistant": (FISHEYE, 4),
}
ROS: Lenses = {
    "plumb_bob": (BROWN, 5),
    "rational_polynomial": (BROWN, 8),
    "equidistant": (FISHEYE, 4),
    "fisheye": (FISHEYE, 4),
}
COLMAP: Lenses = {
    "SIMPLE_PINHOLE": (BROWN, 3),
    "PINHOLE": (BROWN, 4),
    "SIMPLE_RADIAL": (BROWN, 4),
    "RADIAL": (BROWN, 5),
    "OPENCV": (BROWN, 8),
    "FULL_OPENCV": (BROWN, 12),
    "SIMPLE_FISHEYE": (FISHEYE, 3),
    "FISHEYE": (FISHEYE, 4),
    "SIMPLE_RADIAL_FISHEYE": (FISHEYE, 4),
    "RADIAL_FISHEYE": (FISHEYE, 5),
    "OPENCV_FISHEYE": (FISHEYE, 8),
}
MRCAL: Lenses = {
    "LENSMODEL_PINHOLE": (BROWN, 4),
    "LENSMODEL_OPENCV4": (BROWN, 8),
    "LENSMODEL_OPENCV5": (BROWN, 9),
    "LENSMODEL_OPENCV8": (BROWN, 12),
}
VICALIB: Lenses = {
    "calibu_fu_fv_u0_v0": (BROWN, 4),
    "calibu_fu_fv_u0_v0_k1_k2": (BROWN, 6),
    "calibu_fu_fv_u0_v0_k1_k2_k3": (BROWN, 7),
    "calibu_fu_fv_u0_v0_rational6": (BROWN, 10),
    "calibu_fu_fv_u0_v0_kb4": (FISHEYE, 8),
}


class MissingSize(ValueError):
    """Of a file that does not say how large its pictures are."""


# What several need --------------------------------------------------------------------
def _lens_of(part: Section, key: str, lenses: Lenses) -> tuple[str, int]:
    """Take out the name of a lens, which must be one of those that endolab has."""
    name = part.take(key)
    if not isinstance(name, str) or name not in lenses:
        reason = "is no camera of endolab's, which are pinholes, with or without distortion,"
        reason += f" and fisheyes; expected {', '.join(lenses)}"
        raise part.error(key, f"{quote(name)} {reason}")
    return lenses[name]


def _camera(
    part: Section,
    kind: str,
    size: Sequence[float],
    centre: Sequence[float],
    k: Sequence[float],
) -> Camera:
    """Build a camera of `kind`, of fx, fy, cx, cy and coefficients in OpenCV's order, which may be fewer."""
    fx, fy, cx, cy = centre
    try:
        plain = Pinhole(int(size[0]), int(size[1]), fx, fy, cx, cy)
        known = (plain.width, plain.height, fx, fy, cx, cy)
        if kind == FISHEYE:
            return KannalaBrandt(*known, (*k, 0.0, 0.0, 0.0, 0.0)[:4])
        return BrownConrady(*known, (*k, *[0.0] * 8)[:8]) if any(k) else plain
    except ValueError as error:
        raise part.error("", str(error)) from error


def _flatten(value: Any) -> Any:
    """Return the numbers of a matrix as a list: of OpenCV's with "data", of a list of rows, or of one number."""
    if isinstance(value, dict) and "data" in value:
        value = value["data"]
    if isinstance(value, list):
        parts = [_flatten(part) for part in value]
        return [number for part in parts for number in part]
    return [value]


def _numbers(part: Section, key: str, count: int | None = None) -> tuple[float, ...]:
    """Take out the numbers of a matrix or a list."""
    if key in part.content:
        part.content[key] = _flatten(part.content[key])
    return part.numbers(key, count)


def _matrix(part: Section, key: str) -> tuple[float, float, float, float]:
    """Take out fx, fy, cx, cy of a camera matrix, or of MATLAB's, which is transposed."""
    rows = _numbers(part, key, 9)
    if any(rows[6:8]):
        rows = rows[0::3] + rows[1::3] + rows[2::3]
    fx, skew, cx, _, fy, cy, *_ = rows
    if abs(skew) > 1e-6 * abs(fx) or rows[3:4] + rows[6:] != (0.0, 0.0, 0.0, 1.0):
        wanted = "[fx 0 cx; 0 fy cy; 0 0 1], without a skew"
        raise part.error(key, f"expected {wanted}, found {quote(list(rows))}")
    return fx, fy, cx, cy


def _size_of(part: Section, given: Size | None, *keys: str) -> Size:
    """Take out the size of the pictures, under two keys or under one, or take the one given."""
    if keys[0] in part.content:
        values = (
            _numbers(part, keys[0], 2)
            if len(keys) == 1
            else (part.number(keys[0]), part.number(keys[1]))
        )
        return values  # type: ignore[return-value]
    if given is None:
        raise MissingSize(
            f"{part.file}: it does not say how large its pictures are: give size=(columns, rows), "
            "or --size 1440x1080 of endolab convert"
        )
    return given
