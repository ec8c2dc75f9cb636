"""What was detected in a video, kept in a file as it comes, so that nothing is looked for twice."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Self, TextIO

import numpy as np

from endolab.calibration.detection.detect import Detection
from endolab.calibration.targets import Target
from endolab.io.atomic import PathLike, write_atomically
from endolab.io.video import Frames

VERSION = 1  # of the file, and of the detector: another one detects anew


class Sightings:
    """Detections that survive an interruption: a file with one line of JSON for each frame.

    The first line says of which frames and which target they are; a file that says otherwise, or
    cannot be read, is begun anew. A last line that is cut off is ignored.

    Parameters
    ----------
    path : path
    frames : Frames
    target : Target

    Attributes
    ----------
    known : dict of str to Detection
        By the name of the frame.
    size : (int, int) or None
        Width and height of the frames, px, once known.

    Raises
    ------
    OSError
        If the file cannot be written.
    """

    def __init__(self, path: PathLike, frames: Frames, target: Target) -> None:
        self.path = Path(path)
        self.known: dict[str, Detection] = {}
        self.size: tuple[int, int] | None = None
        self._head = json.dumps(
            {
                "endolab_detections": VERSION,
                "target": {"kind": target.kind, **asdict(target)},
                "files": frames.stamp,
            }
        )
        self._stream: TextIO | None = None
        self._read()

    def _read(self) -> None:
        try:
            head, *lines = self.path.read_text(encoding="utf-8").split("\n")
        except (OSError, ValueError):
            return
        if head != self._head:
            return
        for line in lines[:-1]:  # what follows the last line break is empty, or cut off
            try:
                name, (width, height), ids, pixels, reason = json.loads(line)
            except ValueError:
                return
            self.size = width, height
            self.known[name] = Detection(np.array(ids, int), np.array(pixels, float).reshape(-1, 2), reason)

    def _line(self, name: str, size: tuple[int, int]) -> str:
        found = self.known[name]
        return json.dumps([name, size, found.ids.tolist(), found.pixels.tolist(), found.reason]) + "\n"

    def __enter__(self) -> Self:
        # What was read is written again: a line that was cut off must not be gone on with.
        lines = [self._head + "\n"]
        if self.size is not None:
            lines += [self._line(name, self.size) for name in self.known]
        write_atomically(self.path, "".join(lines).encode())
        self._stream = self.path.open("a", encoding="utf-8")
        return self

    def add(self, name: str, detection: Detection, size: tuple[int, int]) -> None:
        """Keep what was found in a frame of a size (width, height)."""
        self.known[name], self.size = detection, size
        if self._stream is not None:
            self._stream.write(self._line(name, size))
            self._stream.flush()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._stream is not None:
            self._stream.close()
