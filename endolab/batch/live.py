"""A camera's frames as they come: when the solver is free it takes the newest, and the others are dropped."""

from __future__ import annotations

import os
import time
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from itertools import chain, islice
from queue import Empty, Queue
from statistics import median
from threading import Event, Thread
from typing import TYPE_CHECKING, Any

import numpy as np

from endolab.batch.table import FRAME_COLUMNS, Row, step_row
from endolab.frames.frame import Frame, check_size, shrink_bytes
from endolab.io.atomic import PathLike
from endolab.io.images import read_mask
from endolab.io.video import Stream, as_image, open_stream
from endolab.model.cameras import Camera
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.checks import check_int
from endolab.reconstruction.scale import check_scale
from endolab.reconstruction.sequence import Step, as_frame, reconstruct_sequence
from endolab.reconstruction.settings import LENGTHS

if TYPE_CHECKING:
    from endolab.workbench.recording.stream import Sink

LIVE_WIDTH = 320  # px to which a wider picture is shrunk, so that two cores keep up
LIVE_COLUMNS = (*FRAME_COLUMNS[:-1], "dropped", "lag", "error")

# Frames that came before, name, picture, and when it came, s.
Shot = tuple[int, str, np.ndarray, float]


@dataclass(frozen=True)
class LiveStep(Step):
    """What became of one of the frames that came, which `index` counts; see `Step`."""

    dropped: int = 0  # frames that came since the one before, and were not taken
    lag: float = 0.0  # s from the frame's coming to its surface


def read_newest(frames: Iterable[tuple[str, np.ndarray]]) -> Generator[Shot]:
    """Read frames in a thread, as fast as they come, and give always the last; when closed, it ends.

    What the reader raises is raised here. A camera that does not answer is left to itself at the end.
    """
    last: Queue[Shot | Exception | None] = Queue(1)
    closed = Event()

    def drop() -> None:
        with suppress(Empty):
            last.get_nowait()

    def read() -> None:
        end = None
        pictures = frames.raw_frames() if isinstance(frames, Stream) else frames
        try:
            for count, (name, picture) in enumerate(pictures):
                drop()
                last.put((count, name, picture, time.perf_counter()))
                if closed.is_set():
                    return
        except Exception as failure:  # who takes is told
            end = failure
        if not closed.is_set():
            last.put(end)  # when the last frame is taken

    reader = Thread(target=read, daemon=True, name="endolab camera")
    reader.start()
    try:
        while (shot := last.get()) is not None:
            if isinstance(shot, Exception):
                raise shot
            yield shot
    finally:
        closed.set()
        if isinstance(frames, Stream):
            frames.close()
        drop()
        reader.join(2.0)


def reconstruct_live(
    source: int | PathLike | Stream | Iterable[tuple[str, FloatArray]],
    calibration: Calibration,
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
    full = calibration.camera
    wide = min(LIVE_WIDTH, full.width) if width is None else check_int("width", width, 1)
    if wide > full.width:
        raise ValueError(f"width must be at most the picture's {full.width} px, got {wide}")
    # Once for all frames, as the camera's rays take longer than a frame.
    camera = full.resize(wide, max(1, round(full.height * wide / full.width)))
    inside = (
        np.ones((full.height, full.width), dtype=bool) if mask is None else read_mask(mask)
    )
    check_size("the mask", inside.shape[::-1], full)
    check_scale(**{name: options.get(name) for name in LENGTHS})
    share = np.array([camera.width / full.width, camera.height / full.height])
    for name in LENGTHS[1:]:
        if options.get(name) is not None:
            options[name] = _move_length(options[name], share)
    named = isinstance(source, int | str | os.PathLike)
    shots = read_newest(open_stream(source) if named else source)  # type: ignore[arg-type]
    taken: list[Shot] = []

    def frames(first: Shot) -> Iterator[tuple[str, Frame]]:
        for shot in islice(chain([first], shots), limit):
            taken.append(shot)
            yield shot[1], _shrink(shot, inside, camera, calibration.photometry.gamma)

    with closing(shots):
        first = next(shots, None)
        if first is None:
            return
        check_size(first[1], first[2].shape[1::-1], full)
        usual = {
            "channel": "green" if first[2].ndim == 3 else "grey",
            "regulariser": "second",
        }
        small = replace(calibration, camera=camera)
        last = -1
        for step in reconstruct_sequence(frames(first), small, **usual | options):
            count, _, _, arrived = taken.pop()
            seen = vars(step) | {"index": count, "dropped": count - last - 1}
            yield LiveStep(**seen, lag=time.perf_counter() - arrived)
            last = count


def _shrink(shot: Shot, inside: BoolArray, camera: Camera, gamma: float) -> Frame:
    """Make a small frame; one of another size than the mask's stays as it is, to be refused."""
    _, name, picture, _ = shot
    size = (camera.width, camera.height)
    stored = picture.dtype == np.uint8
    smaller = picture.shape[:2] == inside.shape and size != inside.shape[::-1]
    if stored and smaller and inside.all():
        return as_frame(name, shrink_bytes(picture, *size, gamma)[..., ::-1])
    image = as_image(picture) if stored else picture
    if picture.shape[:2] != inside.shape:
        return as_frame(name, image)
    frame = Frame(image, inside, name)
    return frame.resize(*size, gamma) if smaller else frame


def _move_length(length: Sequence[Any], share: FloatArray) -> tuple[Any, ...]:
    """Give a known length at the pixels of a picture that is this share of the whole one."""
    mm, *pixels = length
    moved = (np.reshape(pixels, (-1, 2)) + 0.5) * share - 0.5
    places = [tuple(place) for place in moved.tolist()]
    return (mm, *places) if len(places) > 1 else (mm, *places[0])


# What is told of it ---------------------------------------------------------------------
def live_row(step: LiveStep) -> Row:
    """What a table tells of a frame."""
    return step_row(step, step.index) | {"dropped": step.dropped, "lag": step.lag}


def live_summary(rows: list[Row], seconds: float) -> str:
    """Sum the rows of so many seconds up in a sentence."""
    came = len(rows) + sum(row["dropped"] for row in rows)
    summary = f"taken {len(rows)} of {came} frames"
    if rows:
        lag = 1000 * median(row["lag"] for row in rows)
        summary += f", {len(rows) / seconds:.1f} frames/s, lag {lag:.0f} ms median"
    failed = [row["error"] for row in rows if row["error"]]
    if failed:
        summary += f"; {len(failed)} could not be used, such as {failed[-1]}"
    return summary


def log_steps(steps: Iterable[LiveStep], sinks: Sequence[Sink]) -> Iterator[LiveStep]:
    """Give the steps on, each when its surface was logged where the `sinks` lead."""
    from endolab.workbench.recording.sequence import SequenceRecorder

    curves = {
        "Lag, s": ["lag"],
        "Frames dropped": ["dropped"],
        "Median distance": ["median_distance"],
    }
    recorders: list[SequenceRecorder] = []
    for step in steps:
        if step.result is not None:
            result = step.result
            problem = step.result.problem
            row = live_row(step)
            recorders = recorders or [
                SequenceRecorder(sink, problem.unit, curves=curves) for sink in sinks
            ]
            scalars = {name: row[name] for names in curves.values() for name in names}
            for recorder in recorders:
                recorder.log(
                    step.index,
                    problem.shown,
                    result.distance,
                    result.normals,
                    problem.camera,
                    scalars,
                )
        yield step
