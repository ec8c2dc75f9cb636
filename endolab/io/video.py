"""Frames of a folder or a video, in order, or of a camera, as they come; and a video written."""

import logging
import os
import re
import threading
import time
from collections.abc import Collection, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import count as numbers
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from endolab.io.atomic import (
    PathLike,
    as_path,
    is_url,
    one_sentence,
    stage_file,
    without_secrets,
)
from endolab.io.images import DECODED, is_picture, read_image, say_turned
from endolab.io.quiet import quiet
from endolab.numerics.arrays import FloatArray
from endolab.numerics.memory import check_memory

PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")


@dataclass(frozen=True)
class VideoLimits:
    """What is waited for, and taken for what, while a video is read."""

    stream_timeout: int = 5000  # ms after which a stream that does not answer is given up
    usual_rate: float = 25.0  # frames per second of a video that does not tell its own
    black: float = 1.0  # grey levels, on average, of memory that nothing was written into
    # Frames, one after the other, that cannot be decoded before a video is at its end.
    longest_break: int = 1000


VIDEO = VideoLimits()


def _by_number(path: Path) -> list[tuple[int, str]]:
    """Sort frame_2 before frame_10."""
    return [
        (int(part), "") if part.isdecimal() else (-1, part)
        for part in re.split(r"(\d+)", path.name)
    ]


@dataclass(frozen=True)
class Frames:
    """The frames of a folder of pictures or of a video; iterate over it as often as you like.

    Iterating gives ``(name, image)``: the file's name, or the frame's number in the video, and
    the stored values in [0, 1], (H, W) or (H, W, 3); None for a picture, or a frame before a video's
    last, that cannot be read.
    """

    path: Path
    names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[tuple[str, FloatArray | None]]:
        return self.read(self.names)

    @property
    def is_video(self) -> bool:
        """Whether they come from one file."""
        return self.path.is_file()

    def read(self, names: Collection[str]) -> Iterator[tuple[str, FloatArray | None]]:
        """Give only the frames of these names, in order."""
        if not self.is_video:
            for name in self.names:
                if name in names:
                    yield name, _picture(self.path / name)
            return
        left = set(names)
        capture = _open(self.path)
        for name in self.names:
            if not left:
                break
            if name in left:
                stored = _next(capture)
                yield name, None if stored is None else as_image(stored)
            else:
                capture.grab()
            left.discard(name)


def _picture(path: Path) -> FloatArray | None:
    # Of what is damaged, the head may say any size.
    with suppress(OSError, ValueError, MemoryError):
        return read_image(path)
    return None


def _open(path: Path) -> cv2.VideoCapture:
    if not path.is_file():  # a pipe might never end
        raise ValueError(f"{path}: not a plain file, and so no video")
    with quiet:
        capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    if not capture.isOpened():
        raise ValueError(f"{path}: neither a picture nor a video that can be decoded")
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    width = int(capture.get(cv2.CAP_PROP_FRAME_WIDTH))
    height = int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
    check_memory(width * height * DECODED, f"{path}: a frame of {width}x{height} px")
    return capture


def _check_scan(path: Path) -> None:
    """Say if a video is marked as turned; ValueError, if it seems to be interlaced.

    Of those that are, OpenCV 5 converts no frame, and gives what lay in memory for each, without an error.
    """
    capture = _open(path)
    if capture.get(cv2.CAP_PROP_ORIENTATION_META) != 0:
        say_turned(path)
    first = _next(capture)
    other = first
    while other is not None and first is not None and np.array_equal(first, other):
        other = _next(capture)
    if first is None or other is not None:
        return
    again = _next(_open(path))  # into other memory, as the first is still in use
    if first.mean() < VIDEO.black or again is None or not np.array_equal(first, again):
        raise ValueError(
            f"{path}: black, or interlaced, which OpenCV cannot read: make it progressive first"
        )


def _next(capture: cv2.VideoCapture) -> NDArray[np.uint8] | None:
    """Take the next frame, (H, W, 3), B, G, R; None if there is none that can be decoded."""
    with suppress(cv2.error), quiet:
        done, stored = capture.read()
        if done and stored.dtype == np.uint8 and stored.shape[2:] == (3,):
            return stored.astype(np.uint8, copy=False)
    return None


def _count(path: Path) -> int:
    """Count the frames of a video, by decoding them, up to the last that can be decoded.

    What its header says is an estimate in many containers, and in others counts fields or what is cut away.
    """
    capture = _open(path)
    count = tried = 0
    end = 0.0  # s, of a rate that varies
    with quiet:
        while tried - count < VIDEO.longest_break:
            tried += 1
            if capture.grab():
                count = tried
                end = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
    stated = capture.get(cv2.CAP_PROP_FRAME_COUNT)
    if 0 < max(count, end * capture.get(cv2.CAP_PROP_FPS)) < min(0.98 * stated, stated - 2):
        text = "%s: ends after %d frames, where its header tells of %d: it may be cut off or damaged"
        logging.getLogger("endolab").warning(text, path, count, stated)
    return count


def is_sequence(path: PathLike) -> bool:
    """Whether this names a folder or a video rather than one picture, by how it ends or by what it is."""
    source = Path(path)
    suffix = source.suffix.lower()
    if suffix in PICTURES:
        return False
    return (
        suffix in (".mjpeg", ".mjpg")  # videos that begin as pictures do
        or os.path.isdir(source)
        or (os.path.isfile(source) and not is_picture(source))
    )


def _list_pictures(paths: Iterable[PathLike]) -> Frames:
    """Take pictures, in one folder or not, as frames; their names are paths from the folder they share."""
    files = [Path(os.path.abspath(path)) for path in paths]
    for file in files:
        if not file.is_file() or is_sequence(file):
            raise ValueError(
                f"{file} is not there, or no picture: give one folder, one video, or pictures"
            )
    folder = Path(os.path.commonpath([file.parent for file in files]))
    ordered = sorted(set(files), key=lambda file: (file.parent, _by_number(file)))
    return Frames(folder, tuple(file.relative_to(folder).as_posix() for file in ordered))


def open_frames(*paths: PathLike) -> Frames:
    """Find the frames of a folder of pictures, of a video, or of pictures that are named one by one.

    Parameters
    ----------
    *paths : path
        A folder with PNG, JPEG, TIFF or BMP files; or a video that OpenCV can read, whose frames are
        counted by decoding them; or such files, wherever they are. Files are taken in the order of the
        numbers in their names.

    Returns
    -------
    Frames
        Names of the frames, which are read when they are needed.

    Raises
    ------
    FileNotFoundError, ValueError
        In one sentence, if there is no such thing, or nothing in it that can be read.
    """
    if not paths:
        raise ValueError("give a folder, a video, or pictures")
    source = as_path(paths[0])
    if len(paths) > 1 or (os.path.isfile(source) and not is_sequence(source)):
        return _list_pictures(paths)
    with one_sentence(f"{source}: cannot be read"):
        if not source.exists():
            raise FileNotFoundError(f"{source}: there is no such folder or video")
        files = sorted(source.glob("[!.]*"), key=_by_number) if source.is_dir() else None
    if files is None:
        count = _count(source)
        if count == 0:
            raise ValueError(f"{source}: a video without a frame that can be decoded")
        _check_scan(source)
        return Frames(source, tuple(f"{number:06d}" for number in range(count)))
    names = [
        file.name for file in files if file.suffix.lower() in PICTURES and not file.is_dir()
    ]
    if not names:
        raise ValueError(f"{source}: no picture in this folder ({', '.join(PICTURES)})")
    return Frames(source, tuple(names))


def is_stream(source: int | PathLike) -> bool:
    """Whether this names a camera, by its number, or a stream, by its URL, rather than a file."""
    if isinstance(source, int):
        return True
    name = os.fspath(source)
    return is_url(name) or (name.isdecimal() and not os.path.lexists(name))


class Stream:
    """The frames of a camera, of a stream, or of a video that is played as if it were one; see `open_stream`.

    Iterating gives ``(name, image)`` as `Frames` does, but once, and without knowing an end: the names are
    the frames' numbers as they come. `close` ends it, from any thread.
    """

    def __init__(self, capture: cv2.VideoCapture, name: str, rate: float | None) -> None:
        self.name = name
        # Frames per second at which it is played; None if it comes by itself.
        self.rate = rate
        self._capture = capture
        self._closed = threading.Event()

    def __iter__(self) -> Iterator[tuple[str, FloatArray]]:
        for name, stored in self.raw_frames():
            yield name, as_image(stored)

    def raw_frames(self) -> Iterator[tuple[str, NDArray[np.uint8]]]:
        """Give names and bytes, (H, W, 3), in OpenCV's order B, G, R; `as_image` makes pictures of them."""
        started = time.perf_counter()
        last = -1
        # Of a stream, each takes `stream_timeout`.
        longest = 1 if self.rate is None else VIDEO.longest_break
        for number in numbers():
            if self._closed.is_set() or number - last > longest:
                break
            stored = _next(self._capture)
            if stored is None:
                continue
            if self.rate is not None:
                self._closed.wait(
                    max(0.0, started + number / self.rate - time.perf_counter())
                )
            yield f"{number:06d}", stored
            last = number
        self._capture.release()
        if last < 0 and not self._closed.is_set():
            raise ValueError(f"{self.name} gives no picture")

    def close(self) -> None:
        """Let it end with the frame that is being read."""
        self._closed.set()


def as_image(stored: NDArray[np.uint8]) -> FloatArray:
    """Make a picture, R, G, B in [0, 1], of OpenCV's bytes."""
    return stored[..., ::-1] / 255.0


def open_stream(source: int | PathLike) -> Stream:
    """Open a camera, a stream, or a video to be played at its own rate.

    Parameters
    ----------
    source : int, str or path
        The number of a camera of this machine, as OpenCV counts them; a URL (rtsp, http, …); or a video.

    Returns
    -------
    Stream
        Gives names and pictures as they come; close it when done.

    Raises
    ------
    FileNotFoundError, ValueError
        In one sentence, if there is no such thing, or it cannot be opened.
    """
    if not is_stream(source):
        path = as_path(source)  # type: ignore[arg-type]
        if not os.path.isfile(path):
            raise FileNotFoundError(f"{path}: there is no such video, camera or stream")
        _check_scan(path)
        capture = _open(path)
        rate = capture.get(cv2.CAP_PROP_FPS)
        return Stream(capture, str(path), rate if 1 <= rate <= 1000 else VIDEO.usual_rate)
    text = str(source)
    name = without_secrets(text) if is_url(text) else f"camera {text}"
    with quiet:
        if is_url(text):
            limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, VIDEO.stream_timeout]
            limits += [cv2.CAP_PROP_READ_TIMEOUT_MSEC, VIDEO.stream_timeout]
            capture = cv2.VideoCapture(text, cv2.CAP_FFMPEG, limits)
            capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
        else:
            capture = cv2.VideoCapture(int(text))
    if not capture.isOpened():
        raise ValueError(
            f"{name} cannot be opened: it is not there, in use, or holds no video"
        )
    capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # what a camera keeps back is old when it comes
    return Stream(capture, name, None)


def write_video(path: PathLike, images: Iterable[FloatArray], rate: float = 30.0) -> None:
    """Write a video without loss (FFV1), whole or not at all.

    `path` ends in .mkv. `images` are (H, W) or (H, W, 3), all of one size, of stored values in [0, 1],
    of which 8 bits are kept; `rate` is in frames per second. OSError or ValueError in one sentence.
    """
    target = as_path(path)
    if target.suffix != ".mkv":
        raise ValueError(f"a video's name ends in .mkv, got {target.name}")
    with stage_file(target) as temporary:
        count = _encode(temporary, images, rate)
        # For OpenCV does not say if the disk is full.
        kept = cv2.VideoCapture(str(temporary))
        if count == 0 or any(_next(kept) is None for _ in range(count)):
            raise OSError(
                f"cannot write {target}: not every frame can be read back; the disk may be full"
            )


def _encode(path: Path, images: Iterable[FloatArray], rate: float) -> int:
    """Encode pictures, and count them."""
    writer = cv2.VideoWriter()
    shape = None
    count = 0
    for image in images:
        whole = np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)
        stored = cv2.cvtColor(
            whole, cv2.COLOR_GRAY2BGR if whole.ndim == 2 else cv2.COLOR_RGB2BGR
        )
        if shape is None:
            shape = image.shape
            size = stored.shape[1::-1]
            with quiet:
                writer.open(str(path), cv2.VideoWriter.fourcc(*"FFV1"), rate, size)
        if image.shape != shape:
            raise ValueError(
                f"frame {count} of a video: expected {shape}, found {image.shape}"
            )
        writer.write(stored)
        count += 1
    writer.release()
    return count
