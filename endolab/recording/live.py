"""What a camera sees, shown while it sees it, by a thread that never makes the solver wait."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from endolab.depth.result import Result
from endolab.io.atomic import PathLike
from endolab.model.thinned import thinned_normals
from endolab.recording.sequence import SequenceRecorder
from endolab.recording.stream import Sink

CURVES = {
    "Frames a second": ["rate"],
    "Lag [ms]": ["lag"],
    "Frames dropped": ["dropped"],
    "Median distance": ["median_distance"],
}
PATIENCE = 0.02  # s between two looks whether the viewer has got a frame
ENDING = 3.0  # s that the last frame gets to arrive
MEMORY = "2GB"  # that a viewer started for it takes; then it forgets the oldest frames
KEPT = 1500  # frames in a file, which is held in memory until it is whole: less than 1 GB


@dataclass(frozen=True)
class _Surface:
    """A frame that is to be shown."""

    number: int
    result: Result
    scalars: Mapping[str, float]


class LiveView:
    """Shows one surface after the other, or keeps them in a file; those that come too fast are left out.

    Only the newest waits, and another one is logged when the viewer has got the last: a slow viewer sees
    fewer, and neither delays whoever calls nor fills the memory. A file holds the first `KEPT`.

    Parameters
    ----------
    path : path, optional
        The recording to write, ``.rrd``, when it is closed. Without it, the native viewer is started.
    address : str, optional
        Of another viewer or server that listens, ``rerun+http://127.0.0.1:9876/proxy``.

    Raises
    ------
    OSError
        In one sentence, if the file cannot be written or the viewer does not start.
    """

    def __init__(self, path: PathLike | None = None, address: str | None = None) -> None:
        self._sink = Sink(path, address=address, memory=MEMORY)
        self._recorder: SequenceRecorder | None = None
        self._changed = threading.Condition()
        self._next: _Surface | None = None
        self._open = True
        self._failure: Exception | None = None
        self.shown = self.left_out = 0
        self._thread = threading.Thread(target=self._run, daemon=True, name="endolab view")
        self._thread.start()

    @property
    def gone(self) -> bool:
        """Whether the user has closed the viewer's window, or it cannot be reached any more."""
        return self._sink.gone or self._failure is not None

    @property
    def full(self) -> bool:
        """Whether a file holds all that it can."""
        return self._sink.path is not None and self.shown >= KEPT

    def __call__(self, number: int, result: Result, scalars: Mapping[str, float]) -> None:
        """Show a surface at a place of the timeline as soon as may be, unless a newer one comes first."""
        with self._changed:
            if self._next is not None or self.full or self.gone:
                self.left_out += 1
            if not (self.full or self.gone):
                self._next = _Surface(number, result, scalars)
                self._changed.notify()

    def close(self) -> None:
        """End it: write the file, or see the last frame off. OSError, if it cannot be written."""
        if not self._open:
            return
        with self._changed:
            self._open = False
            self._changed.notify()
        self._thread.join(None if self._sink.path is not None else ENDING)
        if self._sink.path is None:
            self._sink.leave(ENDING)
        else:
            self._sink.close()
        if isinstance(self._failure, OSError):
            raise self._failure

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._next is not None or not self._open)
                surface, self._next = self._next, None
            if surface is None:
                return
            try:
                self._show(surface)
                while self._open and self._sink.path is None and not self._sink.sent:
                    time.sleep(PATIENCE)
            except Exception as failure:  # the view ends, and the camera goes on
                self._failure = failure
                return
            self.shown += 1

    def _show(self, surface: _Surface) -> None:
        problem, v = surface.result.problem, surface.result.iterate.log_distance
        if self._recorder is None:
            self._recorder = SequenceRecorder(self._sink, problem.unit, curves=CURVES)
        facing = thinned_normals(v, problem.field, problem.mask, 1)
        self._recorder.log(surface.number, problem.shown, np.exp(v), facing, problem.camera, surface.scalars)
