"""Pictures, masks and frames in files."""

from __future__ import annotations

import io
import logging
import warnings
import zlib
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from endolab.io.atomic import PathLike, name_damage, read_bytes, write_atomically
from endolab.io.quiet import quiet
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.memory import check_memory

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL.Image import Image

    from endolab.frames.frame import Frame
    from endolab.model.endoscope import Calibration

DECODED = 32  # bytes a pixel while a picture is read: three channels of 8 bytes, and what was stored
FORMATS = ("PNG", "JPEG", "TIFF", "BMP")
PICTURE = "a picture that can be read (PNG, JPEG, TIFF or BMP of 8 or 16 bits, at most 178 million pixels)"
PNG = b"\x89PNG\r\n\x1a\n"
# Chunks of a PNG that its picture depends on, and how that is to be turned.
PNG_CHUNKS = (b"IHDR", b"PLTE", b"tRNS", b"eXIf", b"IDAT", b"IEND")
JPEG = b"\xff\xd8"
# Of a JPEG: before its pixels, and after them.
SCAN = b"\xff\xda"
END = b"\xff\xd9"
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

    Stored values over their maximum (255 or 65535); R, G, B. OSError or
    ValueError in one sentence, if there is no such file or it is not such a picture; MemoryError, if it is
    too large for this machine.
    """
    return _in_unit(read_stored(path), path)


def _in_unit(stored: np.ndarray, path: PathLike) -> FloatArray:
    if stored.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"{path}: expected 8 or 16 bits a channel, found {stored.dtype}")
    return stored / float(np.iinfo(stored.dtype).max)


def read_stored(path: PathLike) -> np.ndarray:
    """Read a picture as the numbers that the file holds, R, G, B; errors as of `read_image`."""
    from PIL import Image

    content = read_bytes(path)
    # Pillow refuses sizes that no picture has, where OpenCV does not.
    with name_damage(path, PICTURE), quiet, warnings.catch_warnings(action="ignore"):
        if content.startswith(PNG):
            content = _bare_png(content)
        picture = Image.open(io.BytesIO(content), formats=FORMATS)
        # Else all of it would be decoded.
        at_hand = picture.format != "PNG" or "exif" in picture.info
        orientation = 274  # the tag that says how a picture is to be turned
        is_turned = at_hand and picture.getexif().get(orientation, 1) != 1
    columns, rows = picture.size
    check_memory(columns * rows * DECODED, f"{path}: a picture of {columns}x{rows} px")
    if is_turned and picture.format == "TIFF":  # which OpenCV turns, alone of all
        raise ValueError(f"{path} is marked to be shown turned: save it without that mark")
    with name_damage(path, PICTURE), quiet, warnings.catch_warnings(action="ignore"):
        if content.startswith(JPEG):  # of which OpenCV prints what is wrong
            if END not in content[content.rfind(SCAN) :]:
                raise ValueError
            stored = np.array(picture.convert("RGB") if picture.mode == "CMYK" else picture)
        else:
            encoded = np.frombuffer(content, np.uint8)
            stored = np.asarray(cv2.imdecode(encoded, cv2.IMREAD_UNCHANGED))
        if stored.shape[1::-1] != (columns, rows):
            raise ValueError
    if _is_clear(stored, picture):
        raise ValueError(
            f"{path} is transparent in part: save it without that, and say by a mask what is to be used"
        )
    if is_turned:
        say_turned(path)
    if stored.ndim == 2 or content.startswith(JPEG):
        return stored
    is_grey = content.startswith(PNG) and content[25] == 4  # grey and alpha
    return stored[..., 0] if is_grey else stored[..., 2::-1]


def _is_clear(stored: np.ndarray, picture: Image) -> bool:
    """Whether a picture is transparent somewhere, or may be."""
    if stored.shape[2:] == (4,):
        return bool(np.ptp(stored[..., 3]) > 0)
    return picture.mode == "LA" or (stored.ndim == 2 and "transparency" in picture.info)


def _bare_png(content: bytes) -> bytes:
    """Return a PNG without what is beside its picture, of which libpng would print what is wrong.

    ValueError, if the picture is not whole.
    """
    parts = [PNG]
    at = len(PNG)
    while at < len(content):
        end = at + 12 + int.from_bytes(content[at : at + 4])
        chunk = content[at:end]
        name = chunk[4:8]
        if name in PNG_CHUNKS:
            if zlib.crc32(chunk[4:-4]) != int.from_bytes(chunk[-4:]):
                raise ValueError
            parts.append(chunk)
        if name == b"IEND":
            return b"".join(parts)
        at = end
    raise ValueError


def say_turned(name: PathLike) -> None:
    """Say that a picture, or a video, is not turned as it is marked to be."""
    message = "%s is marked to be shown turned; it is read as the sensor saw it, as its calibration is"
    log.warning(message, name)


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
    """Read a mask, (H, W): True where the picture is brighter than half."""
    image = read_image(path)
    return (image if image.ndim == 2 else image.max(axis=-1)) > 0.5


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
        A picture of the frame's size, bright where the frame is to be used.

    Returns
    -------
    Frame
        Stored values in [0, 1] and the pixels that are to be used.

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

    stored = read_stored(path)
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
    return Frame(image, inside, Path(path).name)
