"""Pictures, masks and frames in files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from endolab.io.atomic import PathLike, as_path, one_sentence, write_atomically
from endolab.io.picture_size import picture_size
from endolab.io.quiet import quiet
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.memory import check_memory

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from endolab.model.endoscope import Endoscope
    from endolab.preprocessing.frame import Frame

Check = Callable[[tuple[int, int]], None]  # refuses columns and rows by raising
DECODED = 32  # bytes a pixel while a picture is read: three channels of 8 bytes, and what was stored
DEFLATED = (
    cv2.IMWRITE_PNG_COMPRESSION,
    1,
)  # of a figure: as small as Matplotlib's, in a third of the time
UNREADABLE = "not a picture that can be read (PNG, JPEG, TIFF or BMP of 8 or 16 bits)"


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


def _as_png(stored: np.ndarray, how: Sequence[int] = ()) -> bytes:
    """Encode stored values, channels in OpenCV's order."""
    done, content = cv2.imencode(".png", stored, how)
    if not done:
        raise ValueError("cannot be encoded as PNG")
    return content.tobytes()


def write_figure(path: PathLike, figure: Figure) -> None:
    """Write a figure of matplotlib as PNG."""
    write_atomically(path, as_png(figure))


def read_image(path: PathLike, check: Check | None = None) -> FloatArray:
    """Read a grey or colour picture of 8 or 16 bits (PNG, JPEG, TIFF, BMP) as (H, W) or (H, W, 3).

    Stored values over their maximum (255 or 65535); R, G, B. An alpha channel is dropped. `check` as of
    `read_stored`. OSError or ValueError in one sentence, if there is no such file or it is not such a
    picture; MemoryError, if it is too large for this machine.
    """
    stored = read_stored(path, check)
    if stored.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"{path}: expected 8 or 16 bits a channel, found {stored.dtype}")
    if stored.ndim == 3:  # grey with alpha, or BGR(A) to RGB
        stored = stored[..., 0] if stored.shape[2] == 2 else stored[..., 2::-1]
    return stored / float(np.iinfo(stored.dtype).max)


def read_stored(path: PathLike, check: Check | None = None) -> np.ndarray:
    """Read a picture as the numbers that the file holds, channels in OpenCV's order.

    `check` is given columns and rows before anything is decoded, to refuse them by raising.
    """
    source = as_path(path)
    with one_sentence(f"{source}: cannot be read"):
        if not source.exists():
            raise FileNotFoundError(f"{source}: there is no such file")
        if not (source.is_file() or source.is_dir()):  # a pipe or a device may never end
            raise ValueError(f"{source}: not a file")
        with source.open("rb") as stream:
            size = picture_size(stream)
            if size is None:
                raise ValueError(f"{source}: {UNREADABLE}")
            if check is not None:
                check(size)
            needed = source.stat().st_size + size[0] * size[1] * DECODED
            check_memory(needed, f"{source}: a picture of {size[0]}x{size[1]} px")
            stream.seek(0)
            content = stream.read()
    try:
        with quiet():
            stored = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        stored = None
    if stored is None or stored.shape[1::-1] != size:
        raise ValueError(f"{source}: {UNREADABLE}")
    return stored


def read_mask(path: PathLike, check: Check | None = None) -> BoolArray:
    """Read a mask, (H, W): True where the picture is brighter than half; `check` as of `read_stored`."""
    image = read_image(path, check)
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

    Raises
    ------
    OSError, ValueError
        In one sentence, if a file cannot be used.
    MemoryError
        If it is too large for this machine, before it is decoded.
    """
    # Here, for who only writes pictures needs no compiled loops.
    from endolab.preprocessing.frame import Frame, check_size

    def fits(size: tuple[int, int]) -> None:
        if calibration is not None:
            check_size(str(path), size, calibration.camera)

    image = read_image(path, fits)

    def covers(size: tuple[int, int]) -> None:
        if size != (image.shape[1], image.shape[0]):
            frame = f"{image.shape[1]}x{image.shape[0]} px"
            raise ValueError(f"the mask {mask} is {size[0]}x{size[1]} px, the frame {frame}")

    inside = np.ones(image.shape[:2], dtype=bool) if mask is None else read_mask(mask, covers)
    if not inside.any():
        raise ValueError(f"the mask {mask} is empty: no pixel in it is brighter than half")
    return Frame(image, inside, Path(path).name)
