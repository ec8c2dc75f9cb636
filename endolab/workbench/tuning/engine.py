"""The tuner's engine: the latest wish wins, a rough answer comes first, and nothing waits in a queue.

A thread of its own does one job at a time; a new one stops the one in flight at its next iterate. A wish is
answered twice. The first answer is quick, since it follows from the last one: after a change of λ or ε alone
the last problem is solved again from where it ended, and otherwise a grid of half the size. The final one is
what `reconstruct` makes of the whole frame from a cold start, so that it depends on nothing that was tried
before and the lines of `Knobs.code` give it again, bit for bit; an energy with more than one minimum can
make the two differ, and the answer holds both. While a long solve goes on, what it has so far is told.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from typing import Any

import cv2
import numpy as np

from endolab.frames.frame import Frame
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import FloatArray
from endolab.numerics.derivatives import px_per_reference
from endolab.numerics.iteration import Status, Stopped
from endolab.reconstruction.reconstruct import reconstruct
from endolab.reconstruction.uncertainty.estimate import Uncertainty, uncertainty_of
from endolab.solvers.energy import contradicts, model_image
from endolab.solvers.result import Iterate, Observer, Result, run, with_provenance
from endolab.solvers.solvers import solve
from endolab.workbench.tuning.source import Knobs, Source, Subject


@dataclass(frozen=True)
class Pace:
    """What makes the tuner quick, chosen by hand at the knobs."""

    picture_interval: float = 0.4  # s of a full solve between one picture and the next
    least_width: int = 128  # px, of a frame that is worth solving at half its size first
    # Of random fields, for an uncertainty that somebody waits for: σ is off by a quarter or less.
    draws: int = 8

    def quick_steps(self, solver: str) -> tuple[int, int] | None:
        """The most steps of a quick answer, from a start and from nothing; None if there is no limit."""
        return {"gauss_newton": (3, 10), "primal_dual": (60, 120)}.get(solver)


class Stage(StrEnum):
    """How far an answer has come."""

    FIRST = "first look"
    SOFAR = "so far"  # what a long solve has
    FINAL = "final"


PACE = Pace()
IsStale = Callable[[], bool]


@dataclass(frozen=True, eq=False)
class Answer:
    """What the tuner found for one position of the knobs."""

    settings: Knobs
    stage: Stage
    seconds: float  # that it took
    subject: Subject  # what was looked at
    result: Result
    # The quick answer at full size, which the final one may differ from.
    followed: Result | None = None
    # How far the result can be trusted, once that was asked for.
    uncertainty: Uncertainty | None = None

    @cached_property
    def truth(self) -> FloatArray | None:
        """True distance in the result's unit, (H, W), nan outside its mask; None if unknown."""
        truth = self.subject.truth
        mask = self.result.mask
        distance = self.result.distance
        if truth is None:
            return None
        if truth.shape != mask.shape:  # a frame that was shrunk
            truth = np.asarray(
                cv2.resize(truth, mask.shape[::-1], interpolation=cv2.INTER_AREA), float
            )
        truth = np.where(mask, truth, np.nan)
        known = np.isfinite(truth)
        if not known.any():
            return None
        return (
            truth
            if self.result.metric
            else truth * np.median(distance[known] / truth[known])
        )

    @cached_property
    def error(self) -> FloatArray | None:
        """Distance over the true one, less one, (H, W), %; None if no truth is known."""
        return None if self.truth is None else 100 * (self.result.distance / self.truth - 1)

    @cached_property
    def median_error(self) -> float | None:
        """Median of |d - d*|/d*, %; None if no truth is known."""
        return None if self.error is None else float(np.nanmedian(np.abs(self.error)))

    @cached_property
    def residual(self) -> FloatArray:
        """Model minus frame, (H, W), grey levels of 255; nan where the picture says nothing against it."""
        problem = self.result.problem
        residual = model_image(problem, self.result.iterate.log_distance) - problem.image
        return np.where(contradicts(problem, residual), 255 * residual, np.nan)

    @cached_property
    def change(self) -> FloatArray | None:
        """By what the quick answer differs from this one, (H, W), %; None if it is not of this size."""
        if self.followed is None or self.followed.mask.shape != self.result.mask.shape:
            return None
        return 100 * (self.followed.distance / self.result.distance - 1)

    @property
    def data(self) -> float:
        """The energy's data term, [1]: how badly the picture is explained."""
        return self.result.iterate.terms["data"]

    @cached_property
    def roughness(self) -> float:
        """Mean angle between normals 1/320 of the longer side apart, degrees, but across what is cut."""
        normals = self.result.normals
        cuts = self.result.problem.cuts
        right, below = (
            np.linalg.norm(np.diff(normals, axis=axis), axis=-1) for axis in (1, 0)
        )
        if cuts is not None:
            right[cuts[0, :, :-1]] = np.nan
            below[cuts[1, :-1]] = np.nan
        mean = np.nanmean(np.append(right, below))
        return float(np.degrees(mean)) * px_per_reference(normals.shape)

    @cached_property
    def relief(self) -> tuple[float, float]:
        """How much the surface departs from a sphere around the camera, and from a plane, %."""
        seen = self.result.mask[::4, ::4]
        distance = self.result.distance[::4, ::4][seen]
        rays = self.result.problem.field.rays[::4, ::4][seen]
        low, high = np.percentile(np.log(distance), [5, 95])
        plane = np.linalg.lstsq(rays, 1 / distance, rcond=None)[0]
        bent = np.percentile(np.abs(distance * (rays @ plane) - 1), 95)
        return 100 * float(high - low), 100 * float(bent)

    @property
    def cut_count(self) -> int:
        """Steps between pixels over which the surface is cut."""
        cuts = self.result.problem.cuts
        return 0 if cuts is None else int(cuts.sum())


def sentence_of(error: BaseException) -> str:
    """Say an error in one line."""
    return (str(error).strip() or type(error).__name__).splitlines()[0]


class Tuner:
    """Does what is asked for in a thread of its own.

    `tell` is given every `Answer`, and `refuse` a sentence for what cannot be answered, in that thread.
    Scenes are rendered by the calibration, at any size; ``Knobs(scene=None)`` looks at `frame`, whose
    true distance, mm, is `truth`, (H, W).
    """

    def __init__(
        self,
        calibration: Calibration,
        tell: Callable[[Answer], object] = lambda answer: None,
        refuse: Callable[[str], object] = lambda sentence: None,
        *,
        frame: Frame | None = None,
        truth: FloatArray | None = None,
    ) -> None:
        self.tell = tell
        self.refuse = refuse
        self._pool = ThreadPoolExecutor(1, "endolab tuner")
        self._asked = 0  # number of the last job; those before are stale
        self._job: Future[None] | None = None
        self._closed = False
        self._final: Answer | None = None
        self.use(calibration, frame, truth)

    # From any thread ---------------------------------------------------------------------

    def use(
        self,
        calibration: Calibration,
        frame: Frame | None = None,
        truth: FloatArray | None = None,
    ) -> None:
        """Look at another frame, or render with another calibration, from the next wish on.

        Raises ValueError if they are not of one size; then nothing changes.
        """
        self.source = Source(calibration, frame, truth)
        self._settled: Answer | None = None  # the last final answer

    def do(self, job: Callable[[IsStale], object], name: str = "") -> None:
        """Do a job in the tuner's thread, and drop what was asked for before; returns at once.

        One that has a name is never dropped, and if it fails `refuse` is told.
        """
        if self._closed:
            raise ValueError("the tuner is closed")
        self._asked += 1
        number = self._asked

        def is_stale() -> bool:
            return self._asked != number

        def run_it() -> None:
            if is_stale() and not name:
                return
            try:
                job(is_stale)
            except Exception as error:  # whatever it is, the next wish may do better
                if name or not is_stale():
                    self.refuse(
                        f"{name}: {sentence_of(error)}" if name else sentence_of(error)
                    )
                raise

        self._job = self._pool.submit(run_it)

    def ask(self, settings: Knobs) -> None:
        """Wish for an answer, and drop what was wished for before; returns at once."""
        source = self.source
        self.do(lambda is_stale: self._answer(source, settings, is_stale))

    def compare(
        self,
        answer: Answer,
        several: Sequence[Knobs],
        tell: Callable[[int, Answer], object],
    ) -> None:
        """Solve these, cut where an answer is; `tell` is given the number and the answer of each."""
        cuts = answer.result.problem.cuts
        held: dict[str, Any] = {"contours": False}
        if cuts is not None:
            held = {"contours": None, "cuts": cuts}

        def job(is_stale: IsStale) -> None:
            for number, settings in enumerate(several):
                if settings == answer.settings:
                    continue
                solved = self._solve(answer.subject, settings, [_watch(is_stale)], **held)
                if is_stale():
                    return
                tell(number, solved)

        self.do(job)

    def find_uncertainty(self, answer: Answer) -> None:
        """Find how far an answer can be trusted, and tell it once more."""

        def job(is_stale: IsStale) -> None:
            known = answer.settings.solving_settings(
                answer.subject.calibration, answer.subject.grey
            )
            believed = known.apply(answer.subject.calibration)
            with suppress(Stopped):  # only a wish that came since does that
                uncertainty = uncertainty_of(
                    answer.result,
                    believed,
                    draws=PACE.draws,
                    observers=[lambda _: is_stale()],
                )
                if not is_stale():
                    self._tell_final(replace(answer, uncertainty=uncertainty))

        self.do(job)

    def recall(self, answer: Answer) -> None:
        """Drop what is in flight, and take an answer of before as the last one."""
        self._final = self._settled = answer
        self.do(lambda is_stale: None)

    def wait(self, timeout: float | None = None) -> Answer:
        """Wait so many seconds for the end of what was asked for last, and return the last final answer.

        Raises ValueError, in one sentence, if there is none to that.
        """
        job = None
        while self._job is not None and job is not self._job:
            job = self._job
            try:
                job.result(timeout)
            except TimeoutError:
                raise TimeoutError(f"no answer in {timeout} s") from None
            except Exception as error:
                if job is self._job:
                    raise ValueError(sentence_of(error)) from error
        if self._final is None:
            raise ValueError("nothing was asked for")
        return self._final

    def solve_cold(self, settings: Knobs, observers: Iterable[Observer] = ()) -> Answer:
        """Solve here and now: what the lines of `Knobs.code` give, and the last answer to a wish."""
        return self._solve(self.source.subject(settings), settings, observers)

    def close(self) -> None:
        """Stop the solve in flight and end the thread, when it has done all that is never dropped."""
        self._closed = True
        self._asked += 1
        self._pool.shutdown()

    def _solve(
        self,
        subject: Subject,
        settings: Knobs,
        observers: Iterable[Observer],
        **options: Any,
    ) -> Answer:
        """Solve a subject."""
        started = time.perf_counter()
        saved = settings.solving_settings(subject.calibration, subject.grey)
        keywords = {**saved.keywords, **options}
        known = saved.apply(subject.calibration)
        result = reconstruct(subject.frame, known, observers=observers, **keywords)
        return Answer(settings, Stage.FINAL, time.perf_counter() - started, subject, result)

    # In the tuner's thread ---------------------------------------------------------------

    def _tell_final(self, answer: Answer) -> None:
        self._final = answer
        self.tell(answer)

    def _answer(self, source: Source, settings: Knobs, is_stale: IsStale) -> None:
        subject = source.subject(settings)
        followed = None
        try:
            first = self._quick(subject, settings, is_stale)
            if first is not None and not is_stale():
                followed = first.followed
                self.tell(first)
        except Exception as error:  # the whole frame may do better
            self.refuse(f"there is no first look: {sentence_of(error)}")
        if is_stale():
            return

        def tell(sofar: Result) -> None:
            self.tell(Answer(settings, Stage.SOFAR, sofar.seconds, subject, sofar))

        answer = self._solve(subject, settings, [_watch(is_stale, tell)])
        if not is_stale():
            self._settled = replace(answer, followed=followed)
            self._tell_final(self._settled)

    def _quick(self, subject: Subject, settings: Knobs, is_stale: IsStale) -> Answer | None:
        """What follows from the last answer, or one of half the size; None if there is no point in either."""
        started = time.perf_counter()
        steps = PACE.quick_steps(settings.solver)
        before = self._settled
        # These leave light and contours as they are.
        moved: dict[str, Any] = {"lam": settings.lam, "epsilon": settings.epsilon}
        if steps and before and settings == replace(before.settings, **moved):
            problem = replace(before.result.problem, **moved)
            start = before.result.iterate.log_distance
            solver = solve(problem, settings.solver, start=start, max_iterations=steps[0])
            result = run(
                with_provenance(solver, before.result.provenance), [_watch(is_stale)]
            )
            seconds = time.perf_counter() - started
            return Answer(settings, Stage.FIRST, seconds, subject, result, followed=result)
        if settings.width < PACE.least_width:
            return None
        options: dict[str, Any] = {"max_iterations": steps[1]} if steps else {}
        options["width"] = min(settings.width, subject.frame.width) // 2
        return replace(
            self._solve(subject, settings, [_watch(is_stale)], **options), stage=Stage.FIRST
        )


def _watch(is_stale: IsStale, tell: Callable[[Result], object] | None = None) -> Observer:
    """Stop a solve that is stale, and tell now and then what a long one has so far."""
    started = last_told = time.perf_counter()

    def watch(iterate: Iterate) -> bool:
        nonlocal last_told
        now = time.perf_counter()
        if tell is not None and now - last_told > PACE.picture_interval and not is_stale():
            row = {"k": iterate.k, "energy": iterate.energy, **iterate.terms}
            tell(Result(iterate, Status.STOPPED, [row], now - started))
            last_told = time.perf_counter()
        return is_stale()

    return watch
