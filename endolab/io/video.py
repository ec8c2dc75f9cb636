"""Frames of a folder or a video, in order; and a video written."""

import os
import re
from collections.abc import Collection, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from mmap import ACCESS_READ, mmap
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from endolab.io.atomic import PathLike, one_sentence, stage_file
from endolab.io.dicom import make_square
from endolab.io.images import (
    DECODED,
    KINDS,
    kind_of,
    page_times,
    quiet,
    read_image,
    warn_of_curve,
    warn_of_turn,
)
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import FloatArray
from endolab.numerics.memory import check_memory


def _by_number(path: Path) -> list[str | int]:
    """Sort frame_2 before frame_10."""
    parts = re.split(r"(\d+)", path.name)
    return [int(part) if part.isdecimal() else part for part in parts]


@dataclass(frozen=True)
class Frames:
    """The frames of a folder of pictures, of a video or of one file's pages; iterate as often as you like.

    Iterating gives ``(name, image)``: the file's name, or the frame's number in the file, and
    the stored values in [0, 1], (H, W) or (H, W, 3); a ValueError that says why for a picture, or a frame
    before a video's last, that cannot be read.
    """

    path: Path
    names: tuple[str, ...]
    # When they are shown, s; nan, or not there, where nothing says so.
    times: dict[str, float] = field(default_factory=dict)
    # Of what is stored: whose part is cut out, and whose pixels are not made square.
    calibration: Calibration | None = None

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[tuple[str, FloatArray | ValueError]]:
        return self.read(self.names)

    @property
    def is_video(self) -> bool:
        """Whether they come from one file."""
        return self.path.is_file()

    def spread(self, count: int) -> list[str]:
        """Name so many of the frames, or all, evenly spread."""
        places = np.linspace(0, len(self) - 1, min(count, len(self))).round()
        return [self.names[int(place)] for place in places]

    def read(self, names: Collection[str]) -> Iterator[tuple[str, FloatArray | ValueError]]:
        """Give only the frames of these names, in order."""
        given = set(names)
        wanted = (name for name in self.names if name in given)
        is_folder = self.path.is_dir()
        if is_folder or len(page_times(self.path)) > 1:
            for name in wanted:
                file, page = (self.path / name, 0) if is_folder else (self.path, int(name))
                image: FloatArray | ValueError
                try:
                    image = read_image(file, page, self.calibration)
                # Of what is damaged, the head may say any size.
                except (OSError, ValueError, MemoryError) as error:
                    image = ValueError(str(error))
                yield name, image
            return
        capture = _open(self.path)
        place = 0
        for name in wanted:
            for _ in range(place, int(name)):
                capture.grab()
            place = int(name) + 1
            stored = _next(capture)
            if stored is None:
                yield name, ValueError(f"{self.path}: frame {name} cannot be decoded")
                continue
            aspect = cv2.CAP_PROP_SAR_DEN, cv2.CAP_PROP_SAR_NUM  # 0 where it does not say
            high, wide = (capture.get(one) or 1 for one in aspect)
            shown = make_square(
                self.path, stored, high / wide, self.calibration, place == 1
            )
            if self.calibration is not None:
                shown = self.calibration.cut(shown)
            yield name, shown[..., ::-1] / 255.0


def _open(path: Path) -> cv2.VideoCapture:
    with quiet():
        capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    if not capture.isOpened():
        raise ValueError(f"{path}: neither a picture nor a video that can be decoded")
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    width = int(capture.get(cv2.CAP_PROP_FRAME_WIDTH))
    height = int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
    check_memory(width * height * DECODED, f"{path}: a frame of {width}x{height} px")
    return capture


def _next(capture: cv2.VideoCapture) -> NDArray[np.uint8] | None:
    """Take the next frame, (H, W, 3), B, G, R; None if there is none that can be decoded."""
    with suppress(cv2.error), quiet():
        done, stored = capture.read()
        return np.asarray(stored, np.uint8) if done else None
    return None


def _open_video(path: Path, calibration: Calibration | None) -> Frames:
    """Count the frames of a video by decoding them: its header may tell of more, of fewer, or of fields."""
    capture = _open(path)
    if capture.get(cv2.CAP_PROP_ORIENTATION_META) != 0:
        warn_of_turn(path)
    with path.open("rb") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as content:
        warn_of_curve(path, content)
    count = tried = 0
    times = {}
    with quiet():
        while tried - count < 1000:  # frames, one after the other, that cannot be decoded
            tried += 1
            if capture.grab():
                count = tried
                end = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000  # s
                times[_number(count - 1)] = end
    if count == 0:
        raise ValueError(f"{path}: a video without a frame that can be decoded")
    stated = capture.get(cv2.CAP_PROP_FRAME_COUNT)
    reached = max(count, end * capture.get(cv2.CAP_PROP_FPS))  # of a rate that varies
    if reached < min(0.98 * stated, stated - 2):
        text = f"ends after {count} frames, and its header tells of {stated:.0f}"
        raise ValueError(f"{path}: {text}: it is cut off or damaged")
    return Frames(path, tuple(_number(at) for at in range(count)), times, calibration)


def _number(at: int) -> str:
    return f"{at:06d}"


def is_sequence(path: PathLike) -> bool:
    """Whether a path is a folder, a video or several pages, not one picture, by its end or what it is."""
    source = Path(path)
    # Raw videos begin as pictures do.
    if source.is_dir() or source.suffix.lower() in (".mjpeg", ".mjpg"):
        return True
    return source.is_file() and len(page_times(source)) != 1


def open_frames(*paths: PathLike, calibration: Calibration | None = None) -> Frames:
    """Find the frames of a folder of pictures, of a video, or of pictures that are named one by one.

    Parameters
    ----------
    *paths : path
        A folder with pictures, as of `read_frame`; or a video that OpenCV can read, whose frames are counted
        by decoding them; or a TIFF or DICOM file with several; or pictures, wherever they are.
        Files are taken in the order of the numbers in their names.
    calibration : Calibration, optional
        If it is of what a video or DICOM stores, pixels that are not square stay as they are. Of larger
        pictures its part is cut out, if it is of one.

    Returns
    -------
    Frames
        Names of the frames, which are read when they are needed.

    Raises
    ------
    FileNotFoundError, ValueError
        In one sentence, if there is no such thing, nothing in it that can be read, or a video is cut off.
    """
    if not paths:
        raise ValueError("give a folder, a video, or pictures")
    source = Path(paths[0])
    if len(paths) == 1 and source.is_dir():
        with one_sentence(f"{source}: cannot be read"):
            found = sorted(source.glob("[!.]*"), key=_by_number)
        names = tuple(file.name for file in found if kind_of(file))
        if not names:
            raise ValueError(f"{source}: no picture in this folder ({KINDS})")
        return Frames(source, names, calibration=calibration)
    if len(paths) == 1 and is_sequence(source):
        times = page_times(source)
        names = tuple(_number(at) for at in range(len(times)))
        if len(times) > 1:
            return Frames(source, names, dict(zip(names, times, strict=True)), calibration)
        return _open_video(source, calibration)
    files = {Path(os.path.abspath(path)) for path in paths}
    for file in files:
        if not file.is_file():
            raise FileNotFoundError(f"{file}: there is no such file")
        if is_sequence(file):
            text = "is no picture: give one folder, one video, or pictures"
            raise ValueError(f"{file} {text}")
    folder = Path(os.path.commonpath([file.parent for file in files]))
    ordered = sorted(files, key=lambda file: (file.parent, _by_number(file)))
    names = tuple(file.relative_to(folder).as_posix() for file in ordered)
    return Frames(folder, names, calibration=calibration)


def write_video(path: PathLike, images: Iterable[FloatArray]) -> None:
    """Write a video of 30 frames a second without loss (FFV1), whole or not at all.

    `path` ends in .mkv. `images` are (H, W) or (H, W, 3), all of one size, of stored values in [0, 1],
    of which 8 bits are kept. OSError in one sentence.
    """
    target = Path(path)
    if target.suffix != ".mkv":
        raise ValueError(f"a video's name ends in .mkv, got {target.name}")
    with stage_file(target) as temporary:
        writer = cv2.VideoWriter()
        count = 0
        for count, image in enumerate(images, 1):
            whole = np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)
            kind = cv2.COLOR_GRAY2BGR if whole.ndim == 2 else cv2.COLOR_RGB2BGR
            if count == 1:
                code = cv2.VideoWriter.fourcc(*"FFV1")
                writer.open(str(temporary), code, 30.0, whole.shape[1::-1])
            writer.write(cv2.cvtColor(whole, kind))
        writer.release()
        # For OpenCV does not say if the disk is full.
        kept = cv2.VideoCapture(str(temporary))
        if count == 0 or any(_next(kept) is None for _ in range(count)):
            text = "not every frame can be read back; the disk may be full"
            raise OSError(f"cannot write {target}: {text}")
