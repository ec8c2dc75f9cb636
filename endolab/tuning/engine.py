"""The tuner's engine: the latest wish wins, a rough answer comes first, and no wish waits in a queue.

A thread of its own solves; `Tuner.ask` returns at once. A new wish stops the solve in flight at its
next iterate. Every wish is answered twice. The first answer is quick, since it follows from the last one:
after a change of λ or ε alone the last problem is solved again from where it ended, and otherwise a grid of
half the size. The final one is what `reconstruct` makes of the whole frame from a cold start, so that it
depends on nothing that was tried before and the lines of `Settings.code` give it again, bit for bit; an
energy with more than one minimum can make the two differ, and the outcome holds both. While a long solve goes
on, what it has so far is told now and then.

How far the answer can be trusted is found besides if somebody looks at it:
after the last answer, by another thread that leaves the solver a core, and is told as that answer once more.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.special

from endolab.depth.energy import contradicted, model_image
from endolab.depth.result import SCALED, SOLUTION, Iterate, Observer, Result, run
from endolab.depth.solvers import solve
from endolab.numerics.arrays import FloatArray
from endolab.numerics.iteration import Status
from endolab.numerics.penalties import huber
from endolab.numerics.threads import limited_threads
from endolab.preprocessing.frame import Frame
from endolab.reconstruction.reconstruct import reconstruct
from endolab.tuning.source import SHRINK, Settings, Source, Subject, shrunk_map
from endolab.uncertainty.causes import bounced_light
from endolab.uncertainty.trust import Trust, noise_left, trust_of

if TYPE_CHECKING:
    from endolab.model.endoscope import Endoscope

PATIENCE = 0.4  # s that a full solve takes between one picture and the next
REST = 0.3  # s without a wish before anything is looked for besides
LEAST_WIDTH = 64  # px, of a grid that is worth a coarse one
TRUST = "trust"  # what can be found besides
DRAWS = 8  # of random fields, for a trust that somebody waits for: σ is off by a quarter or less
# The most steps of a quick answer, from a start and from nothing.
COARSE_STEPS = {"gauss_newton": (3, 10), "primal_dual": (60, 120)}
FOLLOWED = ("lam", "epsilon")  # settings whose change leaves the light and the contours as they were found
REMEMBERED = 64e6  # bytes of iterates that are kept of a run, for a recording; then every other is dropped
QUICK, SOFAR, FINE = "coarse", "refining", "fine"  # stages of an answer


@dataclass(frozen=True)
class Outcome:
    """An answer of the tuner: a result, or an error."""

    serial: int  # of the wish, as `Tuner.ask` returned it
    settings: Settings
    stage: str  # `QUICK`, `FINE`, and between them `SOFAR`: what a long full solve has so far
    seconds: float  # from the start of this stage to its answer
    subject: Subject | None = None  # what was looked at
    result: Result | None = None
    error: str | None = None  # one sentence
    trust: Trust | None = None  # how far the result can be trusted, if somebody looks at it
    untold: str | None = None  # one sentence: why there is no trust
    followed: Result | None = None  # the quick answer at full size, which a fine one may differ from
    path: tuple[Iterate, ...] = field(default=(), repr=False)  # of a fine answer: how it was found

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
    def residual(self) -> FloatArray:
        """Model minus frame, (H, W), grey levels of 255; nan where the picture says nothing against it."""
        assert self.result is not None
        problem = self.result.problem
        residual = model_image(problem, self.result.iterate.log_distance) - problem.image
        return np.where(contradicted(problem, residual), 255 * residual, np.nan)

    @cached_property
    def noise(self) -> float:
        """Standard deviation of the noise that the explained picture has left, stored value."""
        assert self.result is not None
        return noise_left(self.result.problem)[0]

    @cached_property
    def noise_floor(self) -> float:
        """What the data term would be of a surface that leaves the noise alone."""
        assert self.result is not None
        problem = self.result.problem
        drawn = self.noise * scipy.special.ndtri((np.arange(200) + 0.5) / 200)
        share = float(np.isfinite(self.residual).sum() / problem.mask.sum())
        return share * float(huber(drawn, problem.threshold).mean())

    @cached_property
    def bounced(self) -> FloatArray:
        """Share of the light that came by way of other walls, (H, W), %, as this surface makes it."""
        assert self.result is not None
        problem = self.result.problem
        log_ratio = bounced_light(problem, self.result.iterate.log_distance)
        return np.where(problem.mask, -100 * np.expm1(-log_ratio), np.nan)

    @cached_property
    def change(self) -> FloatArray | None:
        """By what the quick answer differs from this one, (H, W), %; None if it is not of this size."""
        if self.result is None or self.followed is None or self.stage != FINE:
            return None
        if self.followed.mask.shape != self.result.mask.shape:
            return None
        return 100 * (self.followed.distance / self.result.distance - 1)

    @cached_property
    def median_error(self) -> float | None:
        """Median of |d - d*|/d*, %; None if no truth is known."""
        if self.truth is None or self.result is None:
            return None
        return float(100 * np.nanmedian(np.abs(self.result.distance / self.truth - 1)))


class _Progress:
    """Stops a solve that is stale, tells now and then what a long one has so far, remembers its path."""

    def __init__(
        self, is_stale: Callable[[], bool], tell: Callable[[Result, float], object] | None = None
    ) -> None:
        self.is_stale, self.tell = is_stale, tell
        self.started = self.told = time.perf_counter()
        self.history: list[dict[str, float]] = []
        self.stage: tuple[str, int] | None = None
        self.path: list[Iterate] = []
        self._every, self._seen = 1, 0

    def __call__(self, iterate: Iterate) -> bool:
        if self.is_stale():
            return True
        now = time.perf_counter()
        self._remember(iterate)
        if self.stage != (iterate.stage, iterate.round):
            self.stage, self.history = (iterate.stage, iterate.round), []
        self.history.append({"k": iterate.k, "energy": iterate.energy, **iterate.terms})
        if self.tell is not None and now - self.told > PATIENCE:
            result = Result(iterate, Status.STOPPED, list(self.history), now - self.started)
            self.tell(result, now - self.started)
            self.told = time.perf_counter()
        return self.is_stale()

    def _remember(self, iterate: Iterate) -> None:
        """Keep it, as long as there is room, and else every other one of all that were seen."""
        if self._seen % self._every == 0:
            self.path.append(iterate)
            if sum(one.log_distance.nbytes for one in self.path) > REMEMBERED:
                del self.path[1::2]
                self._every *= 2
        self._seen += 1


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
        self._others: list[tuple[int, Settings]] = []  # to be tried out, by number
        self._tell_other: Callable[[int, Outcome], object] = lambda number, outcome: None
        self._final: Outcome | None = None
        self._closed = False
        self._besides: tuple[str, ...] = ()  # what is to be found
        self._telling = threading.Lock()
        self.use(calibration, frame, truth)
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
            self._wish, self._others = settings, []
            self._changed.notify_all()
            return self._serial

    def try_out(self, others: Sequence[Settings], tell: Callable[[int, Outcome], object]) -> None:
        """Solve these one by one, until the next wish; `tell` is given the number and the outcome of each."""
        with self._changed:
            self._others, self._tell_other = list(enumerate(others)), tell
            self._changed.notify_all()

    def look_at(self, *besides: str) -> None:
        """Find these besides from now on, of which there is "trust"; returns at once."""
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
        """Solve here and now: what the lines of `Settings.code` give, and the last answer to a wish."""
        started = time.perf_counter()
        with self._changed:
            source = self._source
        subject = source.subject(settings)
        result = self._result(subject, settings, observers=observers)
        return Outcome(self._serial, settings, FINE, time.perf_counter() - started, subject, result)

    def close(self) -> None:
        """Stop the solve in flight and end the threads; a second call does nothing."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join()

    def _result(self, subject: Subject, settings: Settings, **options: Any) -> Result:
        given = settings.keywords(subject.frame.image.ndim == 2)
        if subject.width is not None:
            given["width"] = subject.width
        return self._solve(subject.frame, _known(subject, settings), **given | options)

    # In the tuner's thread ---------------------------------------------------------------

    def _is_answered(self) -> bool:
        return self._final is not None and self._final.serial == self._serial

    def _is_stale(self, serial: int) -> bool:
        return self._closed or self._serial != serial

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._wish is not None or self._others)
                if self._closed:
                    return
                serial, settings, source = self._serial, self._wish, self._source
                number, other = (0, None) if settings is not None else self._others.pop(0)
                self._wish = None
            if settings is None:
                if other is not None:
                    self._try(source, number, other, serial)
                continue
            followed: Result | None = None
            for stage, solved in ((QUICK, self._quick), (FINE, self._fine)):
                started = time.perf_counter()
                try:
                    outcome = solved(source, settings, serial)
                except Exception as error:  # whatever it is, the next wish may do better
                    if stage == QUICK:
                        continue  # what is wrong with the whole frame, if anything, is said of that
                    outcome = Outcome(serial, settings, stage, 0.0, error=sentence_of(error))
                if self._is_stale(serial):
                    break
                if outcome is not None:
                    followed = followed or outcome.followed
                    seconds = time.perf_counter() - started
                    self._tell(replace(outcome, seconds=seconds, followed=followed))

    def _try(self, source: Source, number: int, settings: Settings, serial: int) -> None:
        """Solve what is tried out."""
        started, tell = time.perf_counter(), self._tell_other
        try:
            subject = source.subject(settings)
            result = self._result(subject, settings, observers=[_Progress(lambda: self._is_stale(serial))])
            seconds = time.perf_counter() - started
            outcome = Outcome(serial, settings, FINE, seconds, subject, result)
        except Exception as error:
            outcome = Outcome(serial, settings, FINE, 0.0, error=sentence_of(error))
        if not self._is_stale(serial):
            try:
                tell(number, outcome)
            except Exception as error:
                self.complaint = sentence_of(error)

    def _tell(self, outcome: Outcome) -> None:
        with self._telling:
            self._show(outcome)
        if outcome.stage == FINE or outcome.error is not None:
            with self._changed:
                self._final = outcome
                self._changed.notify_all()

    def _show(self, outcome: Outcome) -> None:
        try:
            if self.on_outcome is not None:
                self.on_outcome(outcome)
        except Exception as error:
            self.complaint = sentence_of(error)

    def _quick(self, source: Source, settings: Settings, serial: int) -> Outcome | None:
        """What follows from the last answer, or a coarse one; None if there is no point in either."""
        steps = COARSE_STEPS.get(settings.solver)
        watch = _Progress(lambda: self._is_stale(serial))
        before, result = source.settled or (None, None)
        followed = {name: getattr(settings, name) for name in FOLLOWED}
        if steps and before and result and settings == replace(before, **followed):
            problem = replace(result.problem, lam=settings.lam, epsilon=settings.epsilon)
            start = {"start": result.iterate.log_distance, "max_iterations": steps[0]}
            found = run(solve(problem, settings.solver, **start), [watch])
            return Outcome(serial, settings, QUICK, 0.0, source.subject(settings), found, followed=found)
        if settings.width < SHRINK * LEAST_WIDTH or settings.solver == "facing":
            return None
        options: dict[str, Any] = {}
        grid = (settings.scene, settings.width)
        if steps is not None:
            if grid in source.last:
                options["start"] = source.last[grid]
            options["max_iterations"] = steps["start" not in options]
        subject = source.coarse(settings)
        if self._is_stale(serial):
            return None
        lengths = settings.shrunk(source.subject(settings).frame.width / subject.frame.width)
        result = self._result(subject, lengths, observers=[watch], **options)
        if not self._is_stale(serial):
            source.keep(grid, result)
        return Outcome(serial, settings, QUICK, 0.0, subject, result)

    def _fine(self, source: Source, settings: Settings, serial: int) -> Outcome | None:
        """The answer."""
        subject = source.subject(settings)
        if self._is_stale(serial):
            return None

        def tell(sofar: Result, seconds: float) -> None:
            self._tell(Outcome(serial, settings, SOFAR, seconds, subject, sofar))

        watch = _Progress(lambda: self._is_stale(serial), tell)
        result = self._result(subject, settings, observers=[watch])
        if not self._is_stale(serial):
            source.settled = settings, result
        return Outcome(serial, settings, FINE, 0.0, subject, result, path=tuple(watch.path))

    # In the thread beside it ---------------------------------------------------------------

    def _lacking(self) -> str | None:
        """What is still to be found of the last answer."""
        final = self._final
        if final is None or final.result is None or final.untold or not self._is_answered():
            return None
        return next((one for one in self._besides if getattr(final, one) is None), None)

    def _rested(self) -> Outcome | None:
        """Wait until somebody looks at an answer that lacks something; None when it is closed."""
        with self._changed:
            while True:
                self._changed.wait_for(lambda: self._closed or self._lacking() is not None)
                if self._closed:
                    return None
                outcome = self._final
                self._changed.wait_for(lambda: self._closed or self._lacking() is None, REST)
                if outcome is not None and outcome is self._final and self._lacking() is not None:
                    return outcome

    def _work_besides(self) -> None:
        while (wanted := self._rested()) is not None:
            outcome = wanted
            try:
                with limited_threads(1):  # the next wish finds a core
                    found = self._trusted(outcome)
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
        try:
            trust = trust_of(outcome.result, known, draws=DRAWS, observers=stop)
        except KeyboardInterrupt:  # stopped before there was anything to tell
            return outcome
        return replace(outcome, trust=trust)


def _known(subject: Subject, settings: Settings) -> Endoscope:
    """The endoscope as the solver believes it to be."""
    return replace(subject.calibration, photometry=settings.believed(subject.calibration.photometry))
