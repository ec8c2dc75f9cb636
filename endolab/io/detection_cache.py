"""What was detected in a video, kept in a file as it comes, so that nothing is looked for twice."""

import errno
import json
import os
import zlib
from collections.abc import Callable
from dataclasses import asdict, replace
from io import FileIO
from pathlib import Path
from typing import Self

import numpy as np

from endolab.calibration.detection.detect import Detection
from endolab.calibration.session import UNREADABLE, Progress, detect_all, silent
from endolab.calibration.targets import Target
from endolab.io.atomic import PathLike, check_file, one_sentence, read_bytes, write_atomically
from endolab.io.video import Frames
from endolab.model.cameras import KannalaBrandt

MARK = b'{"endolab_detections": '  # which every such file begins with
VERSION = 2  # of the file, and of the detector: another one detects anew


class DetectionCache:
    """Detections that survive an interruption: a file with one line of JSON for each frame.

    The first line says of which frames and which target they are; a file that says otherwise is begun
    anew. Every other line ends with its checksum; one that is cut off or damaged is ignored.
    FileExistsError, if the file is none of these, unless `overwrite`.
    """

    def __init__(self, path: PathLike, frames: Frames, target: Target, *, overwrite: bool = False) -> None:
        self.path = Path(path)
        self.known: dict[str, Detection] = {}  # by the name of the frame
        self.size: tuple[int, int] | None = None  # width and height of the frames, px, once known
        known = {"kind": target.kind, **asdict(target)}
        self._head = json.dumps({"endolab_detections": VERSION, "target": known, "files": frames.stamp})
        self._stream: FileIO | None = None
        if os.path.lexists(self.path):
            self._read(overwrite)

    def _read(self, overwrite: bool) -> None:
        content = read_bytes(self.path)
        check_file(self.path, overwrite=overwrite or content.startswith(MARK))
        head, *lines = content.split(b"\n")
        if head != self._head.encode():
            return
        for line in lines:
            try:
                *said, checksum = json.loads(line)
                if checksum != _checksum(said):
                    continue
                name, (width, height), ids, pixels, reason = said
            except (ValueError, TypeError, RecursionError):
                continue
            self.size = width, height
            self.known[name] = Detection(np.array(ids, int), np.array(pixels, float).reshape(-1, 2), reason)

    def _line(self, name: str, size: tuple[int, int]) -> str:
        found = self.known[name]
        said = [name, size, found.ids.tolist(), found.pixels.tolist(), found.reason]
        return json.dumps([*said, _checksum(said)]) + "\n"

    def __enter__(self) -> Self:
        # What was read is written again: a line that was cut off must not be gone on with.
        lines = [self._head + "\n"]
        if self.size is not None:
            lines += [self._line(name, self.size) for name in self.known]
        write_atomically(self.path, "".join(lines).encode())
        with one_sentence(f"cannot write {self.path}"):
            self._stream = self.path.open("ab", buffering=0)
        return self

    def add(self, name: str, detection: Detection, size: tuple[int, int]) -> None:
        """Keep what was found in a frame of a size (width, height)."""
        self.known[name], self.size = detection, size
        if self._stream is not None:
            line = self._line(name, size).encode()
            with one_sentence(f"cannot write {self.path}"):
                end = self._stream.seek(0, os.SEEK_END)
                if self._stream.write(line) != len(line):  # a full disk takes a part
                    self._stream.truncate(end)
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def __exit__(self, *_: object) -> None:
        if self._stream is not None:
            self._stream.close()
            if not self.known:  # nothing to go on from
                self.path.unlink(missing_ok=True)


def _checksum(said: list[object]) -> int:
    return zlib.crc32(json.dumps(said).encode())


def detect_cached(
    frames: Frames,
    target: Target,
    cache: PathLike,
    *,
    camera: KannalaBrandt | None = None,
    overwrite: bool = False,
    progress: Progress = silent,
    say: Callable[[str], None] | None = None,
) -> tuple[dict[str, Detection], tuple[int, int] | None]:
    """Find the target in the frames, going on from what a file holds of an earlier call.

    As `detect_all`, of which `camera` is, too; `overwrite` as for `DetectionCache`; `say` is told, in a
    sentence, how many frames were searched before. Frames that a video promises and does not hold are given
    that reason. An interrupt says what is kept.
    """
    with DetectionCache(cache, frames, target, overwrite=overwrite) as kept:
        rest = [name for name in frames.names if name not in kept.known]
        if kept.known and say is not None:
            say(f"{len(kept.known)} of {len(frames)} frames were searched before; going on from there")
        try:
            found, size = detect_all(
                frames.read(rest),
                target,
                count=len(rest),
                progress=progress,
                found=kept.add,
                size=kept.size,
                camera=camera,
            )
        except KeyboardInterrupt:
            told = f"interrupted; {len(kept.known)} of {len(frames)} frames are searched and kept"
            raise KeyboardInterrupt(told) from None
        everything = kept.known | found
    if frames.is_video:
        for name in reversed(frames.names):
            if everything[name].reason != UNREADABLE:
                break
            everything[name] = replace(everything[name], reason="the video ends before it")
    return {name: everything[name] for name in frames.names}, size
