"""Pictures, masks and frames in files."""

from __future__ import annotations

import io
import logging
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from endolab.io.atomic import PathLike, name_damage, read_bytes, write_atomically
from endolab.io.damaged import END, ENOUGH, JPEG, PNG, SCAN, bare_png, mend
from endolab.io.quiet import quiet
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.checks import PATH, check_kinds
from endolab.numerics.memory import check_memory

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL.ImageFile import ImageFile

    from endolab.frames.frame import Frame

DECODED = 32  # bytes a pixel while a picture is read: three channels of 8 bytes, and what was stored
FORMATS = ("PNG", "JPEG", "TIFF", "BMP")
PICTURE = "a picture that can be read (PNG, JPEG, TIFF or BMP of 8 or 16 bits, at most 178 million pixels)"
# How what has been turned by it is turned back.
AS_SEEN: dict[int, Callable[[np.ndarray], np.ndarray]] = {
    2: np.fliplr,
    3: lambda a: np.rot90(a, 2),
    4: np.flipud,
    5: lambda a: np.swapaxes(a, 0, 1),
    6: np.rot90,
    7: lambda a: np.rot90(np.swapaxes(a, 0, 1), 2),
    8: lambda a: np.rot90(a, -1),
}
OPAQUE = 0.995  # of the largest alpha; with less, a pixel is mixed with what lies beneath
log = logging.getLogger("endolab")


def write_image(path: PathLike, image: FloatArray, bits: int = 8) -> None:
    """Write a grey or RGB picture with values in [0, 1] as PNG of 8 or 16 bits."""
    stored = np.round(np.clip(image, 0, 1) * (2**bits - 1)).astype(
        np.uint8 if bits == 8 else np.uint16
    )
    write_atomically(path, _as_png(stored[..., ::-1] if stored.ndim == 3 else stored))


def as_png(figure: Figure) -> bytes:
    """Encode a figure of matplotlib as PNG: what its `savefig` does, which draws one with a layout twice."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    # As small as Matplotlib's, in a third of the time.
    options = (cv2.IMWRITE_PNG_COMPRESSION, 1)
    return _as_png(np.asarray(canvas.buffer_rgba())[..., 2::-1], options)


def _as_png(stored: np.ndarray, options: Sequence[int] = ()) -> bytes:
    """Encode stored values, channels in OpenCV's order."""
    return cv2.imencode(".png", stored, options)[1].tobytes()


def write_figure(path: PathLike, figure: Figure) -> None:
    """Write a figure of matplotlib as PNG."""
    write_atomically(path, as_png(figure))


def read_image(path: PathLike) -> FloatArray:
    """Read a grey or colour picture of 8 or 16 bits (PNG, JPEG, TIFF, BMP) as (H, W) or (H, W, 3).

    Stored values over their maximum (255 or 65535); R, G, B. What is transparent is black. OSError or
    ValueError in one sentence, if there is no such file or it is not such a picture; MemoryError, if it is
    too large for this machine.
    """
    return _in_unit(read_stored(path), path)


def _in_unit(stored: np.ndarray, path: PathLike) -> FloatArray:
    if stored.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"{path}: expected 8 or 16 bits a channel, found {stored.dtype}")
    return stored / float(np.iinfo(stored.dtype).max)


def read_stored(path: PathLike) -> np.ndarray:
    """Read a picture as the numbers that the file holds, R, G, B; 0 where it is transparent."""
    return decode(read_bytes(path), path)[0]


def read_floats(path: PathLike, what: str) -> np.ndarray:
    """Read a TIFF of integers or floats, or an EXR if OpenCV can; channels in the file's order.

    `what` says what it should be; errors as of `read_image`.
    """
    content = np.frombuffer(read_bytes(path), np.uint8)
    with name_damage(path, what), quiet:
        stored: np.ndarray | None = cv2.imdecode(content, cv2.IMREAD_UNCHANGED)
    if stored is None:
        hint = "; this OpenCV may not read EXR" if str(path).endswith(".exr") else ""
        raise ValueError(f"{path}: expected {what}{hint}")
    return stored[..., ::-1] if stored.ndim == 3 else stored


def decode(content: bytes, name: PathLike) -> tuple[np.ndarray, FloatArray]:
    """Decode the content of a picture's file as `read_stored` does; errors call it `name`.

    Also returns alpha, (H, W), over its largest, and nan in rows that are cut off.
    """
    try:
        stored, alpha = _decode(content, name)
        whole = len(stored)
    except ValueError:
        with name_damage(name, PICTURE), quiet, warnings.catch_warnings(action="ignore"):
            content, whole, rows = mend(content)
        lack = f"only {whole} of its {rows} rows are whole"
        if whole < ENOUGH * rows:
            raise ValueError(f"{name} is damaged: {lack}") from None
        stored, alpha = _decode(content, name)
        log.warning(
            "%s is damaged: %s", name, lack if whole < rows else "only its picture is whole"
        )
    if not alpha.any():
        raise ValueError(f"{name} is completely transparent: there is no pixel to use")
    alpha = alpha / alpha.max()  # in 16 bits, what is opaque may have 255, or 65280
    alpha[whole:] = np.nan
    stored[~(alpha >= OPAQUE)] = 0
    return stored, alpha


def _decode(content: bytes, name: PathLike) -> tuple[np.ndarray, np.ndarray]:
    """Return what is stored, R, G, B, and alpha, (H, W), in any unit."""
    from PIL import Image

    # Pillow refuses what is cut off, and sizes that no picture has, where OpenCV does not.
    with name_damage(name, PICTURE), quiet, warnings.catch_warnings(action="ignore"):
        picture = Image.open(io.BytesIO(content), formats=FORMATS)
        # Else all of it would be decoded.
        at_hand = picture.format != "PNG" or "exif" in picture.info
        orientation = 274  # the tag that says how a picture is to be turned
        turned = picture.getexif().get(orientation, 1) if at_hand else 1
    columns, rows = picture.size
    check_memory(columns * rows * DECODED, f"{name}: a picture of {columns}x{rows} px")
    with name_damage(name, PICTURE), quiet, warnings.catch_warnings(action="ignore"):
        if content.startswith(JPEG):  # of which OpenCV prints what is wrong
            if END not in content[content.rfind(SCAN) :]:
                raise ValueError
            stored = np.array(picture.convert("RGB") if picture.mode == "CMYK" else picture)
            alpha = np.ones((rows, columns))
        else:
            stored, alpha = _with_alpha(content, picture)
        if stored.shape[1::-1] != (columns, rows):
            raise ValueError
    if turned != 1:
        say_turned(name)
    if picture.format == "TIFF" and turned in AS_SEEN:  # alone of all, it has been turned
        return AS_SEEN[turned](stored), AS_SEEN[turned](alpha)
    return stored, alpha


def _with_alpha(content: bytes, picture: ImageFile) -> tuple[np.ndarray, np.ndarray]:
    """Decode a PNG, TIFF or BMP by OpenCV; where that leaves alpha out, find it."""
    from PIL import Image

    Image.open(io.BytesIO(content), formats=FORMATS).verify()  # the checksums of a PNG
    is_png = content.startswith(PNG)
    if is_png and b"IEND\xaeB`\x82" not in content:  # its last chunk, and the checksum
        raise ValueError
    readable = bare_png(content) if is_png else content
    stored: np.ndarray = np.asarray(
        cv2.imdecode(np.frombuffer(readable, np.uint8), cv2.IMREAD_UNCHANGED)
    )
    alpha: np.ndarray = (
        stored[..., 3] if stored.shape[2:] == (4,) else np.ones(stored.shape[:2])
    )
    if stored.ndim == 3:
        is_grey = is_png and content[25] == 4  # its colour type: grey and alpha
        stored = stored[..., 0] if is_grey else stored[..., 2::-1]
    args = picture.tile[0].args or ("",)
    if args[0] == "BGRX":  # a BMP's fourth byte is unused, or alpha
        pixels = content[picture.tile[0].offset :]
        alpha = np.asarray(
            Image.frombytes("RGBA", picture.size, pixels, "raw", "BGRA", *args[1:])
        )[..., 3]
    elif picture.mode == "LA":
        alpha = np.asarray(picture)[..., 1]
    elif stored.ndim == 2 and "transparency" in picture.info:  # one grey of 1 to 16 bits
        most = np.iinfo(stored.dtype).max
        alpha = stored != min(
            picture.info["transparency"] * (most // (2 ** content[24] - 1)), most
        )
    return stored, alpha if alpha.any() or not content.startswith(b"BM") else np.ones(
        alpha.shape
    )


def say_turned(name: PathLike) -> None:
    """Say that a picture, or a video, is not turned as it is marked to be."""
    message = "%s is marked to be shown turned; it is read as the sensor saw it, as its calibration is"
    logging.getLogger("endolab").warning(message, name)


def is_picture(path: PathLike) -> bool:
    """Whether a file is a picture of one of the `FORMATS` by how it begins, whatever it is called."""
    from PIL import Image

    with (
        suppress(Exception),  # packages promise nothing about which, if it is none
        warnings.catch_warnings(action="ignore"),
        Image.open(path, formats=FORMATS),
    ):
        return True
    return False


def read_mask(path: PathLike) -> BoolArray:
    """Read a mask, (H, W): True where the picture is brighter than half.

    If part of it is transparent, True elsewhere, unless black and white are drawn there.
    """
    stored, alpha = decode(read_bytes(path), path)
    image = _in_unit(stored, path)
    level = image if image.ndim == 2 else image.max(axis=-1)
    bright = level > 0.5
    is_drawn = bright.any() and np.mean(np.abs(level[alpha >= OPAQUE] - 0.5) > 0.48) > 0.9
    return bright if np.nanmin(alpha) == 1 or is_drawn else alpha > 0.5


@check_kinds(path=PATH, calibration=Calibration, mask=PATH)
def read_frame(
    path: PathLike, calibration: Calibration | None = None, mask: PathLike | None = None
) -> Frame:
    """Read a frame, and its mask if there is one.

    Parameters
    ----------
    path : path
        PNG, JPEG, TIFF or BMP of 8 or 16 bits, grey or colour.
    calibration : Calibration, optional
        If given, the frame must have its size.
    mask : path, optional
        A picture of the frame's size, bright where the frame is to be used, or transparent elsewhere.

    Returns
    -------
    Frame
        Stored values in [0, 1] and the pixels that are to be used, all of them opaque.

    Raises
    ------
    OSError, ValueError
        In one sentence, if a file cannot be used.
    MemoryError
        If it is too large for this machine, before it is decoded.

    Examples
    --------
    >>> import endolab as el
    >>> from matplotlib.pyplot import imsave
    >>> sample = el.load_traced("matt")
    >>> imsave("frame.png", sample.frame.image)
    >>> frame = el.read_frame("frame.png", sample.calibration)
    >>> frame.image.shape, frame.mask.dtype
    ((240, 320, 3), dtype('bool'))
    """
    # Here, for who only writes pictures needs no compiled loops.
    from endolab.frames.frame import Frame, check_size

    stored, alpha = decode(read_bytes(path), path)
    image = _in_unit(stored, path)
    rows, columns = image.shape[:2]
    if calibration is not None:
        check_size(str(path), (columns, rows), calibration.camera)
    bits = int(stored.max()).bit_length()
    if stored.dtype == np.uint16 and 0 < bits < 16:
        hint = "%s uses %d of its 16 bits; unless it is so dark, multiply its values by %d"
        log.warning(hint, path, bits, 2 ** (16 - bits))
    inside = np.ones((rows, columns), dtype=bool) if mask is None else read_mask(mask)
    if inside.shape != (rows, columns):
        shape = f"{inside.shape[1]}x{inside.shape[0]} px"
        raise ValueError(f"the mask {mask} is {shape}, the frame {columns}x{rows} px")
    if not inside.any():
        raise ValueError(f"the mask {mask} is empty: no pixel in it is brighter than half")
    opaque = alpha >= OPAQUE
    if not opaque.all():
        log.warning(
            "%s: %.3g %% of it is transparent or missing, and left out",
            path,
            100 * np.mean(~opaque),
        )
        inside &= opaque
        if not inside.any():
            raise ValueError(f"{path} is transparent or missing wherever it would be used")
    return Frame(image, inside, Path(path).name)
