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
from endolab.model.schema import Section, quote

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
        reason = (
            "is no camera of endolab's, which are pinholes, with or without distortion,"
        )
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
        # Where a size is not whole, the class says so.
        plain = Pinhole(size[0], size[1], fx, fy, cx, cy)  # type: ignore[arg-type]
        known = (plain.width, plain.height, fx, fy, cx, cy)
        if kind == FISHEYE:
            k1, k2, k3, k4 = (*k, 0.0, 0.0, 0.0, 0.0)[:4]
            return KannalaBrandt(*known, (k1, k2, k3, k4))
        return BrownConrady(*known, (*k, *[0.0] * 8)[:8]) if any(k) else plain
    except ValueError as error:
        raise part.error("", str(error)) from error


def _flatten(value: Any) -> Any:
    """Return the numbers of a matrix as a list: OpenCV's "data", a list of rows, or one number."""
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


# The formats ---------------------------------------------------------------------------
MATRIX_NAME = re.compile(
    r"(camera_?matrix|intrinsic_?matrix|intrinsics|mtx|k|m)(|_?[012lr]|_?left|_?right)",
    re.IGNORECASE,
)
_DISTORTION = r"(dist(ortion)?_?(coeff?(icient)?s?)?|d)"


def opencv_cameras(document: Any, file: str, size: Size | None) -> Cameras:
    """OpenCV's FileStorage, ROS's camera_info, and what people write of a matrix and coefficients.

    Four coefficients of no stated model are taken as a fisheye's, else as Brown's.
    """
    content = document.get("opencv_storage", document)
    matches = (MATRIX_NAME.fullmatch(key) for key in content)
    cameras: Cameras = {}
    for match in matches:
        if match is None:
            continue
        key, suffix = match[0], match[2]
        pattern = re.compile(_DISTORTION + suffix, re.IGNORECASE)
        distortion = next((name for name in content if pattern.fullmatch(name)), None)
        part = Section(content, "", file)
        stated = _stated_kind(part)
        k = () if distortion is None else _numbers(part, distortion)
        make = partial(_opencv_camera, content, file, size, key, k)
        kinds = [stated] if stated else [FISHEYE, BROWN] if len(k) == 4 else [BROWN]
        for kind in kinds:
            name = " ".join(filter(None, (suffix.strip("_"), kind)))
            cameras[name] = partial(make, kind=kind)
    return cameras


def _stated_kind(part: Section) -> str:
    """Return the kind of lens that OpenCV's sample or ROS says, or nothing."""
    if part.content.get("distortion_model"):
        return _lens_of(part, "distortion_model", ROS)[0]
    is_fisheye = part.content.get("fisheye_model")
    return "" if is_fisheye is None else (BROWN, FISHEYE)[bool(is_fisheye)]


def _opencv_camera(
    content: dict[str, Any],
    file: str,
    size: Size | None,
    key: str,
    k: tuple[float, ...],
    kind: str,
) -> Camera:
    part = Section(content, "", file)
    roi = part.content.get("roi")
    region = isinstance(roi, dict) and any(map(bool, roi.values()))
    if region or any(
        part.content.get(f"binning_{axis}") not in (None, 0, 1) for axis in "xy"
    ):
        raise part.error(
            "binning, roi", "a part of the picture, or a binned one, is not read"
        )
    keys = next(
        (
            keys
            for keys in (
                ("image_width", "image_height"),
                ("width", "height"),
                ("image_size",),
            )
            if keys[0] in part.content
        ),
        ("image_width",),
    )
    most = 4 if kind == FISHEYE else 8
    if any(k[most:]):
        raise part.error(
            "", f"expected {most} coefficients of a {kind} lens, found {len(k)}"
        )
    return _camera(part, kind, _size_of(part, size, *keys), _matrix(part, key), k[:most])


def kalibr_cameras(document: Any, file: str, size: Size | None) -> Cameras:
    """Kalibr's camchain: pinholes with radtan, equi or no distortion."""
    return {
        name: partial(_kalibr_camera, Section(part, name, file))
        for name, part in document.items()
        if re.fullmatch(r"cam\d+", name)
    }


def _kalibr_camera(part: Section) -> Camera:
    _lens_of(part, "camera_model", {"pinhole": (BROWN, 4)})
    kind, count = _lens_of(part, "distortion_model", KALIBR)
    k = part.numbers("distortion_coeffs", count, []) if count else ()
    return _camera(
        part, kind, part.numbers("resolution", 2), part.numbers("intrinsics", 4), k
    )


def colmap_cameras(document: Any, file: str, size: Size | None) -> Cameras:
    """COLMAP's cameras.txt: CAMERA_ID MODEL WIDTH HEIGHT PARAMS."""
    cameras: Cameras = {}
    for number, model, width, height, *parameters in document[ROWS]:
        content = {"model": model, "size": [width, height], "parameters": parameters}
        part = Section(content, f"camera {number:g}", file)
        cameras[f"{number:g}"] = partial(_colmap_camera, part, model)
    return cameras


def _colmap_camera(part: Section, model: str) -> Camera:
    kind, count = _lens_of(part, "model", COLMAP)
    values = part.numbers("parameters", count)
    if "SIMPLE" in model or "RADIAL" in model:  # one focal length
        values = (values[0], *values)
    fx, fy, cx, cy, *k = values
    size = part.numbers("size", 2)
    return _camera(part, kind, size, (fx, fy, cx - 0.5, cy - 0.5), k)


def mrcal_cameras(document: Any, file: str, size: Size | None) -> Cameras:
    """Mrcal's cameramodel: a pinhole, or OpenCV's with 4, 5 or 8 coefficients."""

    def make() -> Camera:
        part = Section(document, "", file)
        kind, count = _lens_of(part, "lensmodel", MRCAL)
        values = part.numbers("intrinsics", count)
        return _camera(part, kind, part.numbers("imagersize", 2), values[:4], values[4:])

    return {"": make}


def vicalib_cameras(document: Any, file: str, size: Size | None) -> Cameras:
    """Vicalib's rig (the Calibu library): its fisheye, pinhole, polynomial and rational cameras.

    `<rig><camera><camera_model type="calibu_fu_fv_u0_v0_kb4">` has `width`, `height` and `params`
    [ fu; fv; u0; v0; k0; k1; k2; k3 ], px and none. The axes and the pose concern a rig's world frame.
    """
    rig = Section(document, "", file).section("rig")
    parts = rig.take("camera")
    parts = parts if isinstance(parts, list) else [parts]
    return {
        f"camera{index}": partial(_vicalib_camera, Section(part, "rig.camera", file))
        for index, part in enumerate(parts)
    }


def _vicalib_camera(camera: Section) -> Camera:
    part = camera.section("camera_model")
    kind, count = _lens_of(part, "type", VICALIB)
    width = part.integer("width")
    height = part.integer("height")
    values = part.numbers("params", count)
    k = values[4:]
    if kind == BROWN:  # it has no p1, p2
        k = (*k[:2], 0.0, 0.0, *k[2:])
    return _camera(part, kind, (width, height), values[:4], k)


def ocam_cameras(document: Any, file: str, size: Size | None) -> Cameras:
    """OCamCalib's calib_results.txt, by Scaramuzza; its axes are down, right and backward."""

    def make() -> Camera:
        keys = ("ss", "invpol", "center", "affine", "size")
        part = Section(dict(zip(keys, document[ROWS], strict=False)), "", file)
        rows = {"center": 2, "affine": 3, "size": 2}
        center, affine, (height, width) = (part.numbers(*row) for row in rows.items())
        return _ocam_camera(part, (width, height), part.numbers("ss")[1:], center, affine)

    return {"": make}


def _ocam_camera(
    part: Section,
    size: Sequence[float],
    ss: tuple[float, ...],
    center: Sequence[float],
    affine: Sequence[float],
) -> Camera:
    """Build a camera of what OCamCalib calls so; the centre, row and column, counts from 0."""
    if any(ss[5:]):
        raise part.error("ss", f"expected a polynomial of degree 4, found {len(ss) - 1}")
    a = tuple(-value for value in (*ss, 0.0, 0.0, 0.0, 0.0, 0.0)[:5])
    c, d, e = affine
    return _scaramuzza(part, size, center[::-1], a, ((1.0, e), (d, c)))


def _scaramuzza(
    part: Section,
    size: Sequence[float],
    centre: Sequence[float],
    a: Sequence[float],
    stretch: Sequence[Sequence[float]],
) -> Camera:
    (c, d), (e, row_scale) = stretch
    cx, cy = centre
    try:
        plain = (size[0], size[1], cx, cy, tuple(a), c, d, e, row_scale)
        return Scaramuzza(*plain)  # type: ignore[arg-type]
    except ValueError as error:
        raise part.error("", str(error)) from error


def flat_cameras(document: Any, file: str, size: Size | None) -> Cameras:
    """C3VD's camera: width, height, cx, cy, a0 to a4, c, d, e."""

    def make() -> Camera:
        part = Section(document.get("camera", document), "", file)
        a = [part.number(f"a{power}", 0.0 if power else ...) for power in range(5)]
        c, d, e = (part.number(*pair) for pair in (("c", 1.0), ("d", 0.0), ("e", 0.0)))
        centre = (part.number("cx"), part.number("cy"))
        known = _size_of(part, size, "width", "height")
        return _scaramuzza(part, known, centre, a, ((c, d), (e, 1.0)))

    return {"": make}


def matlab_structs(value: Any, name: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Find structs that toStruct or jsonencode made of MATLAB's cameras, and OCamCalib's."""
    if isinstance(value, dict):
        keys = set(value)
        if keys & {"MappingCoefficients", "RadialDistortion"} or {"ss", "xc", "yc"} <= keys:
            yield name, value
        else:
            for key, part in value.items():
                yield from matlab_structs(part, ".".join(filter(None, (name, key))))


def matlab_cameras(document: Any, file: str, size: Size | None) -> Cameras:
    """MATLAB's cameraParameters, cameraIntrinsics and fisheyeIntrinsics, or OCamCalib's model, as structs."""
    return {
        name: partial(_matlab_camera, Section(part, name, file), size)
        for name, part in matlab_structs(document)
    }


def _matlab_camera(part: Section, given: Size | None) -> Camera:
    if "ss" in part.content:
        size = _size_of(part, given, "width", "height")
        center = (part.number("xc") - 1, part.number("yc") - 1)
        affine = [part.number(key) for key in "cde"]
        return _ocam_camera(part, size, _numbers(part, "ss"), center, affine)
    if part.content.get("ImageSize", ()) in ([], None):
        del part.content["ImageSize"]
        size = _size_of(part, given, "ImageSize")
    else:
        swapped = None if given is None else given[::-1]
        size = _size_of(part, swapped, "ImageSize")[::-1]
    if "MappingCoefficients" in part.content:
        a0, *a = part.numbers("MappingCoefficients", 4)
        cx, cy = part.numbers("DistortionCenter", 2)
        c, d, e, row_scale = _numbers(part, "StretchMatrix", 4)
        stretch = ((c, d), (e, row_scale))
        return _scaramuzza(part, size, (cx - 1, cy - 1), (a0, 0.0, *a), stretch)
    keys = [key for key in ("K", "IntrinsicMatrix") if key in part.content]
    if keys:
        fx, fy, cx, cy = _matrix(part, keys[0])
    else:
        fx, fy = part.numbers("FocalLength", 2)
        cx, cy = part.numbers("PrincipalPoint", 2)
        if part.number("Skew", 0.0):
            raise part.error("Skew", "endolab's cameras have none")
    k1, k2, *k3 = part.numbers("RadialDistortion")
    p1, p2 = part.numbers("TangentialDistortion", 2, (0.0, 0.0))
    return _camera(part, BROWN, size, (fx, fy, cx - 1, cy - 1), (k1, k2, p1, p2, *k3[:1]))
