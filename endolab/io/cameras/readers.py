"""What each kind of calibration file says of its cameras.

Pixels: endolab, OpenCV, ROS and Kalibr count from 0 at the centre of the first pixel, COLMAP from 0 at its
corner. Vicalib does not say, and is taken as OpenCV.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from endolab.io.cameras.documents import ROWS
from endolab.model.cameras import BrownConrady, Camera, KannalaBrandt, Pinhole, Scaramuzza
from endolab.numerics.checks import shorten

Size = tuple[int, int]  # columns and rows, px
OPENCV = "OpenCV's FileStorage (YAML, XML, JSON) or ROS's camera_info"
KALIBR = "Kalibr's camchain"
COLMAP = "COLMAP's cameras.txt"
VICALIB = "Vicalib's XML"
C3VD = "C3VD's a0 to a4"
BROWN = "brown"
FISHEYE = "fisheye"

# The lenses of Kalibr, ROS, COLMAP and Vicalib, which are of two kinds.
LENSES = {
    FISHEYE: r"equi(distant)?|fisheye|((SIMPLE_)?(RADIAL_)?|OPENCV_)FISHEYE|calibu_fu_fv_u0_v0_kb4",
    BROWN: r"none|radtan|plumb_bob|rational_polynomial|(SIMPLE_)?(PINHOLE|RADIAL)|(FULL_)?OPENCV|"
    r"calibu_fu_fv_u0_v0(_k1_k2(_k3)?|_rational6)?",
}
MATRIX = re.compile(
    r"(camera_?matrix|intrinsic_?matrix|intrinsics|mtx|k|m)(|_?[012lr]|_?left|_?right)",
    re.IGNORECASE,
)
GONE = {
    "lensmodel",
    "RadialDistortion",
    "MappingCoefficients",
    "ss",
}  # mrcal's and MATLAB's
COEFFICIENTS = r"(dist(ortion)?_?(coeff?(icient)?s?)?|d)"


class MissingSize(ValueError):
    """Of a file that does not say how large its pictures are."""


# The values of files -------------------------------------------------------------------
def numbers(value: Any, count: int | None = None) -> tuple[float, ...]:
    """Return the finite numbers of a list, a matrix, OpenCV's "data", or one number."""
    if isinstance(value, dict):
        value = value["data"]
    found = np.asarray(value, float).ravel()
    if not np.isfinite(found).all() or count not in (None, found.size):
        many = "" if count is None else f"{count} "
        raise ValueError(f"expected {many}finite numbers, found {shorten(str(value))}")
    return tuple(found.tolist())


def _lens(name: str) -> str:
    """Return the kind of a lens."""
    for kind, pattern in LENSES.items():
        if re.fullmatch(pattern, name):
            return kind
    raise ValueError(f"no lens {shorten(name)} is known here")


def _size(part: dict[str, Any], given: Size | None) -> Sequence[float]:
    """Return the size of the pictures that a file states, or the one given."""
    for keys in (("image_width", "image_height"), ("width", "height"), ("image_size",)):
        if keys[0] in part:
            return numbers([part[key] for key in keys], 2)
    if given is None:
        text = "width and height are missing: give size=(columns, rows), or --size"
        raise MissingSize(text)
    return given


def _camera(
    kind: str, size: Sequence[float], centre: Sequence[float], k: Sequence[float]
) -> Camera:
    """Build a camera of fx, fy, cx, cy and coefficients in OpenCV's order, which may be fewer."""
    lens, most = (KannalaBrandt, 4) if kind == FISHEYE else (BrownConrady, 8)
    if any(k[most:]):
        raise ValueError(f"expected {most} coefficients of a {kind} lens, found {len(k)}")
    # Where a size is not whole, the class says so.
    if kind == BROWN and not any(k):
        return Pinhole(*size, *centre)  # type: ignore[arg-type]
    return lens(*size, *centre, (*k, *[0.0] * 8)[:most])  # type: ignore


# The formats ---------------------------------------------------------------------------
def list_cameras(document: Any) -> tuple[str, dict[str, Any]]:
    """Tell the format of a document, and its cameras by name, unread; none, if it is of no format."""
    if not isinstance(document, dict) or GONE & document.keys():
        return "", {}
    if "rig" in document:
        found = document["rig"]["camera"]
        parts = found if isinstance(found, list) else [found]
        return VICALIB, {f"camera{index}": part for index, part in enumerate(parts)}
    chain = {name: document[name] for name in document if re.fullmatch(r"cam\d+", name)}
    if chain:
        return KALIBR, chain
    if ROWS in document:
        rows = document[ROWS]
        is_camera = all(len(row) > 4 and isinstance(row[1], str) for row in rows)
        return COLMAP, {f"{row[0]:g}": row for row in rows} if is_camera else {}
    flat = document.get("camera", document)
    if isinstance(flat, dict) and "a0" in flat:
        return C3VD, {"": flat}
    return OPENCV, _list_matrices(document.get("opencv_storage", document))


def _list_matrices(content: Any) -> dict[str, Any]:
    """Find each camera matrix with its coefficients; four of no stated model are a fisheye's, or Brown's."""
    cameras: dict[str, Any] = {}
    for match in map(MATRIX.fullmatch, content if isinstance(content, dict) else ()):
        if match is None:
            continue
        pattern = re.compile(COEFFICIENTS + match[2], re.IGNORECASE)
        k = numbers(next((content[key] for key in content if pattern.fullmatch(key)), ()))
        kinds = [FISHEYE, BROWN] if len(k) == 4 else [BROWN]
        if content.get("distortion_model"):
            kinds = [_lens(content["distortion_model"])]
        elif content.get("fisheye_model") is not None:
            kinds = [FISHEYE if content["fisheye_model"] else BROWN]
        for kind in kinds:
            name = f"{match[2].strip('_')} {kind}".strip()
            cameras[name] = content | {"matrix": content[match[0]], "k": k, "kind": kind}
    return cameras


def make_camera(form: str, part: Any, given: Size | None) -> Camera:
    """Read one of the cameras that `list_cameras` found; `given` is the size, if the file does not say."""
    if form == KALIBR:
        if part["camera_model"] != "pinhole":
            raise ValueError(f"camera_model {part['camera_model']} is not pinhole")
        k = numbers(part.get("distortion_coeffs", ()))
        size = numbers(part["resolution"], 2)
        return _camera(
            _lens(part["distortion_model"]), size, numbers(part["intrinsics"], 4), k
        )
    if form == COLMAP:
        _, name, *values = part
        width, height, *values = numbers(values)
        if "SIMPLE" in name or "RADIAL" in name:  # one focal length
            values = [values[0], *values]
        fx, fy, cx, cy, *more = values
        return _camera(_lens(name), (width, height), (fx, fy, cx - 0.5, cy - 0.5), more)
    if form == VICALIB:
        # `<params>` [ fu; fv; u0; v0; k0; … ]; the axes and the pose concern a rig's world frame.
        model = part["camera_model"]
        kind = _lens(model["type"])
        values = numbers(model["params"])
        k1_and_k2, others = values[4:6], values[6:]
        middle = () if kind == FISHEYE else (0.0, 0.0)
        return _camera(kind, _size(model, None), values[:4], (*k1_and_k2, *middle, *others))
    if form == C3VD:
        a = numbers([part.get(f"a{power}", 0.0) for power in range(5)])
        part = {"c": 1.0, "d": 0.0, "e": 0.0} | part
        cx, cy, *affine = numbers([part[name] for name in ("cx", "cy", "c", "d", "e")])
        return Scaramuzza(*_size(part, given), cx, cy, a, *affine)  # type: ignore
    fx, skew, cx, zero, fy, cy, *last = numbers(part["matrix"], 9)
    if abs(skew) > 1e-6 * abs(fx) or [zero, *last] != [0.0, 0.0, 0.0, 1.0]:
        raise ValueError("expected a matrix [fx 0 cx; 0 fy cy; 0 0 1], without a skew")
    width, height = _size(part, given)
    roi = part.get("roi", {})
    cut = [roi.get(name, 0) for name in ("x_offset", "y_offset", "width", "height")]
    is_whole = cut in ([0, 0, 0, 0], [0, 0, width, height])
    if not is_whole or max(part.get("binning_x", 0), part.get("binning_y", 0)) > 1:
        raise ValueError(
            "binning and roi must be of whole pictures; write the camera of these pictures"
        )
    return _camera(part["kind"], (width, height), (fx, fy, cx, cy), part["k"])
