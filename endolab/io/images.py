"""Pictures, masks and frames in files."""

from __future__ import annotations

import io
import logging
import os
import re
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
from endolab.io.dicom import dicom_times, read_dicom
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.checks import PATH, check_kinds
from endolab.numerics.memory import check_memory

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL.ImageFile import ImageFile

    from endolab.frames.frame import Frame

DECODED = 32  # bytes a pixel while a picture is read: three channels of 8 bytes, and what was stored
# How pictures begin: those that are read, by Pillow's names, and those that are refused by name.
HEADS = {
    "PNG": rb"\x89PNG",
    "JPEG": rb"\xff\xd8\xff",
    "JPEG2000": rb"\xff\x4f\xff\x51|\0\0\0\x0cjP",
    "raw": rb"(II\*\0|MM\0\*).*("  # with DNG's version, a mosaic, or a preview of what follows
    rb"\x12\xc6\x01\0\x04\0{3}|\xc6\x12\0\x01\0{3}\x04|"
    rb"\x06\x01\x03\0\x01\0{3}\x23\x80|\x01\x06\0\x03\0{3}\x01\x80\x23|"
    rb"\xfe\0\x04\0\x01\0{3}\x01\0{3}.{,400}\x4a\x01[\x04\x0d]\0|"
    rb"\0\xfe\0\x04\0{3}\x01\0{3}\x01.{,400}\x01\x4a\0[\x04\x0d])"
    rb"|II\*\0.{4}CR|II[RU]|MMOR|FUJIFILMCCD-RAW|FOVb|.{4}ftypcrx ",
    "TIFF": rb"II[*+]\0|MM\0[*+]",
    "BMP": rb"BM",
    "WEBP": rb"RIFF.{4}WEBP",
    "GIF": rb"GIF8",
    "PPM": rb"P[1-6fF]\s",
    "AVIF": rb".{4}ftyp(avi[fs]|mi[fa]1.{4}(....)*?avif)",
    "HEIC": rb".{4}ftyp(hei|hev|mif1|msf1)",
    "JPEG XL": rb"\xff\x0a|\0\0\0\x0cJXL ",
    "": rb".{128}DICM.*1\.2\.840\.10008\.1\.3\.10",
    "DICOM": rb".{128}DICM|[\x02\x08]\0.\0([A-Z]{2}|[^\0]\0{3})",
}
REFUSED = ("raw", "HEIC", "JPEG XL")
FORMATS = [kind for kind in HEADS if kind not in (*REFUSED, "", "DICOM")] + ["TGA"]
KINDS = "PNG, JPEG, JPEG 2000, TIFF, BMP, WebP, AVIF, GIF, PNM, TGA or DICOM"
PICTURE = f"a whole picture ({KINDS} of 8 or 16 bits, no floats or HDR, at most 178 million pixels)"
OPAQUE = 0.995  # of the largest alpha; with less, a pixel is mixed with what lies beneath
log = logging.getLogger("endolab")


@contextmanager
def quiet() -> Iterator[None]:
    """Silence others about a damaged file, which is said in one sentence instead."""
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    # Looked at when a process opens its first video, and never again.
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    try:
        with warnings.catch_warnings(action="ignore"):
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
def kind_of(path: PathLike) -> str:
    """Say what a picture is, by how it begins, whatever it is called: a key of `HEADS`, else its suffix.

    Empty if it is no picture; so is DICOM's list of a folder (DICOMDIR).
    """
    file = Path(path)
    head = b""
    if file.is_file():  # a pipe might never end
        with suppress(OSError), file.open("rb") as stream:
            head = stream.read(2**16)
    found = (kind for kind, begin in HEADS.items() if re.match(begin, head, re.DOTALL))
    # Of what begins otherwise, or is damaged; these are pictures all the same, or refused as such.
    suffixes = r"\.(png|jpe?g|tiff?|bmp|webp|gif|tga|dcm|jp2|j2k|p[bgnp]m|avif|hdr|exr|pfm)"
    is_named = re.fullmatch(suffixes, file.suffix, re.IGNORECASE) and not file.is_dir()
    return next(found, file.suffix if is_named else "")


def read_stored(
    path: PathLike, page: int = 0, calibration: Calibration | None = None
) -> tuple[np.ndarray, FloatArray, bool]:
    """Read a picture as the numbers that the file holds, R, G, B, 0 where transparent; and alpha, (H, W).

    And whether it says that they are linear in the light. Numbers of between 8 and 16 bits are stretched to
    16; `page` counts those of a file that has several. It is not turned, however it is marked; DICOM's pixels
    are made square, unless the calibration is of them as stored. OSError or ValueError in one sentence, if
    there is no such file, or it is no picture or a damaged one; MemoryError, before it is decoded, if it is
    too large.
    """
    from PIL import ExifTags, Image

    content = read_bytes(path)
    kind = kind_of(path)
    if kind in REFUSED:
        raise ValueError(f"{path}: {kind} pictures are not read; export it as JPEG or PNG")
    if kind == "DICOM":
        stored = read_dicom(path, page, DECODED, calibration)
        return stored, np.ones(stored.shape[:2]), False
    # Pillow refuses what is cut off, or has a wrong checksum, where OpenCV does not.
    with name_damage(path, PICTURE), quiet():
        Image.open(io.BytesIO(content), formats=FORMATS).verify()
        picture = Image.open(io.BytesIO(content), formats=FORMATS)
    columns, rows = picture.size
    check_memory(columns * rows * DECODED, f"{path}: a picture of {columns}x{rows} px")
    with name_damage(path, PICTURE), quiet():
        is_tiff = picture.format == "TIFF"
        pages = 1 if is_tiff else getattr(picture, "n_frames", 1)
        picture.seek(page)
        most = _largest(picture, content)
        is_deep = most > 255  # of which Pillow makes 8 bits
        # Of a PNG, Pillow would decode all of it to look for what is not at hand.
        exif = picture.getexif() if is_tiff or "exif" in picture.info else {}
        is_turned = exif.get(ExifTags.Base.Orientation, 1) != 1
        exif[ExifTags.Base.Orientation] = 1  # else Pillow turns a TIFF
        if is_deep:
            if picture.format != "PNG":
                picture.load()
            # A line's end closes a PNM's last number.
            given = np.frombuffer(content + b"\n", np.uint8)
            _, found = cv2.imdecodemulti(
                given, cv2.IMREAD_UNCHANGED, range=(page, page + 1)
            )
            stored = np.round(np.asarray(found[0]) * (65535 / most)).astype(np.uint16)
            if stored.ndim == 3:
                stored = stored[..., [2, 1, 0, 3][: stored.shape[2]]]
        else:
            mode = picture.mode if picture.mode in ("L", "LA", "I", "F") else "RGB"
            if picture.has_transparency_data and picture.format != "BMP":
                mode = "LA" if mode in ("L", "LA") else "RGBA"
            stored = np.array(picture.convert(mode))
        if sorted(stored.shape[:2]) != sorted(picture.size):
            raise ValueError
    if pages > 1 and picture.format != "MPO":  # a telephone's, with a preview
        log.warning("%s holds %d pictures: the first is taken", path, pages)
    warn_of_curve(path, content)
    is_linear = _states_linear(picture, content)
    if is_turned:
        if is_deep and is_tiff:  # which OpenCV turns
            raise ValueError(
                f"{path}: a TIFF of 16 bits that is marked as turned is not read"
            )
        warn_of_turn(path)
    if stored.shape[2:] not in ((2,), (4,)):
        return stored, np.ones(stored.shape[:2]), is_linear
    alpha = stored[..., -1] / max(stored[..., -1].max(), 1)  # opaque may be 65280 of 65535
    if not alpha.any():
        raise ValueError(f"{path} is completely transparent: there is no pixel to use")
    stored[alpha < OPAQUE] = 0
    stored = stored[..., 0] if stored.shape[2] == 2 else stored[..., :3]
    return stored, alpha, is_linear


def _largest(picture: ImageFile, content: bytes) -> int:
    """The largest number that a picture of more than 8 bits can hold; 255 or less if it has no more."""
    # What says of how many bits it is, from 9 to 16, is not read.
    if picture.format == "JPEG2000":
        given = np.frombuffer(content, np.uint8)
        return (
            int(np.asarray(cv2.imdecode(given, cv2.IMREAD_UNCHANGED)).itemsize > 1) * 65535
        )
    layout = picture.tile[0].args if picture.tile else ""
    if picture.format == "PPM" and isinstance(layout, tuple) and len(layout) == 2:
        return int(layout[1])
    return 65535 if ";16" in str(layout) else 255


def _states_linear(picture: ImageFile, content: bytes) -> bool:
    """Whether it says that it is linear, by its curve, or else its ICC profile, or else gAMA without sRGB."""
    code = curve_of(content)
    profile = picture.info.get("icc_profile")
    if code or not profile:
        is_unit = picture.info.get("gamma") == 1 and "srgb" not in picture.info
        return code == 8 or (code == 0 and is_unit)
    place = profile.find(b"TRC", 128) + 3  # behind it, where the curve begins
    start = int.from_bytes(profile[place : place + 4])
    straight = rb"curv\0{4}(\0{4}|\0{3}\x01\x01\0|\0{3}\x02\0\0\xff\xff)|para\0{9}\x01\0\0"
    return place > 2 and re.match(straight, profile[start:]) is not None


def warn_of_turn(name: PathLike) -> None:
    """Say that a picture, or a video, is not turned as it is marked to be."""
    message = "%s is marked to be shown turned; it is read as the sensor saw it, as its calibration is"
    log.warning(message, name)


def curve_of(content: bytes | mmap) -> int:
    """The code of its curve (ITU-T H.273), which PNG, AVIF, MP4 and MOV may tell; else 0."""
    for tag, place in ((b"cICP", 5), (b"colrncl", 11)):
        at = content.find(tag) + place
        if at >= place:
            return int.from_bytes(content[at : at + 1])
    return 0


def warn_of_curve(name: PathLike, content: bytes | mmap) -> None:
    """Say that values are coded as PQ or HLG (ITU-R BT.2100)."""
    curve = {16: "PQ", 18: "HLG"}.get(curve_of(content))
    if curve:
        message = "%s is coded in %s, which is no power γ of the light: export it in a standard range"
        log.warning(message, name, curve)


def _read(
    path: PathLike, page: int = 0, calibration: Calibration | None = None
) -> tuple[FloatArray, FloatArray, bool]:
    """Read a picture of 8 or 16 bits in [0, 1], its alpha, and whether it says that it is linear.

    Only the part that the calibration is of, if it is of one.
    """
    stored, alpha, is_linear = read_stored(path, page, calibration)
    if stored.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"{path}: expected 8 or 16 bits a channel, found {stored.dtype}")
    if calibration is not None:
        stored, alpha = calibration.cut(stored), calibration.cut(alpha)
        gamma = calibration.photometry.gamma
        if is_linear and gamma != 1:
            message = "%s says that it is linear, γ 1, the calibration γ %g: export it as its pictures were"
            log.warning(message, path, gamma)
    return stored / float(np.iinfo(stored.dtype).max), alpha, is_linear


def read_image(
    path: PathLike, page: int = 0, calibration: Calibration | None = None
) -> FloatArray:
    """Read a grey or colour picture of 8 or 16 bits, or a page of one, as (H, W) or (H, W, 3).

    Stored values over their maximum (255 or 65535); R, G, B. Errors as of `read_stored`.
    """
    return _read(path, page, calibration)[0]


def page_times(path: PathLike) -> list[float]:
    """When each page of a TIFF or DICOM is shown first, s; nan where it does not say.

    One of any other picture; none if the file is no picture.
    """
    from PIL import Image

    kind = kind_of(path)
    if kind == "DICOM":
        return dicom_times(path)
    pages = 1
    if kind == "TIFF":
        with (
            suppress(Exception),  # packages promise nothing about which, if it is damaged
            quiet(),
            Image.open(path, formats=["TIFF"]) as picture,
        ):
            pages = getattr(picture, "n_frames", 1)
    return [0.0, *[np.nan] * (pages - 1)] if kind else []


def read_mask(path: PathLike) -> BoolArray:
    """Read a mask, (H, W): True where the picture is brighter than half.

    If part of it is transparent, True elsewhere, unless black and white are drawn there.
    """
    image, alpha, _ = _read(path)
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
        PNG, JPEG, JPEG 2000, TIFF, BMP, WebP, AVIF, GIF, PNM, TGA or DICOM, of up to 16 bits, grey or colour;
        the first of several pages.
    calibration : Calibration, optional
        If given, the frame must have its shape; of a larger picture the part is cut out that it is of.
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

    image, alpha, is_linear = _read(path, 0, calibration)
    rows, columns = image.shape[:2]
    inside = np.ones((rows, columns), dtype=bool) if mask is None else read_mask(mask)
    if calibration is not None:
        calibration.fit(str(path), columns, rows)
        inside = calibration.cut(inside)
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
    return Frame(image, inside, Path(path).name, is_linear=is_linear)
