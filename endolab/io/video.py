"""Frames of a folder or a video, in order, or of a camera, as they come; and a video written."""

import os
import re
import threading
import time
import zlib
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from endolab.io.atomic import PathLike, as_path, one_sentence, staged_file
from endolab.io.images import DECODED, read_image
from endolab.io.quiet import quiet
from endolab.numerics.arrays import FloatArray
from endolab.numerics.memory import check_memory

PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
VIDEOS = (".avi", ".m4v", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".webm", ".wmv")
SCHEMES = ("rtsp", "rtmp", "http", "https", "udp", "tcp", "file")  # of URLs that a stream may have
PATIENCE = 5000  # ms after which a stream that does not answer is given up
USUAL_RATE = 25.0  # frames per second of a video that does not tell its own
LEAST = 64  # bytes of a video for each frame that it may promise; others are counted
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # what FFmpeg would print is said in one sentence


def _by_number(path: Path) -> list[tuple[int, str]]:
    """Sort frame_2 before frame_10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", path.name)]


@dataclass(frozen=True)
class Frames:
    """The frames of a folder of pictures or of a video; iterate over it as often as you like.

    Iterating gives ``(name, image)``: the file's name, or the frame's number in the video, and
    the stored values in [0, 1], (H, W) or (H, W, 3); None for a picture that cannot be read, and
    for what a video promises and then does not hold.
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

    @property
    def stamp(self) -> list[list[object]]:
        """Name, size and time of change of every file: what a cache may depend on."""
        files = [self.path] if self.is_video else [self.path / name for name in self.names]
        return [[file.name, *_changed(file)] for file in files]

    def read(self, names: Collection[str]) -> Iterator[tuple[str, FloatArray | None]]:
        """Give only the frames of these names, in order."""
        wanted = set(names)
        if not self.is_video:
            for name in self.names:
                if name in wanted:
                    yield name, _picture(self.path / name)
            return
        capture = _open(self.path)
        try:
            for name in self.names:
                stored = _next(capture, name in wanted)  # after a break some go on, with the next whole frame
                if name in wanted:
                    yield name, None if stored is None else as_image(stored)
                    wanted.discard(name)
                if not wanted:
                    break
        finally:
            capture.release()


def _picture(path: Path) -> FloatArray | None:
    try:
        return read_image(path)
    except (OSError, ValueError, MemoryError):  # of what is damaged, the head may say any size
        return None


def _changed(file: Path) -> tuple[int, int]:
    """Size of a file and when it changed; of one that is not there, neither."""
    try:
        found = file.stat()
    except OSError:
        return -1, -1
    return found.st_size, found.st_mtime_ns


def _open(path: Path) -> cv2.VideoCapture:
    if not path.is_file():  # a pipe might never end
        raise ValueError(f"{path}: not a plain file, and so no video")
    with quiet(), suppress(cv2.error):
        capture = cv2.VideoCapture(str(path))
        if capture.isOpened():
            size = [int(capture.get(what)) for what in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)]
            check_memory(size[0] * size[1] * DECODED, f"{path}: a frame of {size[0]}x{size[1]} px")
            return capture
    raise ValueError(f"{path}: not a video that can be decoded")


def _next(capture: cv2.VideoCapture, wanted: bool) -> np.ndarray | None:
    """Take the next frame, B, G, R; None if it is not wanted or cannot be decoded."""
    with quiet(), suppress(cv2.error):
        if capture.grab() and wanted:
            _, stored = capture.retrieve()
            if isinstance(stored, np.ndarray) and stored.dtype == np.uint8 and stored.shape[2:] == (3,):
                return stored
    return None


def _count(capture: cv2.VideoCapture, most: int) -> int:
    """Count the frames of a video, 0 if the first cannot be had; it is taken at its word up to `most`."""
    with quiet(), suppress(cv2.error):
        said = capture.get(cv2.CAP_PROP_FRAME_COUNT)
        if 0 < said <= most:
            return int(said) if capture.grab() else 0
    count = 0
    with quiet(), suppress(cv2.error):
        while capture.grab():
            count += 1
    return count


def is_sequence(path: PathLike) -> bool:
    """Whether this names a folder or a video, by what it is or how it ends, rather than one picture."""
    source = Path(path)
    suffix = source.suffix.lower()
    return suffix not in PICTURES and (suffix in VIDEOS or os.path.isdir(source))


def _listed(paths: Sequence[PathLike]) -> Frames:
    """Take pictures, in one folder or not, as frames; their names are paths from the folder they share."""
    files = [Path(os.path.abspath(path)) for path in paths]
    count = Counter(files)
    for path, file in zip(paths, files, strict=True):
        if os.path.isdir(file) or file.suffix.lower() not in PICTURES:
            kind = "a folder" if os.path.isdir(file) else "no picture by its name"
            raise ValueError(f"{path} is {kind}: give one folder, one video, or pictures alone")
        with one_sentence(f"{path}: cannot be read"):
            if not file.exists():
                raise FileNotFoundError(f"{path}: there is no such file")
        if count[file] > 1:
            raise ValueError(f"{path} is given twice")
    try:
        folder = Path(os.path.commonpath([file.parent for file in files]))
    except ValueError as error:  # of Windows
        raise ValueError("the pictures must all lie on one drive") from error
    files = sorted(files, key=lambda file: (file.parent, _by_number(file)))
    return Frames(folder, tuple(file.relative_to(folder).as_posix() for file in files))


def _inside(folder: Path) -> list[Path]:
    with one_sentence(f"{folder}: cannot be read"):
        return list(folder.iterdir())


def open_frames(*paths: PathLike) -> Frames:
    """Find the frames of a folder of pictures, of a video, or of pictures that are named one by one.

    Parameters
    ----------
    *paths : path
        A folder with PNG, JPEG, TIFF or BMP files; or a video that OpenCV can read; or such files,
        wherever they are. Files are taken in the order of the numbers in their names.

    Raises
    ------
    FileNotFoundError, ValueError
        In one sentence, if there is no such thing, or nothing in it that can be read.
    """
    if not paths:
        raise ValueError("give a folder, a video, or pictures")
    source = as_path(paths[0])
    if len(paths) > 1 or (source.suffix.lower() in PICTURES and os.path.isfile(source)):
        return _listed(paths)
    with one_sentence(f"{source}: cannot be read"):
        if not source.exists():
            raise FileNotFoundError(f"{source}: there is no such folder or video")
    if source.is_dir():
        found = [file for file in _inside(source) if file.suffix.lower() in PICTURES and file.name[0] != "."]
        files = sorted((file for file in found if not file.is_dir()), key=_by_number)
        if not files:
            raise ValueError(f"{source}: no picture in this folder ({', '.join(PICTURES)})")
        return Frames(source, tuple(file.name for file in files))
    capture = _open(source)
    try:
        count = _count(capture, source.stat().st_size // LEAST)
    finally:
        capture.release()
    if count == 0:
        raise ValueError(f"{source}: a video without a frame that can be decoded")
    return Frames(source, tuple(f"{number:06d}" for number in range(count)))


def is_stream(source: int | PathLike) -> bool:
    """Whether this names a camera, by its number, or a stream, by its URL, rather than a file."""
    if isinstance(source, int):
        return True
    name = os.fspath(source)
    return bool(re.match(r"[a-z]+://", name)) or (name.isdecimal() and not os.path.lexists(name))


class Stream:
    """The frames of a camera, of a stream, or of a video that is played as if it were one; see `open_stream`.

    Iterating gives ``(name, image)`` as `Frames` does, but once, and without knowing an end: the names are
    the frames' numbers as they come. `close` ends it, from any thread.
    """

    def __init__(self, capture: cv2.VideoCapture, name: str, rate: float | None) -> None:
        self.name = name
        self.rate = rate  # frames per second at which it is played; None if it comes by itself
        self._capture, self._closed = capture, threading.Event()

    def __iter__(self) -> Iterator[tuple[str, FloatArray]]:
        for name, stored in self.stored():
            yield name, as_image(stored)

    def stored(self) -> Iterator[tuple[str, NDArray[np.uint8]]]:
        """Give names and bytes, (H, W, 3), in OpenCV's order B, G, R; `as_image` makes pictures of them."""
        started, count = time.perf_counter(), 0
        try:
            while not self._closed.is_set():
                # Not quietly: a camera's next frame takes its time, and others may have something to say.
                done, stored = self._read()
                if not done:
                    break
                if self.rate is not None:
                    self._closed.wait(max(0.0, started + count / self.rate - time.perf_counter()))
                yield f"{count:06d}", stored
                count += 1
        finally:
            self._capture.release()
        if count == 0 and not self._closed.is_set():
            raise ValueError(f"{self.name} gives no picture")

    def close(self) -> None:
        """Let it end with the frame that is being read."""
        self._closed.set()

    def _read(self) -> tuple[bool, NDArray[np.uint8]]:
        with suppress(cv2.error):
            done, stored = self._capture.read()
            if done and stored.dtype == np.uint8 and stored.shape[2:] == (3,):
                return True, stored.astype(np.uint8, copy=False)
        return False, np.empty(0, np.uint8)


def as_image(stored: NDArray[np.uint8]) -> FloatArray:
    """Make a picture, R, G, B in [0, 1], of OpenCV's bytes."""
    return stored[..., ::-1] / 255.0


def open_stream(source: int | PathLike) -> Stream:
    """Open a camera, a stream, or a video to be played at its own rate.

    Parameters
    ----------
    source : int, str or path
        The number of a camera of this machine, as OpenCV counts them; a URL (`SCHEMES`); or a video.

    Raises
    ------
    FileNotFoundError, ValueError
        In one sentence, if there is no such thing, or it cannot be opened.
    """
    if not is_stream(source):
        path = as_path(source)  # type: ignore[arg-type]
        if path.is_dir():
            raise ValueError(f"{path} is a folder: a live view takes a camera, a stream or a video")
        with one_sentence(f"{path}: cannot be read"):
            if not path.exists():
                raise FileNotFoundError(f"{path}: there is no such video")
        capture = _open(path)
        told = capture.get(cv2.CAP_PROP_FPS)
        return Stream(capture, str(path), told if 1 <= told <= 1000 else USUAL_RATE)
    text = str(source)
    scheme = text.partition("://")[0] if "://" in text else ""
    if scheme and scheme not in SCHEMES:
        raise ValueError(f"{text}: not a stream that can be opened; URLs begin with {', '.join(SCHEMES)}")
    limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, PATIENCE, cv2.CAP_PROP_READ_TIMEOUT_MSEC, PATIENCE]
    with quiet(), suppress(cv2.error):
        capture = cv2.VideoCapture(text, cv2.CAP_FFMPEG, limits) if scheme else cv2.VideoCapture(int(text))
        if capture.isOpened():
            capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # what a camera keeps back is old when it comes
            return Stream(capture, text if scheme else f"camera {text}", None)
    if scheme:
        raise ValueError(f"{text}: the stream cannot be opened, or holds no video")
    raise ValueError(f"camera {text} cannot be opened: it is not there, or in use")


def write_video(path: PathLike, images: Iterable[FloatArray], rate: float = 30.0) -> None:
    """Write a video without loss (FFV1), whole or not at all.

    `path` ends in .mkv. `images` are (H, W) or (H, W, 3), all of one size, of stored values in [0, 1],
    of which 8 bits are kept; `rate` is in frames per second. OSError or ValueError in one sentence.
    """
    target = Path(path)
    if target.suffix != ".mkv":
        raise ValueError(f"a video's name ends in .mkv, got {target.name}")
    writer: cv2.VideoWriter | None = None
    sums: list[int] = []
    with staged_file(target) as temporary:
        try:
            for stored in _as_bytes(images):
                if writer is None:
                    how = cv2.VideoWriter.fourcc(*"FFV1"), rate, stored.shape[1::-1]
                    with quiet():
                        writer = cv2.VideoWriter(str(temporary), *how)
                    if not writer.isOpened():
                        raise OSError(f"cannot write {target}: OpenCV has no FFV1 encoder here")
                with quiet():  # a full disk would be printed, and is not said here
                    writer.write(stored)
                sums.append(zlib.crc32(stored.tobytes()))
        finally:
            if writer is not None:
                with quiet():
                    writer.release()
        if not sums:
            raise ValueError(f"cannot write {target}: there is no frame")
        whole = _same_frames(temporary, sums)
        if whole < len(sums):
            what = f"only {whole} of {len(sums)} frames can be read back; the disk may be full"
            raise OSError(f"cannot write {target}: {what}")


def _as_bytes(images: Iterable[FloatArray]) -> Iterator[np.ndarray]:
    """Give pictures as OpenCV stores them; ValueError, if they are no pictures or not of one size."""
    shape = None
    for number, image in enumerate(images):
        picture = image.ndim >= 2 and image.shape[2:] in ((), (3,))
        if not picture or image.shape != (shape or image.shape):
            expected = shape or "(H, W) or (H, W, 3)"
            raise ValueError(f"frame {number} of a video: expected {expected}, found {image.shape}")
        shape = image.shape
        stored = np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)
        yield cv2.cvtColor(stored, cv2.COLOR_GRAY2BGR if stored.ndim == 2 else cv2.COLOR_RGB2BGR)


def _same_frames(path: Path, sums: Sequence[int]) -> int:
    """Count the frames of a video, from the first, that have these checksums."""
    with quiet():
        capture = cv2.VideoCapture(str(path))
    try:
        for number, expected in enumerate(sums):
            with quiet():
                done, stored = capture.read()
            if not done or zlib.crc32(stored.tobytes()) != expected:
                return number
    finally:
        capture.release()
    return len(sums)
