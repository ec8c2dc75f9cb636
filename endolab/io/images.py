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

from endolab.io.atomic import PathLike, damage_named, read_bytes, write_atomically
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.memory import check_memory

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from endolab.model.endoscope import Endoscope
    from endolab.preprocessing.frame import Frame

DECODED = 32  # bytes a pixel while a picture is read: three channels of 8 bytes, and what was stored
FORMATS = ("PNG", "JPEG", "TIFF", "BMP")
DEFLATED = (cv2.IMWRITE_PNG_COMPRESSION, 1)  # a figure as small as Matplotlib's, in a third of the time
PICTURE = "a picture that can be read (PNG, JPEG, TIFF or BMP of 8 or 16 bits, at most 178 million pixels)"
ORIENTATION = 274  # the tag that says how a picture is to be turned
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
# What these print of a damaged picture is said in one sentence.
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
logging.getLogger("PIL").addHandler(logging.NullHandler())


def write_image(path: PathLike, image: FloatArray, bits: int = 8) -> None:
    """Write a grey or RGB picture with values in [0, 1] as PNG of 8 or 16 bits."""
    stored = np.round(np.clip(image, 0, 1) * (2**bits - 1)).astype(np.uint8 if bits == 8 else np.uint16)
    write_atomically(path, _as_png(stored[..., ::-1] if stored.ndim == 3 else stored))


def as_png(figure: Figure) -> bytes:
    """Encode a figure of matplotlib as PNG: what its `savefig` does, which draws one with a layout twice."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return _as_png(np.asarray(canvas.buffer_rgba())[..., 2::-1], DEFLATED)


def _as_png(stored: np.ndarray, options: Sequence[int] = ()) -> bytes:
    """Encode stored values, channels in OpenCV's order."""
    return cv2.imencode(".png", stored, options)[1].tobytes()


def write_figure(path: PathLike, figure: Figure) -> None:
    """Write a figure of matplotlib as PNG."""
    write_atomically(path, as_png(figure))


def read_image(path: PathLike) -> FloatArray:
    """Read a grey or colour picture of 8 or 16 bits (PNG, JPEG, TIFF, BMP) as (H, W) or (H, W, 3).

    Stored values over their maximum (255 or 65535); R, G, B. An alpha channel is dropped. OSError or
    ValueError in one sentence, if there is no such file or it is not such a picture; MemoryError, if it is
    too large for this machine.
    """
    stored = read_stored(path)
    if stored.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"{path}: expected 8 or 16 bits a channel, found {stored.dtype}")
    if stored.ndim == 3:  # grey with alpha, or BGR(A) to RGB
        stored = stored[..., 0] if stored.shape[2] == 2 else stored[..., 2::-1]
    return stored / float(np.iinfo(stored.dtype).max)


def read_stored(path: PathLike) -> np.ndarray:
    """Read a picture as the numbers that the file holds, channels in OpenCV's order."""
    return decode(read_bytes(path), path)


def decode(content: bytes, name: PathLike) -> np.ndarray:
    """Decode the content of a picture's file as `read_stored` does; errors call it `name`."""
    from PIL import Image

    # Pillow refuses what is cut off, and sizes that no picture has, where OpenCV does not.
    with damage_named(name, PICTURE), warnings.catch_warnings(action="ignore"):
        picture = Image.open(io.BytesIO(content), formats=FORMATS)
        at_hand = picture.format != "PNG" or "exif" in picture.info  # else all of it would be decoded
        turned = picture.getexif().get(ORIENTATION, 1) if at_hand else 1
    columns, rows = picture.size
    check_memory(columns * rows * DECODED, f"{name}: a picture of {columns}x{rows} px")
    with damage_named(name, PICTURE), warnings.catch_warnings(action="ignore"):
        if picture.format == "JPEG":
            picture.load()
        else:
            picture.verify()  # the checksums of a PNG
        stored = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
        if stored is None or stored.shape[1::-1] != (columns, rows):
            raise ValueError
    if turned != 1:
        say_turned(name)
    if picture.format == "TIFF" and turned in AS_SEEN:  # alone of all, it has been turned
        stored = AS_SEEN[turned](stored)
    return np.asarray(stored)


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
    """Read a mask, (H, W): True where the picture is brighter than half."""
    image = read_image(path)
    return (image if image.ndim == 2 else image.max(axis=-1)) > 0.5


def read_frame(path: PathLike, calibration: Endoscope | None = None, mask: PathLike | None = None) -> Frame:
    """Read a frame, and its mask if there is one.

    Parameters
    ----------
    path : path
        PNG, JPEG, TIFF or BMP of 8 or 16 bits, grey or colour.
    calibration : Endoscope, optional
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
    from endolab.preprocessing.frame import Frame, check_size

    image = read_image(path)
    rows, columns = image.shape[:2]
    if calibration is not None:
        check_size(str(path), (columns, rows), calibration.camera)
    inside = np.ones((rows, columns), dtype=bool) if mask is None else read_mask(mask)
    if inside.shape != (rows, columns):
        shape = f"{inside.shape[1]}x{inside.shape[0]} px"
        raise ValueError(f"the mask {mask} is {shape}, the frame {columns}x{rows} px")
    if not inside.any():
        raise ValueError(f"the mask {mask} is empty: no pixel in it is brighter than half")
    return Frame(image, inside, Path(path).name)
