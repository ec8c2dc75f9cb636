"""What each kind of calibration file says of its cameras.

Pixels: endolab, OpenCV, ROS and Kalibr count from 0 at the centre of the first pixel, COLMAP and nerfstudio
from 0 at its corner. Vicalib does not say, and is taken as OpenCV.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from endolab.io.cameras.documents import ROWS
from endolab.model.cameras import BrownConrady, Camera, KannalaBrandt, Pinhole, Scaramuzza
from endolab.numerics.checks import shorten

Size = tuple[int, int]  # columns and rows, px
COLMAP = "COLMAP's cameras.txt"
VICALIB = "Vicalib's XML"
BROWN = "brown"
FISHEYE = "fisheye"

# The lenses of all programs, which are of two kinds. All names are without case and punctuation.
LENSES = {
    FISHEYE: r"equi(distant)?|(opencv|(simple)?(radial)?)fisheye|kannalabrandt[48]?|calibufufvu0v0kb4",
    BROWN: r"none|radtan|radialtangential|plumbbob|rationalpolynomial|rectified|brown(conrady)?|"
    r"(simple)?(pinhole|radial)|(full)?opencv|calibufufvu0v0(k1k2(k3)?|rational6)?",
}
# OpenCV's coefficients, in its order.
TERMS = ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"]
# What a name means, by the kind of its value.
MEANINGS = {
    float: {
        "width": "width|w|nx",
        "height": "height|h|ny",
        "fx": "fx|fu",
        "fy": "fy|fv",
        "flx": "flx",  # nerfstudio's
        "fly": "fly",
        "cx": "cx|ppx|u0",
        "cy": "cy|ppy|v0",
        "fisheye": "(is)?fisheye(model)?",
        **{name: name for name in (*TERMS, *"cde", "a0", "a1", "a2", "a3", "a4")},
    },
    str: {
        "model": "distortion(model|type)?",
        "lens": "model|(camera|lens|projection)(model|type)",
    },
    list: {
        "size": "size|resolution",
        "four": "intrinsics",
        "unsure": "k|kc|coeffs|dist(ortion)?param(eter)?s",  # whose four may be of either kind
        "k": "d|dist(ortion)?(coeff?(icient)?s?)?",
        "matrix": "k|kk|m|mtx|matrix|intrinsics",
    },
}


class MissingSize(ValueError):
    """Of a file that does not say how large its pictures are."""


# The values of files -------------------------------------------------------------------
def numbers(value: Any, count: int | None = None) -> tuple[float, ...]:
    """Return the finite numbers of a list, a matrix, or one number."""
    found = np.asarray(value, float).ravel()
    if not np.isfinite(found).all() or count not in (None, found.size):
        many = "" if count is None else f"{count} "
        raise ValueError(f"expected {many}finite numbers, found {shorten(str(value))}")
    return tuple(found.tolist())


def _few_numbers(value: Any) -> list[float]:
    """Return the numbers of a number, a list, a row or a column, of 16 at most; none of all else."""
    with suppress(ValueError):  # lists of other lengths in a list
        found = np.asarray(value)
        if found.dtype.kind in "if" and max(found.shape, default=1) == found.size < 17:
            return found.ravel().tolist()
    return []


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9.]", "", name.lower())


def _lens(name: str) -> str:
    """Return the kind of a lens."""
    for kind, pattern in LENSES.items():
        if re.fullmatch(pattern, _plain(name)):
            return kind
    is_kalibrs = name in ("ds", "eucm", "omni")
    remedy = "; calibrate with Kalibr's --models pinhole-equi" if is_kalibrs else ""
    raise ValueError(f"no lens {shorten(name)} is known here{remedy}")


def _size(part: dict[str, Any], given: Size | None) -> Sequence[float]:
    """Return the size of the pictures that a file states, or the one given."""
    if "size" in part:
        return numbers(part["size"], 2)
    if "width" in part:
        return numbers([part["width"], part["height"]], 2)
    _refuse_unread(part, False)
    if given is None:
        text = "width and height are missing: give size=(columns, rows), or --size"
        raise MissingSize(text)
    return given


def _camera(
    kind: str, size: Sequence[float], centre: Sequence[float], k: Sequence[float]
) -> Camera:
    """Build a camera of fx, fy, cx, cy and coefficients in OpenCV's order, which may be fewer."""
    lens, most = (KannalaBrandt, 4) if kind == FISHEYE else (BrownConrady, 8)
    if not any(centre[:2]):
        raise ValueError("fx and fy are 0: this camera was never calibrated")
    if any(k[most:]):
        flags = "; calibrate without CALIB_THIN_PRISM_MODEL and CALIB_TILTED_MODEL"
        raise ValueError(
            f"expected {most} coefficients of a {kind} lens, found {len(k)}{flags if len(k) > 8 else ''}"
        )
    # Where a size is not whole, the class says so.
    if kind == BROWN and not any(k):
        return Pinhole(*size, *centre)  # type: ignore[arg-type]
    return lens(*size, *centre, (*k, *[0.0] * 8)[:most])  # type: ignore


# Names ---------------------------------------------------------------------------------
def leaves(value: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    """Go through what a document says: names, as ``camera.fx``, and a number, a text or a list."""
    is_matrix = isinstance(value, dict) and isinstance(value.get("data"), list)
    if isinstance(value, dict) and not is_matrix and len(path) < 6:
        for key, inner in value.items():
            yield from leaves(inner, (*path, str(key)))
    else:
        yield ".".join(path), value["data"] if is_matrix else value


def _meaning(name: str, value: Any) -> tuple[str, str]:
    """Tell which of several cameras a name is of, and what it means; twice "" if it is not known."""
    # Before a name, which camera's it is, and words that say nothing; behind it, which camera's again.
    words = r"(?:raw|input|camera|cam|image|img|intrinsics?|calibration|distortion|size|opencvstorage)*"
    form = rf"{words}?((?:cam|camera)?[0-3]|left|right)?{words}(?:%s)([0-3lr]|left|right)?"
    counts = {"four": (4, 5, 6), "unsure": (4, 5, 8, 12, 14), "matrix": (0, 9, 12, 16)}
    for meaning, names in MEANINGS.get(type(value), MEANINGS[float]).items():
        found = re.fullmatch(form % names, _plain(name).replace(".", ""))
        if found and len(_few_numbers(value)) in counts.get(meaning, range(17)):
            return found[1] or found[found.re.groups] or "", meaning
    return "", ""


def _list_named(document: Any) -> dict[str, Any]:
    """Find each camera of a document, for each kind of lens that it may have, if no name tells it.

    Each is what is understood, by meaning, with all else by name.
    """
    found: dict[str, dict[str, Any]] = {"": {}}
    named = [(*_meaning(name, value), name, value) for name, value in leaves(document)]
    for whose, meaning, _, value in named:
        found.setdefault(whose, {}).setdefault(meaning, value)
    cameras: dict[str, Any] = {}
    needed = {"matrix", "four", "fx", "flx", "a0"}  # one of which a camera has
    known = {whose for whose, own in found.items() if not whose or own.keys() & needed}
    unread = {n: value for whose, what, n, value in named if not what or whose not in known}
    for whose, own in found.items():
        if not own.keys() & needed:
            continue
        part = found[""] | own | {"unread": unread, "document": document}
        if "matrix" not in own:
            part.pop("matrix", None)
        k = part.get("k", part.get("unsure"))
        kinds = [BROWN]
        if part.keys() & {"model", "lens", "fisheye"}:
            kinds = [""]
        elif len(numbers(k)) == 4 if k is not None else "k4" in part and "p1" not in part:
            # The first is taken: OpenCV's fisheye, or none, which is refused.
            kinds = [FISHEYE, BROWN] if "k" in part else ["", FISHEYE, BROWN]
        for kind in kinds:
            cameras[f"{whose} {kind}".strip() or "camera"] = part | {"kind": kind}
    return cameras


def _kind_of(part: dict[str, Any]) -> str:
    """Return the kind of a camera's lens, by what its file says, or was assumed or chosen."""
    kinds = [_lens(part[name]) for name in ("model", "lens") if name in part]
    if "fisheye" in part:
        kinds.append(FISHEYE if part["fisheye"] else BROWN)
    if part["kind"] or kinds:
        return part["kind"] or (FISHEYE if FISHEYE in kinds else BROWN)
    raise ValueError(
        "four coefficients, a fisheye's or Brown's? Add fisheye_model: 1 (or 0) to the file, "
        "or #fisheye (or #brown) to its name"
    )


def _refuse_unread(part: dict[str, Any], is_lens: bool) -> None:
    """Raise ValueError where something under another name may be coefficients of the lens, or the size."""
    # What else a file may say, and is not asked for: errors, flags, boards, poses, what was rectified.
    passing = (
        r"err|\brms|\bstd|flag|board|pattern|square|marker|grid|corner|pose|[rt]vec|points|rectif|proj|"
        r"\broi|rotation|transl|transform|extrin|essential|fundamental|time|\bnew|\b[rpteqf]\d?\b"
    )
    of_a_lens = r"radial|tangential|distort|coeff|(k[1-6]|p[12])$"
    of_a_size = r"width|height|cols|columns|rows|size|shape|resolution"
    for name, value in part.get("unread", {}).items():
        found = _few_numbers(value)
        plain = _plain(name)
        what = "dist_coeffs, and say whether it is a fisheye's"
        is_like = any(found) and (4 <= len(found) <= 14 or re.search(of_a_lens, plain))
        if not is_lens:
            what = "image_width and image_height"
            is_like = len(found) in (2, 3) or re.search(of_a_size, plain)
            is_like = is_like and all(n >= 32 and n == int(n) for n in (found or [0])[:2])
        if is_like and not re.search(passing, plain):
            many = f"{len(found)} number{'s' * (len(found) > 1)}"
            raise ValueError(f"not understood: {shorten(name)} ({many}); call it {what}")


def _coefficients(part: dict[str, Any], kind: str) -> tuple[float, ...]:
    """Return the coefficients of a lens in OpenCV's order."""
    k = part.get("k", part.get("unsure"))
    if k is not None:
        if len(numbers(k)) not in (0, 4, 5, 8, 12, 14):
            raise ValueError(f"expected 4, 5 or 8 coefficients, found {len(numbers(k))}")
        return numbers(k)
    if not part.keys() & {*TERMS}:
        _refuse_unread(part, True)
    # nerfstudio's k4 is no rational polynomial's, unless k5 is there.
    order = TERMS if "k5" in part else TERMS[:5]
    if kind == FISHEYE:
        order = ["k1", "k2", "k3", "k4"]
    for name in {*TERMS}.difference(order):
        if part.get(name):
            raise ValueError(f"{name} is none of a {kind} lens with {', '.join(order)}")
    return numbers([part.get(name, 0.0) for name in order])


def _focal_and_centre(part: dict[str, Any]) -> tuple[float, ...]:
    """Return fx, fy, cx and cy."""
    if "flx" in part:
        fx, fy, cx, cy = numbers([part[name] for name in ["flx", "fly", "cx", "cy"]])
        return fx, fy, cx - 0.5, cy - 0.5
    if "matrix" not in part:
        four = part.get("four") or [part[name] for name in ["fx", "fy", "cx", "cy"]]
        return numbers(four, 4)
    found = np.array(numbers(part["matrix"]))
    if found.size not in (9, 12, 16):
        raise ValueError(f"expected a matrix of 9 numbers, found {found.size}")
    matrix = found.reshape(-1, 3 if found.size == 9 else 4)
    (fx, _, cx), (_, fy, cy) = matrix[:2, :3].tolist()
    rest = matrix - np.eye(*matrix.shape)
    rest[[0, 1, 0, 1], [0, 1, 2, 2]] = 0
    if (fx or fy) and np.abs(rest).max() > 1e-6 * abs(fx):
        raise ValueError("expected a matrix [fx 0 cx; 0 fy cy; 0 0 1], without a skew")
    return fx, fy, cx, cy


# The formats ---------------------------------------------------------------------------
def list_cameras(document: Any) -> tuple[str, dict[str, Any]]:
    """Tell the format of a document, and its cameras by name, unread; none, if it is of no format."""
    if not isinstance(document, dict):
        return "", {}
    if "rig" in document:
        found = document["rig"]["camera"]
        parts = found if isinstance(found, list) else [found]
        return VICALIB, {f"camera{index}": part for index, part in enumerate(parts)}
    if ROWS in document:
        rows = document[ROWS]
        if [len(row) for row in rows] in ([3] * 3, [4] * 3, [4] * 4):
            return "rows of a matrix, taken for a pinhole's", _list_named({"matrix": rows})
        is_camera = all(len(row) > 4 and isinstance(row[1], str) for row in rows)
        return COLMAP, {f"{row[0]:g}": row for row in rows} if is_camera else {}
    known = "OpenCV, ROS, Kalibr, ORB-SLAM, nerfstudio, NumPy or C3VD"
    return f"by its names, as of {known}", _list_named(document)


def make_camera(form: str, part: Any, given: Size | None) -> Camera:
    """Read one of the cameras that `list_cameras` found; `given` is the size, if the file does not say."""
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
    if "a0" in part:
        a = numbers([part.get(f"a{power}", 0.0) for power in range(5)])
        part = {"c": 1.0, "d": 0.0, "e": 0.0} | part
        cx, cy, *affine = numbers([part[name] for name in ("cx", "cy", "c", "d", "e")])
        return Scaramuzza(*_size(part, given), cx, cy, a, *affine)  # type: ignore
    kind = _kind_of(part)
    focal_and_centre = _focal_and_centre(part)
    k = _coefficients(part, kind)
    width, height = _size(part, given)
    document = part["document"]
    roi = document.get("roi")
    roi = roi if isinstance(roi, dict) else {}
    cut = [roi.get(name, 0) for name in ("x_offset", "y_offset", "width", "height")]
    is_whole = cut in ([0, 0, 0, 0], [0, 0, width, height])
    binning = max(document.get("binning_x", 0), document.get("binning_y", 0))
    if not is_whole or binning > 1:
        raise ValueError(
            "binning and roi must be of whole pictures; write the camera of these pictures"
        )
    return _camera(kind, (width, height), focal_and_centre, k)
