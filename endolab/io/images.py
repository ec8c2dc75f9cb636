"""Pictures, masks and frames in files."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from endolab.io.atomic import PathLike, write_atomically
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.preprocessing.frame import Frame, check_size

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from endolab.model.endoscope import Endoscope


def write_image(path: PathLike, image: FloatArray, bits: int = 8) -> None:
    """Write a grey or RGB picture with values in [0, 1] as PNG of 8 or 16 bits."""
    stored = np.round(np.clip(image, 0, 1) * (2**bits - 1)).astype(np.uint8 if bits == 8 else np.uint16)
    done, content = cv2.imencode(".png", stored[..., ::-1] if stored.ndim == 3 else stored)
    if not done:
        raise ValueError(f"cannot encode {path} as PNG")
    write_atomically(path, content.tobytes())


def write_figure(path: PathLike, figure: Figure) -> None:
    """Write a figure of matplotlib as PNG."""
    content = io.BytesIO()
    figure.savefig(content, format="png")
    write_atomically(path, content.getvalue())


def read_image(path: PathLike) -> FloatArray:
    """Read a grey or colour picture of 8 or 16 bits (PNG, JPEG, TIFF) as (H, W) or (H, W, 3).

    Stored values over their maximum (255 or 65535); R, G, B. An alpha channel is dropped. OSError or
    ValueError in one sentence, if there is no such file or it is not such a picture.
    """
    stored = read_stored(path)
    if stored.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"{path}: expected 8 or 16 bits a channel, found {stored.dtype}")
    if stored.ndim == 3:  # grey with alpha, or BGR(A) to RGB
        stored = stored[..., 0] if len(stored[0, 0]) == 2 else stored[..., 2::-1]
    return stored / float(np.iinfo(stored.dtype).max)


def read_stored(path: PathLike) -> np.ndarray:
    """Read a picture as the numbers that the file holds, channels in OpenCV's order."""
    source = Path(path)
    if not source.exists():
        raise FileNotFoundError(f"{source}: there is no such file")
    try:
        content = source.read_bytes()
    except OSError as error:
        raise OSError(f"{source}: cannot be read: {error.strerror or error}") from error
    level = cv2.utils.logging.setLogLevel(0)  # what OpenCV would print is said in the exception
    try:
        stored = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED) if content else None
    except cv2.error:
        stored = None
    finally:
        cv2.utils.logging.setLogLevel(level)
    if stored is None:
        raise ValueError(f"{source}: not a picture that can be read (PNG, JPEG or TIFF)")
    return stored


def _size(picture: np.ndarray) -> str:
    return f"{picture.shape[1]}x{picture.shape[0]} px"


def read_mask(path: PathLike) -> BoolArray:
    """Read a mask, (H, W): True where the picture is brighter than half."""
    image = read_image(path)
    return (image if image.ndim == 2 else image.max(axis=-1)) > 0.5


def read_frame(path: PathLike, calibration: Endoscope | None = None, mask: PathLike | None = None) -> Frame:
    """Read a frame, and its mask if there is one.

    Parameters
    ----------
    path : path
        PNG, JPEG or TIFF of 8 or 16 bits, grey or colour.
    calibration : Endoscope, optional
        If given, the frame must have its size.
    mask : path, optional
        A picture of the frame's size, bright where the frame is to be used.

    Raises
    ------
    OSError, ValueError
        In one sentence, if a file cannot be used.
    """
    image = read_image(path)
    if calibration is not None:
        check_size(str(path), (image.shape[1], image.shape[0]), calibration.camera)
    inside = np.ones(image.shape[:2], dtype=bool) if mask is None else read_mask(mask)
    if inside.shape != image.shape[:2]:
        raise ValueError(f"the mask {mask} is {_size(inside)}, the frame {_size(image)}")
    if not inside.any():
        raise ValueError(f"the mask {mask} is empty: no pixel in it is brighter than half")
    return Frame(image, inside, Path(path).name)
