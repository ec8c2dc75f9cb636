"""The tuner's engine: the latest wish wins, a rough answer comes first, and no wish waits in a queue.

A thread of its own solves; `Tuner.ask` returns at once. A new wish stops the solve in flight at its
next iterate. Every wish is answered twice, on a grid of half the size and then in full, and both
start from the last result there, so that a small change of λ costs a step or two. While a long
full solve goes on, what it has so far is told now and then.

How far the answer can be trusted, or what other λ would leave, is found besides if somebody looks at it:
after the last answer, by another thread that leaves the solver a core, and is told as that answer once more.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from endolab.depth.result import SCALED, SOLUTION, Iterate, Observer, Result
from endolab.numerics.arrays import FloatArray
from endolab.numerics.iteration import Status
from endolab.numerics.threads import limited_threads
from endolab.preprocessing.frame import Frame
from endolab.reconstruction.reconstruct import reconstruct
from endolab.trust.choice_of_lam import LamCurve
from endolab.trust.trust import Trust, trust_of
from endolab.tuning.source import SHRINK, Settings, Source, Subject, shrunk_map

if TYPE_CHECKING:
    from endolab.model.endoscope import Endoscope

PATIENCE = 0.4  # s that a full solve takes between one picture and the next
REST = 0.3  # s without a wish before anything is looked for besides
LEAST_WIDTH = 64  # px, of a grid that is worth a coarse one
TRUST, CURVE = "trust", "curve"  # what can be found besides
DRAWS = 8  # of random fields, for a trust that somebody waits for: σ is off by a quarter or less
# The most steps of a coarse answer, from a start and from nothing.
COARSE_STEPS = {"gauss_newton": (3, 10), "primal_dual": (60, 120)}


@dataclass(frozen=True)
class Outcome:
    """An answer of the tuner: a result, or an error."""

    serial: int  # of the wish, as `Tuner.ask` returned it
    settings: Settings
    stage: str  # "coarse", "fine", and between them "refining": what a long full solve has so far
    seconds: float  # from the start of this stage to its answer
    subject: Subject | None = None  # what was looked at
    result: Result | None = None
    error: str | None = None  # one sentence
    trust: Trust | None = None  # how far the result can be trusted, if somebody looks at it
    curve: LamCurve | None = None  # likewise: what each λ would leave
    untold: str | None = None  # one sentence: why there is no trust, or no curve

    @property
    def label(self) -> str:
        """The stage, or the one of a reconstruction on its way to its solution."""
        if self.result is None or self.result.iterate.stage in (SOLUTION, SCALED):
            return self.stage
        stage, round = self.result.iterate.stage, self.result.iterate.round
        return f"{stage}, round {round}" if round else stage

    @cached_property
    def truth(self) -> FloatArray | None:
        """True distance in the result's unit, (H, W), nan outside its mask; None if unknown."""
        if self.result is None or self.subject is None or self.subject.truth is None:
            return None
        truth, mask, distance = self.subject.truth, self.result.mask, self.result.distance
        if truth.shape != mask.shape:  # a stage on a smaller grid
            truth = shrunk_map(truth, mask.shape[::-1])
        truth = np.where(mask, truth, np.nan)
        known = np.isfinite(truth)
        if not known.any():
            return None
        return truth if self.result.metric else truth * np.median(distance[known] / truth[known])

    @cached_property
    def median_error(self) -> float | None:
        """Median of |d - d*|/d*, %; None if no truth is known."""
        if self.truth is None or self.result is None:
            return None
        return float(100 * np.nanmedian(np.abs(self.result.distance / self.truth - 1)))


class _Progress:
    """Stops a solve that is stale, and tells of a long one now and then what it has so far."""

    def __init__(self, is_stale: Callable[[], bool], tell: Callable[[Result, float], object]) -> None:
        self.is_stale, self.tell = is_stale, tell
        self.started = self.told = time.perf_counter()
        self.history: list[dict[str, float]] = []
        self.stage: tuple[str, int] | None = None

    def __call__(self, iterate: Iterate) -> bool:
        if self.is_stale():
            return True
        now = time.perf_counter()
        if self.stage != (iterate.stage, iterate.round):
            self.stage, self.history = (iterate.stage, iterate.round), []
        self.history.append({"k": iterate.k, "energy": iterate.energy, **iterate.terms})
        if now - self.told > PATIENCE:
            result = Result(iterate, Status.STOPPED, list(self.history), now - self.started)
            self.tell(result, now - self.started)
            self.told = time.perf_counter()
        return self.is_stale()


def sentence_of(error: BaseException) -> str:
    """Say an error in one line."""
    return (str(error).strip() or type(error).__name__).splitlines()[0]


class Tuner:
    """Solves what is asked for in a thread of its own.

    `on_outcome` is given every `Outcome` in that thread; if it raises, the sentence is kept in
    `complaint` and the tuner goes on. Scenes are rendered by the calibration, at any size;
    ``Settings(scene=None)`` looks at `frame`, whose true distance, mm, is `truth`, (H, W). `solve`
    takes what `reconstruct` takes.
    """

    def __init__(
        self,
        calibration: Endoscope,
        on_outcome: Callable[[Outcome], object] | None = None,
        *,
        frame: Frame | None = None,
        truth: FloatArray | None = None,
        solve: Callable[..., Result] = reconstruct,
    ) -> None:
        self.on_outcome, self.complaint = on_outcome, ""
        self._solve = solve
        self._changed = threading.Condition()
        self._serial = 0  # of the latest wish
        self._wish: Settings | None = None
        self._final: Outcome | None = None
        self._closed = False
        self._besides: str | None = None  # what is to be found
        self._curve: tuple[Source, Settings, LamCurve] | None = None  # the last, which holds for any λ
        self._telling = threading.Lock()
        self.use(calibration, frame, truth)
        self._answered_from = self._source
        work = {"endolab tuner": self._work, "endolab tuner, besides": self._work_besides}
        self._threads = [threading.Thread(target=job, name=name, daemon=True) for name, job in work.items()]
        for thread in self._threads:
            thread.start()

    # From any thread ---------------------------------------------------------------------

    def use(
        self, calibration: Endoscope, frame: Frame | None = None, truth: FloatArray | None = None
    ) -> None:
        """Look at another frame, or render with another calibration, from the next wish on.

        Raises ValueError if they are not of one size; then nothing changes.
        """
        source = Source(calibration, frame, truth)
        with self._changed:
            self._source = source

    def ask(self, settings: Settings) -> int:
        """Wish for a result, drop what was wished for before, and return the wish's serial number."""
        with self._changed:
            if self._closed:
                raise ValueError("the tuner is closed")
            self._serial += 1
            self._wish = settings
            self._changed.notify_all()
            return self._serial

    def look_at(self, besides: str | None) -> None:
        """Find this besides from now on: "trust", "curve" or, for None, nothing; returns at once."""
        with self._changed:
            self._besides = besides
            if self._final is not None and self._final.untold:
                self._final = replace(self._final, untold=None)
            self._changed.notify_all()

    def wait(self, timeout: float | None = None) -> Outcome:
        """Wait so many seconds for the last answer to the latest wish: fine, or with an error."""
        with self._changed:
            if self._serial == 0:
                raise ValueError("nothing was asked for")
            self._changed.wait_for(lambda: self._closed or self._is_answered(), timeout)
            if self._final is None or not self._is_answered():
                raise TimeoutError("the tuner was closed" if self._closed else f"no answer in {timeout} s")
            return self._final

    def cold(self, settings: Settings, observers: Iterable[Observer] = ()) -> Outcome:
        """Solve here and now, from a cold start: exactly what the lines of `Settings.code` give."""
        started = time.perf_counter()
        with self._changed:
            source = self._source
        subject = source.subject(settings)
        result = self._result(subject, settings, observers=observers)
        return Outcome(self._serial, settings, "fine", time.perf_counter() - started, subject, result)

    def close(self) -> None:
        """Stop the solve in flight and end the threads; a second call does nothing."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join()

    def _result(self, subject: Subject, settings: Settings, **options: Any) -> Result:
        return self._solve(
            subject.frame,
            _known(subject, settings),
            **settings.keywords(subject.frame.image.ndim == 2) | options,
        )

    # In the tuner's thread ---------------------------------------------------------------

    def _is_answered(self) -> bool:
        return self._final is not None and self._final.serial == self._serial

    def _is_stale(self, serial: int) -> bool:
        return self._closed or self._serial != serial

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._wish is not None)
                if self._closed or self._wish is None:
                    return
                serial, settings, source = self._serial, self._wish, self._source
                self._wish = None
            for stage in ("coarse", "fine"):
                started = time.perf_counter()
                try:
                    solved = self._solved(source, settings, stage, serial)
                except Exception as error:  # whatever it is, the next wish may do better
                    outcome = Outcome(serial, settings, stage, 0.0, error=sentence_of(error))
                else:
                    if solved is None:
                        continue
                    seconds, curve = time.perf_counter() - started, self._known_curve(source, settings)
                    outcome = Outcome(serial, settings, stage, seconds, *solved, curve=curve)
                if self._is_stale(serial):
                    break
                self._tell(outcome, source)
                if outcome.error is not None:
                    break

    def _tell(self, outcome: Outcome, source: Source) -> None:
        with self._telling:
            self._show(outcome)
        if outcome.stage == "fine" or outcome.error is not None:
            with self._changed:
                self._final, self._answered_from = outcome, source
                self._changed.notify_all()

    def _show(self, outcome: Outcome) -> None:
        try:
            if self.on_outcome is not None:
                self.on_outcome(outcome)
        except Exception as error:
            self.complaint = sentence_of(error)

    def _solved(
        self, source: Source, settings: Settings, stage: str, serial: int
    ) -> tuple[Subject, Result] | None:
        """Subject and result of one stage; None if there is no point in it."""
        options: dict[str, Any] = {}
        grid = (settings.scene, settings.width, stage)
        takes_start = settings.solver in COARSE_STEPS
        if takes_start and grid in source.last:
            options["start"] = source.last[grid]
        if stage == "coarse":
            if settings.width < SHRINK * LEAST_WIDTH or settings.solver == "facing":
                return None
            if takes_start:
                options["max_iterations"] = COARSE_STEPS[settings.solver]["start" not in options]
        subject = source.coarse(settings) if stage == "coarse" else source.subject(settings)
        if self._is_stale(serial):
            return None

        def tell(sofar: Result, seconds: float) -> None:
            if stage == "fine":
                curve = self._known_curve(source, settings)
                self._tell(
                    Outcome(serial, settings, "refining", seconds, subject, sofar, curve=curve), source
                )

        options["observers"] = [_Progress(lambda: self._is_stale(serial), tell)]
        result = self._result(subject, settings, **options)
        if not self._is_stale(serial):
            source.keep(grid, result)
        return subject, result

    def _known_curve(self, source: Source, settings: Settings) -> LamCurve | None:
        """The curve that was found last, if it is of these settings but for λ."""
        if self._curve is None or self._curve[:2] != (source, replace(settings, lam=1.0)):
            return None
        return self._curve[2]

    # In the thread beside it ---------------------------------------------------------------

    def _lacking(self) -> str | None:
        """What is still to be found of the last answer."""
        final, besides = self._final, self._besides
        if besides is None or final is None or final.result is None or not self._is_answered():
            return None
        return None if final.untold or getattr(final, besides) is not None else besides

    def _rested(self) -> tuple[Outcome, str, Source] | None:
        """Wait until somebody looks at an answer, and what is to be found of it; None when it is closed."""
        with self._changed:
            while True:
                self._changed.wait_for(lambda: self._closed or self._lacking() is not None)
                if self._closed:
                    return None
                outcome = self._final
                self._changed.wait_for(lambda: self._closed or self._lacking() is None, REST)
                what = self._lacking()
                if outcome is not None and outcome is self._final and what is not None:
                    return outcome, what, self._answered_from

    def _work_besides(self) -> None:
        while (wanted := self._rested()) is not None:
            outcome, what, source = wanted
            try:
                with limited_threads(1):  # the next wish finds a core
                    found = self._trusted(outcome) if what == TRUST else self._weighed(outcome, source)
            except Exception as error:
                found = replace(outcome, untold=sentence_of(error))
            with self._telling:
                with self._changed:
                    if self._final is not outcome or self._is_stale(outcome.serial):
                        continue
                    self._final = found
                self._show(found)

    def _trusted(self, outcome: Outcome) -> Outcome:
        """The same with how far it can be trusted; a wish stops the search."""
        assert outcome.result is not None
        assert outcome.subject is not None
        known = _known(outcome.subject, outcome.settings)
        stop = [lambda _: self._is_stale(outcome.serial)]
        return replace(outcome, trust=trust_of(outcome.result, known, draws=DRAWS, observers=stop))

    def _weighed(self, outcome: Outcome, source: Source) -> Outcome:
        """The same with what each λ would leave; a wish stops the search."""
        assert outcome.subject is not None
        curves: list[LamCurve] = []

        def watch(iterate: Iterate) -> bool:
            curve = iterate.problem.origin.lam_curve
            curves.extend([] if curve is None else [curve])
            return curve is not None or self._is_stale(outcome.serial)

        self._result(outcome.subject, outcome.settings, lam="auto", observers=[watch])
        if not curves:
            return replace(outcome, untold="the search for λ was stopped")
        with self._changed:
            self._curve = source, replace(outcome.settings, lam=1.0), curves[0]
        return replace(outcome, curve=curves[0])


def _known(subject: Subject, settings: Settings) -> Endoscope:
    """The endoscope as the solver believes it to be."""
    return replace(subject.calibration, photometry=settings.believed(subject.calibration.photometry))
