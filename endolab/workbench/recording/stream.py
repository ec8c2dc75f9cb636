"""Where recordings go."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Self

import rerun as rr

from endolab.io.atomic import PathLike, check_writable, say_undrawn, write_atomically
from endolab.workbench.recording.layouts import ITERATIONS, Shown, layout
from endolab.workbench.recording.pictures import Painted


@contextmanager
def delay_interrupts() -> Iterator[None]:
    """Let an interrupt wait until a block has ended: half a picture or import would spoil the rest."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _: came.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if came:
        signal.raise_signal(came[0])


class Sink:
    """A recording that becomes a file, ``.rrd``.

    `close` writes it, whole or not at all; if nothing was logged, there is none. Until then it is in memory,
    as Rerun's own writer may never come to an end when it finds the disk full. As a context manager it is
    closed at the end, and an error leaves no file.
    """

    def __init__(self, path: PathLike, along: str = ITERATIONS) -> None:
        self.path = Path(path)
        self.along = along  # the timeline that is shown
        self.open = True  # for what is logged
        self.undrawn: list[str] = []  # a sentence, if there can be no recording
        # That were logged at some time, but for the run's name.
        self._entities: set[str] = set()
        if self.path.suffix != ".rrd":
            raise ValueError(f"a recording's name ends in .rrd, got {path}")
        check_writable(path)
        self._stream = rr.RecordingStream("endolab")
        self._content = rr.binary_stream(self._stream)

    def at(self, timeline: str, number: int) -> None:
        """Log at this place of a timeline from now on."""
        self._stream.set_time(timeline, sequence=number)

    @contextmanager
    def drawing(self) -> Iterator[None]:
        """Log within a block; if it fails, there is no recording, and `undrawn` says why."""
        if not self.open:
            raise ValueError("the recording is closed")
        with say_undrawn(self.path, self.undrawn), delay_interrupts():
            yield
        if self.undrawn:
            self.close(failed=True)

    def log(self, painted: Painted, run: str = "", static: bool = False) -> None:
        """Log of a run, now or for all times."""
        for entity, what in painted.items():
            self._stream.log(f"{run}/{entity}", what, static=static, strict=True)
        self._entities |= set() if static else painted.keys()

    def arrange(self, runs: Sequence[Shown]) -> None:
        """Tell the viewer how to open the recording, unless it holds nothing."""
        if runs:
            arranged = layout(runs, self._entities, self.along)
            self._stream.send_blueprint(arranged)
            arranged.stream.disconnect()

    def close(self, failed: bool = False) -> None:
        """Write the file, unless something has failed; a second call does nothing. OSError leaves no file."""
        if not self.open:
            return
        self.open = False
        with say_undrawn(self.path, self.undrawn):
            content = self._content.read()
            self._stream.disconnect()
            # As `rr.init` does, but the user's session goes on. Until then Rerun keeps streams that nobody
            # has, with two threads each.
            session = rr.get_global_data_recording()
            rr.bindings.flush_and_cleanup_orphaned_recordings()
            rr.set_global_data_recording(session)
            if self._entities and content is not None and not failed:
                write_atomically(self.path, content)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, failure: object, *_: object) -> None:
        self.close(failure is not None)
