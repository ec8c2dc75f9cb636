"""A camera's frames as they come: when the solver is free it takes the newest, and the others are dropped."""

from __future__ import annotations

import math
import os
import threading
import time
from collections import deque
from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import takewhile
from statistics import median
from typing import Any

import numpy as np

from endolab.batch.table import Row, measured
from endolab.io.atomic import PathLike
from endolab.io.images import read_mask
from endolab.io.video import Stream, as_image, open_stream
from endolab.model.endoscope import Endoscope
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.checks import whole
from endolab.preprocessing.frame import Frame, check_size, shrunk_bytes
from endolab.reconstruction.scale import check_scale
from endolab.reconstruction.sequence import SCALES, Step, framed, reconstruct_sequence

LIVE_WIDTH = 320  # px to which a wider picture is shrunk, so that two cores keep up
WINDOW = 1.0  # s over which the rate is counted
ENDING = 2.0  # s that a reader gets to end


@dataclass(frozen=True)
class LiveStep(Step):
    """What became of one of the frames that came, which `index` counts; see `Step`."""

    dropped: int = 0  # frames that came since the one before, and were not taken
    lag: float = 0.0  # s from the frame's coming to its surface


@dataclass(frozen=True)
class _Shot:
    """A frame that has come."""

    count: int  # frames that came before
    name: str
    picture: np.ndarray
    arrived: float  # s, of `time.perf_counter`


class Newest:
    """Reads frames in a thread, as fast as they come, and keeps the last alone."""

    def __init__(self, frames: Iterable[tuple[str, np.ndarray]]) -> None:
        self._frames = frames
        self._changed = threading.Condition()
        self._shot: _Shot | None = None
        self._ended = False
        self._failure: Exception | None = None
        self._reader = threading.Thread(target=self._read, daemon=True, name="endolab camera")
        self._reader.start()

    def take(self) -> _Shot | None:
        """Wait for a frame that was not taken yet; None at the end. What the reader raised is raised here."""
        with self._changed:
            self._changed.wait_for(lambda: self._shot is not None or self._ended)
            shot, self._shot = self._shot, None
        if shot is None and self._failure is not None:
            raise self._failure
        return shot

    def close(self) -> None:
        """End the reading; a camera that does not answer is left to itself."""
        with self._changed:
            self._ended = True
        if isinstance(self._frames, Stream):
            self._frames.close()
        self._reader.join(ENDING)

    def _read(self) -> None:
        frames = self._frames.stored() if isinstance(self._frames, Stream) else iter(self._frames)
        try:
            for count, (name, picture) in enumerate(frames):
                with self._changed:
                    if self._ended:
                        break
                    self._shot = _Shot(count, name, picture, time.perf_counter())
                    self._changed.notify()
        except Exception as failure:  # who takes is told
            self._failure = failure
        finally:
            if isinstance(frames, Generator):
                frames.close()
            with self._changed:
                self._ended = True
                self._changed.notify()


class _Smaller:
    """Makes frames of pictures, small enough, with a calibration and lengths that go with them."""

    def __init__(self, calibration: Endoscope, mask: BoolArray | None, width: int | None) -> None:
        full, self._mask = calibration.camera, mask
        self._full, self._gamma = full, calibration.photometry.gamma
        wide = min(LIVE_WIDTH, full.width) if width is None else whole("width", width, 1)
        if wide > full.width:
            raise ValueError(f"width must be at most the picture's {full.width} px, got {wide}")
        self.size = wide, max(1, round(full.height * wide / full.width))
        self.shrinks = wide < full.width
        # Once for all frames, as the camera's rays take longer than a frame.
        self.calibration = (
            replace(calibration, camera=full.resize(*self.size)) if self.shrinks else calibration
        )
        if mask is not None and mask.shape != (full.height, full.width):
            check_size("the mask", mask.shape[::-1], full)

    def frame(self, shot: _Shot) -> Frame:
        """Make a frame; one of another size than the calibration's stays so, to be refused."""
        picture, mask = shot.picture, self._mask
        right = picture.shape[:2] == (self._full.height, self._full.width)
        if picture.dtype == np.uint8 and right and mask is None and self.shrinks:
            image = shrunk_bytes(picture, *self.size, self._gamma)[..., ::-1]
            return framed(shot.name, image)
        image = as_image(picture) if picture.dtype == np.uint8 else picture
        frame = framed(shot.name, image) if mask is None or not right else Frame(image, mask, shot.name)
        return frame.resize(*self.size, self._gamma) if right and self.shrinks else frame

    def lengths(self, known: dict[str, Any]) -> dict[str, Any]:
        """Give known lengths, at pixels of the whole picture, at those of the small one."""
        share = np.array(self.size) / [self._full.width, self._full.height]

        def moved(pixel: Iterable[float]) -> tuple[float, float]:
            column, row = (np.array([*pixel]) + 0.5) * share - 0.5
            return float(column), float(row)

        found = dict(known)
        if (distance := known.get("known_distance")) is not None:
            found["known_distance"] = (distance[0], *moved(distance[1:]))
        if (diameter := known.get("known_diameter")) is not None:
            found["known_diameter"] = (diameter[0], *map(moved, diameter[1:]))
        return found


def reconstruct_live(
    source: int | PathLike | Stream | Iterable[tuple[str, FloatArray]],
    calibration: Endoscope,
    *,
    mask: PathLike | None = None,
    width: int | None = None,
    limit: int | None = None,
    **options: Any,
) -> Generator[LiveStep, None, None]:
    """Reconstruct what a camera sees, as it sees it: always its newest frame, each from the last.

    Frames that come while another one is solved are dropped, and counted, but for the last of them: the
    surface lags behind the camera by two frames' time at most, however slow the machine.

    Parameters
    ----------
    source : int, str, path, Stream or iterable
        A camera's number, a URL, or a video, which is played at its own rate, as `endolab.open_stream`
        takes them; or names and pictures, (H, W) or (H, W, 3) in [0, 1], from whatever gives them as they
        come.
    calibration : Calibration
        For pictures of that size.
    mask : path, optional
        A picture, bright where the frames are to be used.
    width : int, optional
        Shrink pictures to this many columns, px; by default those that are wider to `LIVE_WIDTH`.
    limit : int, optional
        Take so many frames at most; else it ends with the stream, or when it is closed.
    **options
        Those of `endolab.reconstruct_sequence`, but that by default ``channel`` is "green", or "grey" if
        the pictures are, and ``regulariser`` "second": light that has bounced takes longer to be found
        than a camera waits. Pixels of known lengths are those of the whole picture.

    Yields
    ------
    LiveStep
        One for every frame that was taken.

    Raises
    ------
    ValueError, OSError
        In one sentence, if the source cannot be opened or gives nothing, or if its first picture has
        not the calibration's size.
    """
    if limit is not None:
        whole("limit", limit, 1)
    smaller = _Smaller(calibration, None if mask is None else read_mask(mask), width)
    check_scale(**{name: options.get(name) for name in SCALES})
    options = smaller.lengths(options)
    named = isinstance(source, int | str | os.PathLike)
    newest = Newest(open_stream(source) if named else source)  # type: ignore[arg-type]
    taken: list[tuple[int, float]] = []  # of the last two frames: their counts, and when they came

    def handed(shot: _Shot | None) -> Iterator[tuple[str, Frame]]:
        left = math.inf if limit is None else limit
        while shot is not None:
            taken[:] = [*taken[-1:], (shot.count, shot.arrived)]
            yield shot.name, smaller.frame(shot)
            left -= 1
            shot = newest.take() if left > 0 else None

    try:
        first = newest.take()
        if first is None:
            return
        check_size(first.name, first.picture.shape[1::-1], calibration.camera)
        usual = {"channel": "green" if first.picture.ndim == 3 else "grey", "regulariser": "second"}
        given = {name: value for name, value in options.items() if value is not None}
        for step in reconstruct_sequence(handed(first), smaller.calibration, **usual | given):
            count, arrived = taken[-1]
            dropped = count - taken[0][0] - 1 if len(taken) > 1 else count
            seen = vars(step) | {"index": count}
            yield LiveStep(**seen, dropped=dropped, lag=time.perf_counter() - arrived)
    finally:
        newest.close()


def live_row(step: LiveStep) -> Row:
    """What a table tells of a frame."""
    row: Row = {"index": step.index, "status": "", "unit": "", "seconds": step.seconds}
    row |= dict.fromkeys(("iterations", "energy", "gain", "median_distance"), math.nan)
    row |= {"dropped": step.dropped, "lag": step.lag, "error": " ".join(step.error.split())}
    if step.result is not None:
        problem, found = step.result.problem, measured(step.result)
        row |= {name: found[name] for name in ("status", "iterations", "energy")}
        row |= {"unit": problem.unit, "gain": problem.photometry.gain}
        row["median_distance"] = float(np.median(step.result.distance[problem.mask]))
    return row


class Tally:
    """Counts what became of a camera's frames."""

    def __init__(self) -> None:
        self.taken = self.dropped = self.failed = 0
        self.lags: deque[float] = deque(maxlen=100_000)  # s
        self._times: deque[float] = deque(maxlen=100_000)  # s, of the surfaces
        self.error = ""  # of the last frame that could not be used

    def add(self, step: LiveStep) -> None:
        """Count a frame."""
        self.taken, self.dropped = self.taken + 1, self.dropped + step.dropped
        self.failed, self.error = self.failed + bool(step.error), step.error or self.error
        self.lags.append(step.lag)
        self._times.append(time.perf_counter())

    @property
    def rate(self) -> float:
        """Surfaces a second, of the last `WINDOW`; nan before there are two."""
        late = [*takewhile(lambda moment: moment >= self._times[-1] - WINDOW, reversed(self._times))]
        return (len(late) - 1) / (late[0] - late[-1]) if len(late) > 1 else math.nan

    def __str__(self) -> str:
        told = f"taken {self.taken} of {self.taken + self.dropped} frames"
        if self.taken > 1:
            rate = (len(self._times) - 1) / (self._times[-1] - self._times[0])
            told += f", {rate:.1f} frames/s, lag {1000 * median(self.lags):.0f} ms median"
        return told + (f"; {self.failed} could not be used, such as {self.error}" if self.failed else "")
