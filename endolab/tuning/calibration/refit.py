"""Fits that follow: a thread of its own fits again whenever other frames are left out; the last wish wins."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from endolab.calibration.geometric.fit import GeometricFit
from endolab.calibration.least_squares import FitIterate
from endolab.calibration.photometric.result import PhotometricFit
from endolab.numerics.iteration import Status
from endolab.tuning.calibration.material import Material
from endolab.tuning.engine import sentence_of


@dataclass(frozen=True)
class State:
    """Which frames are left out, and the fits; one that cannot do without them stays as it was before."""

    left_out: frozenset[str] = frozenset()
    camera: GeometricFit | None = None
    light: PhotometricFit | None = None
    camera_without: frozenset[str] = frozenset()  # frames that this fit was not shown
    light_without: frozenset[str] = frozenset()
    complaints: tuple[str, ...] = ()  # sentences: what could not be fitted
    seconds: float = 0.0
    steps: int = 0

    @property
    def is_stopped(self) -> bool:
        """Whether somebody stopped a fit: it is the best so far."""
        return any(fit is not None and fit.status is Status.STOPPED for fit in (self.camera, self.light))


class Refits:
    """Fits in a thread of its own.

    `on_state` is given every `State`, `on_step` what is fitted and each of its steps, both in that thread; if
    they raise, the sentence is kept in `complaint`.
    """

    def __init__(
        self,
        material: Material,
        first: State,
        on_state: Callable[[State], object],
        on_step: Callable[[str, FitIterate], object],
    ) -> None:
        self.material, self.state, self.complaint = material, first, ""
        self._on_state, self._on_step = on_state, on_step
        self._changed = threading.Condition()
        self._serial = self._answered = 0
        self._wish = first.left_out
        self._stopping = self._closed = False
        self._thread = threading.Thread(target=self._work, name="endolab calibration", daemon=True)
        self._thread.start()

    def ask(self, left_out: frozenset[str]) -> None:
        """Wish for fits without some frames, and drop what was wished for before; returns at once."""
        with self._changed:
            self._serial, self._wish, self._stopping = self._serial + 1, left_out, False
            self._changed.notify_all()

    def stop(self) -> None:
        """Stop what is fitted now; the best so far is kept."""
        with self._changed:
            self._stopping = True

    def wait(self, timeout: float | None = None) -> State:
        """Wait so many seconds for the answer to the last wish; an interrupt takes the best so far."""
        with self._changed:
            try:
                self._wait(timeout)
            except KeyboardInterrupt:
                self._stopping = True
                self._wait(timeout)
            return self.state

    def _wait(self, timeout: float | None) -> None:
        if not self._changed.wait_for(lambda: self._closed or self._answered == self._serial, timeout):
            raise TimeoutError(f"no fit in {timeout} s")

    def close(self) -> None:
        """Stop and end the thread; a second call does nothing."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        if self._thread is not threading.current_thread():
            self._thread.join()

    # In the thread ---------------------------------------------------------------------------

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._answered != self._serial)
                if self._closed:
                    return
                serial, left_out, last = self._serial, self._wish, self.state
            state = self._fitted(serial, left_out, last)
            with self._changed:
                if self._closed or serial != self._serial:
                    continue
                self.state = state
            self._tell(partial(self._on_state, state))
            with self._changed:
                self._answered = serial
                self._changed.notify_all()

    def _fitted(self, serial: int, left_out: frozenset[str], last: State) -> State:
        started, steps, complaints = time.perf_counter(), 0, []
        camera, light, without = last.camera, last.light, (last.camera_without, last.light_without)

        def watcher(what: str) -> Callable[[FitIterate], bool]:
            def watch(step: FitIterate) -> bool:
                nonlocal steps
                steps += 1
                self._tell(partial(self._on_step, what, step))
                return self._closed or self._stopping or serial != self._serial

            return watch

        if camera is not None:
            try:
                camera = self.material.fit_camera(camera, left_out, [watcher("camera")])
                without = (left_out, without[1])
            except Exception as error:
                complaints.append(sentence_of(error))
        if light is not None and serial == self._serial:
            try:
                light = self.material.fit_light(left_out, [watcher("light")])
                without = (without[0], left_out)
            except Exception as error:
                complaints.append(sentence_of(error))
        seconds = time.perf_counter() - started
        return State(left_out, camera, light, *without, tuple(dict.fromkeys(complaints)), seconds, steps)

    def _tell(self, call: Callable[[], object]) -> None:
        try:
            call()
        except Exception as error:
            self.complaint = sentence_of(error)
