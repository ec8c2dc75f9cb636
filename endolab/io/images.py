"""Pictures, masks and frames in files."""

from __future__ import annotations

import io
import logging
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from mmap import mmap
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from endolab.io.atomic import (
    PathLike,
    name_damage,
    read_bytes,
    stage_file,
    write_atomically,
)
from endolab.io.dicom import dicom_times, is_dicom, read_dicom
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.checks import PATH, check_kinds
from endolab.numerics.memory import check_memory

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL.ImageFile import ImageFile

    from endolab.frames.frame import Frame

DECODED = 32  # bytes a pixel while a picture is read: three channels of 8 bytes, and what was stored
# Those that are known by how they begin, and TGA.
BEGUN = ("PNG", "JPEG", "JPEG2000", "TIFF", "BMP", "WEBP", "GIF", "PPM")
FORMATS = (*BEGUN, "TGA")
PAGED = ("TIFF", "WEBP", "GIF")  # in which there may be several pictures
KINDS = "PNG, JPEG, JPEG 2000, TIFF, BMP, WebP, GIF, PNM, TGA or DICOM"
PICTURE = f"a whole picture ({KINDS} of 8 or 16 bits, no floats or HDR, at most 178 million pixels)"
ORIENTATION = 274  # tag of Exif and TIFF: how a picture is to be turned
OPAQUE = 0.995  # of the largest alpha; with less, a pixel is mixed with what lies beneath
log = logging.getLogger("endolab")


@contextmanager
def quiet() -> Iterator[None]:
    """Silence OpenCV and FFmpeg about a damaged file, which is said in one sentence instead."""
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    # Looked at when a process opens its first video, and never again.
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)


# Written --------------------------------------------------------------------------------
def write_image(path: PathLike, image: FloatArray, bits: int = 8) -> None:
    """Write a grey or RGB picture with values in [0, 1] as PNG of 8 or 16 bits."""
    stored = np.round(np.clip(image, 0, 1) * (2**bits - 1)).astype(f"u{bits // 8}")
    given = stored[..., ::-1] if stored.ndim == 3 else stored
    write_atomically(path, cv2.imencode(".png", given)[1].tobytes())


def write_figure(path: PathLike, figure: Figure) -> None:
    """Write a figure of matplotlib as PNG, as its `savefig` does, which draws one with a layout twice."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    with stage_file(path) as temporary:
        # As small as `savefig` makes it, in a third of the time.
        quick = {"compress_level": 1}
        FigureCanvasAgg(figure).print_png(temporary, pil_kwargs=quick)


# Read -----------------------------------------------------------------------------------
def read_stored(path: PathLike, page: int = 0) -> tuple[np.ndarray, FloatArray]:
    """Read a picture as the numbers that the file holds, R, G, B, 0 where transparent; and alpha, (H, W).

    Numbers of between 8 and 16 bits are stretched to 16; `page` counts those of a file that has several. It
    is not turned, however it is marked. OSError or ValueError in one sentence, if there is no such file, or
    it is no picture or a damaged one; MemoryError, before it is decoded, if it is too large.
    """
    from PIL import Image

    content = read_bytes(path)
    if is_dicom(path):
        stored = read_dicom(path, page, DECODED)
        return stored, np.ones(stored.shape[:2])
    # Pillow refuses what is cut off, or has a wrong checksum, where OpenCV does not.
    with name_damage(path, PICTURE), warnings.catch_warnings(action="ignore"):
        Image.open(io.BytesIO(content), formats=FORMATS).verify()
        picture = Image.open(io.BytesIO(content), formats=FORMATS)
    columns, rows = picture.size
    check_memory(columns * rows * DECODED, f"{path}: a picture of {columns}x{rows} px")
    with name_damage(path, PICTURE), quiet(), warnings.catch_warnings(action="ignore"):
        picture.seek(page)
        most = _largest(picture, content)
        is_deep = most > 255  # of which Pillow makes 8 bits
        is_tiff = picture.format == "TIFF"
        # Of a PNG, Pillow would decode all of it to look for what is not at hand.
        exif = picture.getexif() if is_tiff or "exif" in picture.info else {}
        is_turned = exif.get(ORIENTATION, 1) != 1
        exif[ORIENTATION] = 1  # else Pillow turns a TIFF
        if is_deep:
            if picture.format != "PNG":
                picture.load()
            # A line's end closes a PNM's last number.
            given = np.frombuffer(content + b"\n", np.uint8)
            _, pages = cv2.imdecodemulti(
                given, cv2.IMREAD_UNCHANGED, range=(page, page + 1)
            )
            stored = np.round(np.asarray(pages[0]) * (65535 / most)).astype(np.uint16)
            if stored.ndim == 3:
                stored = stored[..., [2, 1, 0, 3][: stored.shape[2]]]
        else:
            mode = picture.mode if picture.mode in ("L", "LA", "I", "F") else "RGB"
            if picture.format == "GIF":  # whose first frame may be grey, and no other
                mode = "RGB"
            if picture.has_transparency_data and picture.format != "BMP":
                mode = "LA" if mode in ("L", "LA") else "RGBA"
            stored = np.array(picture.convert(mode))
        if sorted(stored.shape[:2]) != sorted(picture.size):
            raise ValueError
    if picture.format == "PNG":
        say_curve(path, content, b"cICP", 5)
    if is_turned:
        if is_deep and is_tiff:  # which OpenCV turns
            raise ValueError(
                f"{path}: a TIFF of 16 bits that is marked as turned is not read"
            )
        say_turned(path)
    if stored.shape[2:] not in ((2,), (4,)):
        return stored, np.ones(stored.shape[:2])
    alpha = stored[..., -1] / max(stored[..., -1].max(), 1)  # opaque may be 65280 of 65535
    if not alpha.any():
        raise ValueError(f"{path} is completely transparent: there is no pixel to use")
    stored[alpha < OPAQUE] = 0
    return stored[..., 0] if stored.shape[2] == 2 else stored[..., :3], alpha


def _largest(picture: ImageFile, content: bytes) -> int:
    """The largest number that a picture of more than 8 bits can hold; 255 or less if it has no more."""
    if picture.format == "JPEG2000":
        place = content.index(b"\xff\x4f\xff\x51") + 42  # of the first component's bits
        return 2 ** ((content[place] & 127) + 1) - 1
    layout = picture.tile[0].args if picture.tile else ""
    if picture.format == "PPM" and isinstance(layout, tuple) and len(layout) == 2:
        return int(layout[1])
    return 65535 if ";16" in str(layout) else 255


def say_turned(name: PathLike) -> None:
    """Say that a picture, or a video, is not turned as it is marked to be."""
    message = "%s is marked to be shown turned; it is read as the sensor saw it, as its calibration is"
    log.warning(message, name)


def say_curve(name: PathLike, content: bytes | mmap, tag: bytes, place: int) -> None:
    """Say that values are coded as PQ or HLG (ITU-R BT.2100), by the byte so far from a tag of the file."""
    at = content.find(tag)
    curve = {b"\x10": "PQ", b"\x12": "HLG"}.get(content[at + place : at + place + 1])
    if at >= 0 and curve:
        message = "%s is coded in %s, which is no power γ of the light: export it in a standard range"
        log.warning(message, name, curve)


def _read(path: PathLike, page: int = 0) -> tuple[FloatArray, FloatArray]:
    """Read a picture of 8 or 16 bits in [0, 1], and its alpha."""
    stored, alpha = read_stored(path, page)
    if stored.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"{path}: expected 8 or 16 bits a channel, found {stored.dtype}")
    return stored / float(np.iinfo(stored.dtype).max), alpha


def read_image(path: PathLike, page: int = 0) -> FloatArray:
    """Read a grey or colour picture of 8 or 16 bits, or a page of one, as (H, W) or (H, W, 3).

    Stored values over their maximum (255 or 65535); R, G, B. Errors as of `read_stored`.
    """
    return _read(path, page)[0]


def page_times(path: PathLike) -> list[float]:
    """When each page of a picture is shown first, s; nan where it does not say.

    Empty if the file is no picture by how it begins, whatever it is called.
    """
    from PIL import Image

    if is_dicom(path):
        return dicom_times(path)
    with (
        suppress(Exception),  # packages promise nothing about which, if it is none
        warnings.catch_warnings(action="ignore"),
        Image.open(path, formats=BEGUN) as picture,
    ):
        count = getattr(picture, "n_frames", 1) if picture.format in PAGED else 1
        times = [0.0]
        for page in range(count - 1):
            picture.seek(page)
            if picture.format == "WEBP":  # which tells it last
                picture.load()
            times.append(times[-1] + picture.info.get("duration", np.nan) / 1000)
        return times
    return []


def read_mask(path: PathLike) -> BoolArray:
    """Read a mask, (H, W): True where the picture is brighter than half.

    If part of it is transparent, True elsewhere, unless black and white are drawn there.
    """
    image, alpha = _read(path)
    level = image if image.ndim == 2 else image.max(axis=-1)
    bright = level > 0.5
    is_drawn = bright.any() and np.mean(np.abs(level[alpha >= OPAQUE] - 0.5) > 0.48) > 0.9
    return bright if alpha.min() == 1 or is_drawn else alpha > 0.5


@check_kinds(path=PATH, calibration=Calibration, mask=PATH)
def read_frame(
    path: PathLike, calibration: Calibration | None = None, mask: PathLike | None = None
) -> Frame:
    """Read a frame, and its mask if there is one.

    Parameters
    ----------
    path : path
        PNG, JPEG, JPEG 2000, TIFF, BMP, WebP, GIF, PNM, TGA or DICOM, of up to 16 bits, grey or colour; the
        first of several pages.
    calibration : Calibration, optional
        If given, the frame must have its shape.
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
    from endolab.frames.frame import Frame

    image, alpha = _read(path)
    rows, columns = image.shape[:2]
    if calibration is not None:
        calibration.fit(str(path), columns, rows)
    inside = np.ones((rows, columns), dtype=bool) if mask is None else read_mask(mask)
    if inside.shape != (rows, columns):
        shape = f"{inside.shape[1]}x{inside.shape[0]} px"
        raise ValueError(f"the mask {mask} is {shape}, the frame {columns}x{rows} px")
    opaque = alpha >= OPAQUE
    if not opaque.all():
        share = 100 * np.mean(~opaque)
        log.warning("%s: %.3g %% of it is transparent, and left out", path, share)
        inside &= opaque
    if not inside.any():
        raise ValueError(
            f"{mask or path} leaves no pixel: what is dark, or transparent, is not used"
        )
    return Frame(image, inside, Path(path).name)
