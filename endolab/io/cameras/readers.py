"""What each kind of calibration file says of its cameras.

Pixels: endolab, OpenCV, ROS and Kalibr count from 0 at the centre of the first pixel, COLMAP and nerfstudio
from 0 at its corner. Vicalib does not say, and is taken as OpenCV.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from endolab.io.cameras.documents import ROWS
from endolab.model.cameras import BrownConrady, Camera, KannalaBrandt, Pinhole, Scaramuzza
from endolab.numerics.checks import shorten

Size = tuple[int, int]  # columns and rows, px
NAMED = "by its names, as of OpenCV, ROS, ORB-SLAM, nerfstudio or NumPy"
MATRIX = "rows of a matrix, taken for a pinhole's"
KALIBR = "Kalibr's camchain"
COLMAP = "COLMAP's cameras.txt"
VICALIB = "Vicalib's XML"
C3VD = "C3VD's a0 to a4"
BROWN = "brown"
FISHEYE = "fisheye"

# All names below are without case and punctuation.
# The lenses of all programs, which are of two kinds.
LENSES = {
    FISHEYE: r"equi(distant)?|(opencv|(simple)?(radial)?)fisheye|kannalabrandt[48]?|calibufufvu0v0kb4",
    BROWN: r"none|radtan|radialtangential|plumbbob|rationalpolynomial|rectified|brown(conrady)?|"
    r"(simple)?(pinhole|radial)|(full)?opencv|calibufufvu0v0(k1k2(k3)?|rational6)?",
}
# What may stand before a name and says nothing.
WORDS = r"(?:raw|input|camera|cam|image|img|intrinsics?|calibration|distortion|size|opencvstorage)"
# What a name means, by the value it has: a number, a text, or a list of so many numbers, or of any.
TERMS: tuple[str, ...] = (
    "k1",
    "k2",
    "p1",
    "p2",
    "k3",
    "k4",
    "k5",
    "k6",
)  # OpenCV's coefficients, in its order
NUMBER = {term: term for term in TERMS} | {
    "width": "width|w|nx",
    "height": "height|h|ny",
    "f": "f|focal(length)?",
    "fx": "fx|fu|focal(length)?x",
    "fy": "fy|fv|focal(length)?y",
    "flx": "flx",  # nerfstudio's
    "fly": "fly",
    "cx": "cx|ppx|u0|principalpointx",
    "cy": "cy|ppy|v0|principalpointy",
    "skew": "skew|alphac",
    "fisheye": "(is)?fisheye(model)?",
}
TEXT = {
    "model": "distortion(model|type)?",
    "lens": "model|(camera|lens|projection)(model|type)",
}
LIST = {
    "size": "size|resolution",
    "f": "f|fc|focal(length)?",
    "c": "c|cc|cent(er|re)|principalpoint",
    "four": "intrinsics",
    "unsure": "k|kc|coeffs|dist(ortion)?param(eter)?s",  # whose four may be of either kind
    "k": "d|dist(ortion)?(coeff?(icient)?s?)?",
    "matrix": "k|kk|m|mtx|matrix|intrinsics",
}
COUNTS = {"four": (4,), "unsure": (4, 5, 8, 12, 14)}
# What else a file may say, and is not asked for: errors, flags, boards, poses, what was rectified.
PASSING = re.compile(
    r"err|\brms|\bstd|flag|board|pattern|square|marker|grid|corner|pose|[rt]vec|points|rectif|proj|"
    r"\broi|rotation|transl|transform|extrin|essential|fundamental|time|\bnew|\b[rpteqf]\d?\b"
)
OF_A_LENS = re.compile(r"radial|tangential|distort|coeff|(k[1-6]|p[12])$")
OF_A_SIZE = re.compile(r"width|height|cols|columns|rows|size|shape|resolution")
# mrcal's and MATLAB's
GONE = {"lensmodel", "RadialDistortion", "MappingCoefficients", "ss"}


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


def _few_numbers(value: Any) -> list[float]:
    """Return the numbers of a number, a list, a row or a column, of 16 at most; none of all else."""
    rows = [one if isinstance(one, list) else [one] for one in _as_list(value)[:17]]
    found = [one for row in rows for one in row[:17]]
    is_flat = min(len(rows), *map(len, rows), 17) < 2 and len(found) < 17
    return found if is_flat and all(type(n) in (int, float) for n in found) else []


def _as_list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _plain(name: str) -> str:
    return re.sub(r"[\W_]", "", name).lower()


def _lens(name: str) -> str:
    """Return the kind of a lens."""
    for kind, pattern in LENSES.items():
        if re.fullmatch(pattern, _plain(name)):
            return kind
    is_kalibrs = _plain(name) in ("ds", "eucm", "omni")
    way = "; calibrate with Kalibr's --models pinhole-equi" if is_kalibrs else ""
    raise ValueError(f"no lens {shorten(name)} is known here{way}")


def _size(part: dict[str, Any], given: Size | None) -> Sequence[float]:
    """Return the size of the pictures that a file states, or the one given."""
    if "size" in part:
        return numbers(part["size"], 2)
    if "width" in part:
        return numbers([part["width"], part["height"]], 2)
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
        way = "; calibrate without a thin prism or a tilted sensor" if len(k) > 8 else ""
        raise ValueError(
            f"expected {most} coefficients of a {kind} lens, found {len(k)}{way}"
        )
    # Where a size is not whole, the class says so.
    if kind == BROWN and not any(k):
        return Pinhole(*size, *centre)  # type: ignore[arg-type]
    return lens(*size, *centre, (*k, *[0.0] * 8)[:most])  # type: ignore


# Names ---------------------------------------------------------------------------------
def _leaves(
    value: Any, path: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Go through what a document says: keys, from the outermost on, and a number, a text or a list."""
    is_matrix = isinstance(value, dict) and isinstance(value.get("data"), list)
    inner = value if isinstance(value, dict) and not is_matrix else {}
    if isinstance(value, list) and value and isinstance(value[0], dict):
        inner = dict(enumerate(value))
    for key, one in inner.items() if len(path) < 5 else ():
        yield from _leaves(one, (*path, *str(key).split(".")))
    if not inner:
        yield path, value["data"] if is_matrix else value


def _meaning(name: str, value: Any) -> tuple[str, str]:
    """Tell what a name means, and of which of several cameras; twice "" if it is not known."""
    table = TEXT if isinstance(value, str) else LIST if isinstance(value, list) else NUMBER
    for meaning, names in table.items():
        pattern = rf"{WORDS}*(left|right|[0-3])?{WORDS}*(?:{names})(left|right|[0-3lr])?"
        found = re.fullmatch(pattern, name)
        if found and len(_few_numbers(value)) in COUNTS.get(meaning, range(17)):
            return meaning, found[1] or found[found.re.groups] or ""
    return "", ""


def _read_names(document: Any) -> list[tuple[str, str, str, Any]]:
    """List what a document says: of which camera, meaning what, under what name, and the value."""
    said = []
    for path, value in _leaves(document):
        outer = [key for key in path[:-1] if not re.fullmatch(f"{WORDS}+", _plain(key))]
        inner = [key for key in path[:-1] if re.fullmatch(f"{WORDS}+", _plain(key))]
        meaning, tag = _meaning(_plain("".join([*inner, *path[-1:]])), value)
        said.append((" ".join([*outer, tag]).strip(), meaning, ".".join(path), value))
    return said


def _understood(said: list[tuple[str, str, str, Any]], whose: str) -> dict[str, Any]:
    """What is said of one of the cameras, by its meaning; the first, if it is said twice."""
    return {
        meaning: value for one, meaning, _, value in said[::-1] if meaning and one == whose
    }


def _list_named(document: Any) -> dict[str, Any]:
    """Find each camera of a document, and the kinds of lens that it may have."""
    said = _read_names(document)
    found = {whose: _understood(said, whose) for whose, *_ in said}
    found = {
        whose: own
        for whose, own in found.items()
        if own.keys() & {"matrix", "four", "fx", "flx"}
        or ("f" in own and own.keys() & {"c", "cx"})
    }
    cameras: dict[str, Any] = {}
    for whose, own in found.items():
        part = _understood(said, "") | own | {"document": document}
        if "matrix" not in own:
            part.pop("matrix", None)
        part["unread"] = {
            name: value
            for one, meaning, name, value in said
            if one not in ("", *found) or (not meaning and one in ("", whose))
        }
        k = part.get("k", part.get("unsure"))
        kinds = [BROWN]
        if len(numbers(k)) == 4 if k is not None else "k4" in part and "p1" not in part:
            # The first, which nobody has named, is OpenCV's fisheye, or refused.
            kinds = [FISHEYE, BROWN] if "k" in part else ["", FISHEYE, BROWN]
        named = [_lens(part[name]) for name in ("model", "lens") if name in part]
        if "fisheye" in part:
            named.append(FISHEYE if part["fisheye"] else BROWN)
        if named:
            kinds = [FISHEYE if FISHEYE in named else BROWN]
        cameras |= {f"{whose} {kind}".strip(): part | {"kind": kind} for kind in kinds}
    return cameras


def _refuse_unread(part: dict[str, Any], is_lens: bool) -> None:
    """Raise ValueError where something under another name may be coefficients of the lens, or the size."""
    for name, value in part["unread"].items():
        found = _few_numbers(value)
        plain = _plain(name)
        what = "dist_coeffs, and say whether it is a fisheye's"
        is_like = any(found) and (4 <= len(found) <= 14 or OF_A_LENS.search(plain))
        if not is_lens:
            what = "image_width and image_height"
            is_like = len(found) in (2, 3) or OF_A_SIZE.search(plain)
            is_like = is_like and all(n >= 32 and n == int(n) for n in (found or [0])[:2])
        if is_like and not PASSING.search(" ".join(map(_plain, name.split(".")))):
            many = f"{len(found)} number{'s' * (len(found) > 1)}"
            raise ValueError(f"not understood: {shorten(name)} ({many}); call it {what}")


def _coefficients(part: dict[str, Any]) -> tuple[float, ...]:
    """Return the coefficients of a lens in OpenCV's order."""
    kind = part["kind"]
    if not kind:
        raise ValueError(
            "four coefficients, a fisheye's or Brown's? Add fisheye_model: 1 (or 0) to the file, "
            "or #fisheye (or #brown) to its name"
        )
    for name in ("k", "unsure"):
        if name in part:
            k = numbers(part[name])
            if len(k) not in (0, 4, 5, 8, 12, 14):
                raise ValueError(f"expected 4, 5 or 8 coefficients, found {len(k)}")
            return k
    # nerfstudio's k4 is no rational polynomial's, unless k5 is there.
    order = TERMS if "k5" in part else TERMS[:5]
    if kind == FISHEYE:
        order = ("k1", "k2", "k3", "k4")
    for name in part.keys() & {*TERMS}.difference(order):
        if part[name]:
            raise ValueError(f"{name} is none of a {kind} lens with {', '.join(order)}")
    if not part.keys() & {*TERMS}:
        _refuse_unread(part, True)
    return numbers([part.get(name, 0.0) for name in order])


def _focal_and_centre(part: dict[str, Any]) -> tuple[float, ...]:
    """Return fx, fy, cx and cy; ValueError if the pixels are skewed."""
    if "matrix" in part:
        found = numbers(part["matrix"])
        columns = 3 if len(found) == 9 else 4  # with a shift, which must be none
        matrix = np.zeros((4, 4))
        matrix[3, 3] = 1
        if len(found) not in (9, 12, 16):
            raise ValueError(f"expected a matrix of 9 numbers, found {len(found)}")
        matrix[: len(found) // columns, :columns] = np.reshape(found, (-1, columns))
        (fx, skew, cx, _), (_, fy, cy, _) = matrix[:2].tolist()
        if not matrix[:3, :3].any() or (fx == 0 and fy == 0):
            fx = fy = 0.0
        rest = matrix - [[fx, skew, cx, 0], [0, fy, cy, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
        part = part | {"skew": skew if abs(skew) > 1e-6 * abs(fx) else 0.0}
        if fx and rest.any():
            raise ValueError("expected a matrix [fx 0 cx; 0 fy cy; 0 0 1]")
        found = (fx, fy, cx, cy)
    elif "four" in part:
        found = numbers(part["four"], 4)
    elif "flx" in part:
        fx, fy, cx, cy = numbers([part[name] for name in ("flx", "fly", "cx", "cy")])
        found = (fx, fy, cx - 0.5, cy - 0.5)
    else:
        f = part["f"] if "f" in part else [part["fx"], part["fy"]]
        c = part["c"] if "c" in part else [part["cx"], part["cy"]]
        found = (*(numbers(f) * 2)[:2], *numbers(c, 2))
    if part.get("skew"):
        raise ValueError("expected pixels without a skew")
    return found


# The formats ---------------------------------------------------------------------------
def list_cameras(document: Any) -> tuple[str, dict[str, Any]]:
    """Tell the format of a document, and its cameras by name, unread; none, if it is of no format."""
    if not isinstance(document, dict) or GONE & document.keys():
        return "", {}
    if "rig" in document:
        found = _as_list(document["rig"]["camera"])
        return VICALIB, {f"camera{index}": part for index, part in enumerate(found)}
    chain = {name: document[name] for name in document if re.fullmatch(r"cam\d+", name)}
    if chain:
        return KALIBR, chain
    if ROWS in document:
        rows = document[ROWS]
        if [len(row) for row in rows] in ([3] * 3, [4] * 3, [4] * 4):
            return MATRIX, _list_named({"matrix": rows})
        is_camera = all(len(row) > 4 and isinstance(row[1], str) for row in rows)
        return COLMAP, {f"{row[0]:g}": row for row in rows} if is_camera else {}
    flat = document.get("camera", document)
    if isinstance(flat, dict) and "a0" in flat:
        return C3VD, {"": flat | _understood(_read_names(flat), "")}
    return NAMED, _list_named(document)


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
    if form == C3VD:
        a = numbers([part.get(f"a{power}", 0.0) for power in range(5)])
        part = {"c": 1.0, "d": 0.0, "e": 0.0} | part
        cx, cy, *affine = numbers([part[name] for name in ("cx", "cy", "c", "d", "e")])
        return Scaramuzza(*_size(part, given), cx, cy, a, *affine)  # type: ignore
    if form == KALIBR:
        named = _list_named(part)
        if not named:
            raise KeyError("intrinsics")
        part = next(iter(named.values()))
    focal_and_centre = _focal_and_centre(part)
    k = _coefficients(part)
    if not part.keys() & {"size", "width"}:
        _refuse_unread(part, False)
    width, height = _size(part, given)
    document = part["document"]
    roi = document.get("roi", {})
    cut = [roi.get(name, 0) for name in ("x_offset", "y_offset", "width", "height")]
    is_whole = cut in ([0, 0, 0, 0], [0, 0, width, height])
    binning = max(document.get("binning_x", 0), document.get("binning_y", 0))
    if not is_whole or binning > 1:
        raise ValueError(
            "binning and roi must be of whole pictures; write the camera of these pictures"
        )
    return _camera(part["kind"], (width, height), focal_and_centre, k)
