"""Pictures and frames of DICOM files, by pydicom."""

import logging
import warnings
from contextlib import suppress
from typing import Any

import cv2
import numpy as np

from endolab._extras import need
from endolab.io.atomic import PathLike, name_damage
from endolab.model.endoscope import Calibration
from endolab.numerics.memory import check_memory

WHAT = "a whole DICOM picture, grey or in colours, of 1 to 16 bits"
log = logging.getLogger("endolab")


def _read_head(path: PathLike) -> Any:
    """Read what a file says about its pixels; MissingPackage in one sentence, if there is no pydicom."""
    need("pydicom")
    from pydicom import dcmread

    with name_damage(path, WHAT):
        return dcmread(path, stop_before_pixels=True, force=True)  # without preamble, too


def dicom_times(path: PathLike) -> list[float]:
    """When each frame of a DICOM file begins, s; nan where the file does not say."""
    head = _read_head(path)
    with name_damage(path, WHAT):
        count = int(head.get("NumberOfFrames") or 1)
        rate = head.get("CineRate") or head.get("RecommendedDisplayFrameRate")
        step = head.get("FrameTime") or (1000 / float(rate) if rate else np.nan)  # ms
        # Of a vector the first is 0.
        steps = head.get("FrameTimeVector") or [0, *[step] * (count - 1)]
        return np.round(np.cumsum(steps, dtype=float) / 1000, 6).tolist()


def read_dicom(
    path: PathLike, page: int, pixel_bytes: int, calibration: Calibration | None = None
) -> np.ndarray:
    """Read a frame of 8 or 16 bits, grey or R, G, B; with square pixels, unless the calibration is as stored.

    ValueError or MemoryError in one sentence; `pixel_bytes` is what a pixel takes while it is read.
    """
    head = _read_head(path)
    from pydicom.pixels import get_decoder, pixel_array
    from pydicom.uid import ExplicitVRLittleEndian, ImplicitVRLittleEndian

    with name_damage(path, WHAT):
        plain = (
            ImplicitVRLittleEndian if head.original_encoding[0] else ExplicitVRLittleEndian
        )
        syntax = head.file_meta.get("TransferSyntaxUID", plain)
        rows, columns = head.Rows, head.Columns
        is_read = False
        with suppress(NotImplementedError):
            is_read = get_decoder(syntax).is_available
    if not is_read:
        raise ValueError(
            f"{path}: its compression, {syntax.name}, is not read; export it with JPEG, or without any"
        )
    check_memory(rows * columns * pixel_bytes, f"{path}: a picture of {columns}x{rows} px")
    # Of a JPEG that is mislabelled pydicom tells, and reads it right.
    with name_damage(path, WHAT), warnings.catch_warnings(action="ignore"):
        stored = pixel_array(path, index=page, transfer_syntax_uid=syntax)
        most = 2**head.BitsStored - 1
        colours = head.PhotometricInterpretation
        if stored.dtype.kind != "u" or most > 65535 or colours == "PALETTE COLOR":
            raise ValueError
        if colours == "MONOCHROME1":  # whose 0 is white
            stored = most - stored
        kind = np.uint8 if most <= 255 else np.uint16
        stored = np.round(stored * (np.iinfo(kind).max / most)).astype(kind)
        high, wide = head.get("PixelAspectRatio") or head.get("PixelSpacing") or (1, 1)
        return make_square(path, stored, high / wide, calibration, is_said=page == 0)


def make_square(
    path: PathLike,
    stored: np.ndarray,
    high: float,
    calibration: Calibration | None,
    is_said: bool,
) -> np.ndarray:
    """Make pixels square, so many times as high as wide, unless a calibration is of them as stored."""
    rows, columns = stored.shape[:2]
    square = round(rows * high)
    camera = None if calibration is None else calibration.camera
    if square == rows or (camera and (camera.width, camera.height) == (columns, rows)):
        return stored
    if is_said:
        message = "%s: its pixels, %.3g times as high as wide, are made square: it is %dx%d px now"
        log.warning(message, path, high, columns, square)
    return np.asarray(cv2.resize(stored, (columns, square)))
