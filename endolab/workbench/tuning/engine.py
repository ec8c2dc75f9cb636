"""The tuner's engine: the latest wish wins, a rough answer comes first, and nothing waits in a queue.

While the hand moves, answers follow from the last one. Two threads find them, each one at a time:

    a knob moves      look     a step on a quarter of the pixels; it always ends, then the     first thread
                               newest wish is next
    the hand rests    kept     the same problem at full size, until it has converged          second thread
    in idle time      final    all anew, light and contours too                               second thread
    thereafter                 four λ more, with the final light and contours                 second thread

A change of the energy alone (λ, ε, ξ, the regulariser) leaves the picture's light and its contours as they
are, which is what makes a look quick. After any other change there is a first look instead: one channel at
half the size, without contours.
The final answer is what `reconstruct` makes of the whole frame from a cold start, so that it depends on
nothing that was tried before and the lines of `Knobs.code` give it again, bit for bit; an energy with more
than one minimum can make the two differ, and the answer holds both. While a long solve goes on, what it has
so far is told. A new wish stops what the second thread does at its next iterate.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property
from typing import Any

import numpy as np

from endolab.frames.frame import Frame
from endolab.metrics.depth_errors import resample_truth
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import FloatArray
from endolab.numerics.iteration import Status, Stopped
from endolab.numerics.stencils import links, px_per_reference
from endolab.numerics.threads import limit_threads
from endolab.reconstruction.contrast import explained_share, noise_of
from endolab.reconstruction.pipeline import reconstruct
from endolab.reconstruction.report import warnings
from endolab.reconstruction.uncertainty import (
    Uncertainty,
    noise_left,
    uncertainty_of,
)
from endolab.solvers.energy import contradicts, model_image
from endolab.solvers.gauss_newton import DESCENT, Look, gauss_newton
from endolab.solvers.problem import Problem
from endolab.solvers.result import Iterate, Observer, Result, run
from endolab.workbench.tuning.source import Knobs, Source, Subject


@dataclass(frozen=True)
class Pace:
    """What makes the tuner quick, chosen by hand at the knobs."""

    picture_interval: float = 0.4  # s of a full solve between one picture and the next
    rest: float = 0.1  # s without a wish, after which the hand rests
    settled: float = 1e-2  # of distances: what follows has settled when it changes by less
    least_width: int = 128  # px, of a frame that is worth solving at half its size first
    remembered: int = 12  # final answers that come back without a solve
    # Of random fields, for an uncertainty that somebody waits for: σ is off by a quarter or less.
    draws: int = 8
    path_length: int = 60  # iterates of the last run that can be looked at, at most


PACE = Pace()
# Times the present λ, for the λ curve: from a tenth to ten times in even steps.
LAM_FACTORS = (0.1, 0.32, 1.0, 3.2, 10.0)
# The most steps of a first look from nothing; other solvers have no limit.
FIRST_STEPS = {"gauss_newton": 10, "primal_dual": 120}
# Knobs of the energy, which leave light and contours as they are.
ENERGY_KNOBS = ("lam", "epsilon", "threshold", "xi", "regulariser")
IsStale = Callable[[], bool]


class Stage(StrEnum):
    """How far an answer has come."""

    LOOK = "look"  # on few pixels, from the last answer
    FIRST = "first look"  # on few pixels of one channel, from nothing
    KEPT = "light and contours kept"
    SOFAR = "so far"  # what a long solve has
    PASSED = "iterate"  # of the last run
    FINAL = "final"


@dataclass(eq=False)
class Answer:
    """What the tuner found for one position of the knobs."""

    settings: Knobs
    stage: Stage
    seconds: float  # that it took
    subject: Subject  # what was looked at
    result: Result
    # The quick answer at full size, which the final one may differ from.
    followed: Result | None = None
    # How far the result can be trusted, filled in when that was asked for.
    uncertainty: Uncertainty | None = None
    # What the same light and contours give with another λ or regulariser, by the names of both.
    variants: dict[str, Answer] = field(default_factory=dict)
    path: Sequence[Iterate] = ()  # iterates of the run, some of many
    place: int = 0  # on that path, from 1, if it is an iterate

    @cached_property
    def truth(self) -> FloatArray | None:
        """True distance in the result's unit, (H, W), nan outside its mask; None if unknown."""
        if self.subject.truth is None:
            return None
        mask = self.result.mask
        truth = resample_truth(self.subject.truth, mask.shape)  # a frame may be shrunk
        truth = np.where(mask, truth, np.nan)
        if not self.result.metric:
            truth *= np.nanmedian(self.result.distance / truth)
        return truth

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
    def noise(self) -> float:
        """Standard deviation of the picture's noise, stored values."""
        return noise_left(self.result)[0]

    @cached_property
    def grey_noise(self) -> float:
        """The same of its grey values, see `explained_contrast`."""
        return noise_of(self.result.problem)

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """What can hardly be true of the result, a sentence each."""
        return warnings(self.result)

    @cached_property
    def change(self) -> FloatArray | None:
        """By what the quick answer differs from this one, (H, W), %; None if there was none of this size."""
        if self.followed is None:
            return None
        return 100 * (self.followed.distance / self.result.distance - 1)

    @property
    def uses_lam(self) -> bool:
        """Whether its solver minimises an energy, which λ is part of."""
        return self.settings.solver in FIRST_STEPS

    @cached_property
    def explained_contrast(self) -> float:
        """Share of the picture's contrast that the surface explains."""
        return explained_share(self.result.problem, self.residual / 255, self.grey_noise)

    @cached_property
    def residual_size(self) -> float:
        """Root mean square of the residual, grey levels of 255."""
        return float(np.sqrt(np.nanmean(self.residual**2)))

    def pass_by(self, index: int) -> Answer:
        """Return an iterate of the run, as an answer."""
        iterate = self.path[index]
        row = {"k": iterate.k, "energy": iterate.energy, **iterate.terms}
        result = Result(iterate, Status.STOPPED, [row], self.seconds)
        return Answer(
            self.settings, Stage.PASSED, self.seconds, self.subject, result, place=index + 1
        )

    def variants_of_lam(self) -> list[Answer]:
        """Return what other λ give."""
        labels = values_of_lam(self.settings.lam)
        return [one for label, one in self.variants.items() if label in labels]

    @cached_property
    def roughness(self) -> float:
        """Mean angle between normals 1/320 of the longer side apart, degrees, but across what is cut."""
        normals = self.result.normals
        joined = links(self.result.mask, self.result.problem.cuts)
        right = np.linalg.norm(np.diff(normals, axis=1), axis=-1)[joined[0, :, :-1]]
        below = np.linalg.norm(np.diff(normals, axis=0), axis=-1)[joined[1, :-1]]
        mean = np.mean(np.append(right, below))
        return float(np.degrees(mean)) * px_per_reference(normals.shape)

    @property
    def spread(self) -> FloatArray:
        """The greatest over the least of the distances that other λ give, less one, (H, W), %."""
        several = [self, *self.variants_of_lam()]
        logs = np.stack([one.result.iterate.log_distance for one in several])
        return np.asarray(100 * np.expm1(logs.max(axis=0) - logs.min(axis=0)))

    @property
    def cut_count(self) -> int:
        """Steps between pixels over which the surface is cut."""
        cuts = self.result.problem.cuts
        return 0 if cuts is None else int(cuts.sum())

    @cached_property
    def contours(self) -> int:
        """A number that is the same for the same cuts."""
        cuts = self.result.problem.cuts
        return 0 if cuts is None else hash(np.packbits(cuts).tobytes())


def values_of_lam(lam: float) -> dict[str, float]:
    """Return λ to be compared with one, and this one itself, by what they are called."""
    values = (float(f"{lam * times:.2g}") if times != 1 else lam for times in LAM_FACTORS)
    return {f"λ {value:.2g}": value for value in values}


def sentence_of(error: BaseException) -> str:
    """Say an error in one line."""
    return (str(error).strip() or type(error).__name__).splitlines()[0]


class Tuner:
    """Does what is asked for in two threads of its own.

    `tell` is given every `Answer`, and again when more is known of it, `refuse` a sentence for what cannot be
    answered, in these threads.
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
        self.source = Source(calibration, frame, truth)  # to be replaced at any time
        self._looks = ThreadPoolExecutor(1, "endolab tuner looks")
        self._pool = ThreadPoolExecutor(1, "endolab tuner")
        self._asked = 0  # number of the last job; those before are stale
        self._wished = 0  # number of the last wish, ...
        self._answered = 0  # ... and of the last one that was answered or refused
        self._job: Future[None] | None = None
        self._answers: list[Answer] = []  # final ones, the last one at the end
        self._following = threading.Lock()  # of the two below, which both threads change
        self._last: Answer | None = None  # the last one at full size, a look as well
        self._followed: Look | None = None  # what looks follow from

    # From any thread ---------------------------------------------------------------------

    def do(self, job: Callable[[IsStale], object], name: str = "") -> None:
        """Do a job in the tuner's thread, and drop what was asked for before; returns at once.

        One that has a name is never dropped, and if it fails `refuse` is told.
        """
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
                self._answered = number
                if name or not is_stale():
                    sentence = sentence_of(error)
                    self.refuse(f"{name}: {sentence}" if name else sentence)
                raise

        self._job = self._pool.submit(run_it)

    def ask(self, settings: Knobs) -> None:
        """Wish for an answer, and drop what was wished for before; returns at once."""
        seen: Future[Answer | None] = Future()
        self._wished = number = self._asked + 1
        self.do(lambda is_stale: self._answer(settings, seen, number, is_stale))
        self._looks.submit(self._look, settings, seen, number)

    @property
    def waits(self) -> bool:
        """Whether the last wish is still to be answered: any other job would drop it."""
        return self._answered < self._wished

    def compare(self, answer: Answer, several: Mapping[str, Knobs]) -> None:
        """Solve all of these with an answer's light and contours; tell it anew with each of its variants."""
        self.do(lambda is_stale: self._vary(answer, several, is_stale))

    def find_uncertainty(self, answer: Answer) -> None:
        """Find how far an answer can be trusted, and tell it once more."""
        believed = answer.settings.solving_settings(answer.subject).apply(
            answer.subject.calibration
        )

        def job(is_stale: IsStale) -> None:
            watch = [_watch(is_stale)]
            with suppress(Stopped):  # only a wish that came since does that
                answer.uncertainty = uncertainty_of(
                    answer.result, believed, draws=PACE.draws, observers=watch
                )
                self.tell(answer)

        self.do(job)

    def wait(self, timeout: float | None = None) -> Answer:
        """Wait so many seconds for the end of what was asked for last, and return the last final answer.

        Raises ValueError, in one sentence, if there is none to that.
        """
        job = None
        while self._job is not None and job is not self._job:  # another may come meanwhile
            job = self._job
            try:
                job.result(timeout)
            except TimeoutError:
                raise TimeoutError(f"no answer in {timeout} s") from None
            except Exception as error:
                if job is self._job:
                    raise ValueError(sentence_of(error)) from error
        if not self._answers:
            raise ValueError("nothing was asked for")
        return self._answers[-1]

    def solve_cold(
        self,
        settings: Knobs,
        observers: Iterable[Observer] = (),
        subject: Subject | None = None,
        **options: Any,
    ) -> Answer:
        """Solve here and now: what the lines of `Knobs.code` give, and the last answer to a wish.

        Another `subject` can be looked at, with other `options` of `reconstruct`.
        """
        subject = subject or self.source.subject(settings)
        started = time.perf_counter()
        saved = settings.solving_settings(subject)
        known = saved.apply(subject.calibration)
        keywords = {**saved.keywords, **options}
        path = Path()
        observers = [*observers, path.add]
        result = reconstruct(subject.frame, known, observers=observers, **keywords)
        seconds = time.perf_counter() - started
        return Answer(settings, Stage.FINAL, seconds, subject, result, path=path.iterates)

    def close(self) -> None:
        """Stop the solve in flight and end the thread, when it has done all that is never dropped."""
        self._asked += 1
        self._looks.shutdown()
        self._pool.shutdown()

    # In the first thread -----------------------------------------------------------------

    def _look(self, settings: Knobs, seen: Future[Answer | None], number: int) -> None:
        """Tell what a step on few pixels makes of the last answer; None if no look can follow from it.

        It takes one core: the other draws the look before, and a page needs some, too.
        """
        started = time.perf_counter()
        try:
            answer = None
            with self._following, limit_threads(1):
                last = self._last
                followed = self._followed
                is_due = number == self._asked and self._recall(settings) is None
                if is_due and last and followed and self._follows(settings, last):
                    iterate = followed.follow(_with_energy(last, settings))
                    row = {"k": 0, "energy": iterate.energy, **iterate.terms}
                    seconds = time.perf_counter() - started
                    result = Result(iterate, Status.STOPPED, [row], seconds)
                    answer = Answer(settings, Stage.LOOK, seconds, last.subject, result)
                    answer.noise = last.noise  # as the picture is the same
                    answer.grey_noise = last.grey_noise
                    self._last = answer
            if answer is not None:
                self.tell(answer)
            seen.set_result(answer)
        except Exception as error:  # the second thread says it
            seen.set_exception(error)

    def _recall(self, settings: Knobs) -> Answer | None:
        """Return the final answer of these settings, if it is remembered."""
        for known in self._answers:
            if known.settings == settings and known.subject is self.source.subject(
                settings
            ):
                return known
        return None

    def _follows(self, settings: Knobs, last: Answer) -> bool:
        """Whether a wish differs from the last answer by the energy alone, and its solver has one."""
        energy = {name: getattr(settings, name) for name in ENERGY_KNOBS}
        return (
            settings.solver in FIRST_STEPS
            and settings == replace(last.settings, **energy)
            and last.subject is self.source.subject(settings)
        )

    # In the second thread ----------------------------------------------------------------

    def _answer(
        self,
        settings: Knobs,
        seen: Future[Answer | None],
        number: int,
        is_stale: IsStale,
    ) -> None:
        """Answer a wish: what follows from the last answer, or a first look; then the final answer."""
        subject = self.source.subject(settings)
        kept = None
        try:
            look = seen.result()
            known = self._recall(settings)
            if known is not None:
                self._finish(replace(known), number, is_stale)
                return
            if look is None:
                self._first_look(subject, settings, is_stale)
            elif _rests(is_stale):
                kept = self._settle(look, is_stale)
        except Exception as error:  # the whole frame may do better
            self.refuse(f"there is no first look: {sentence_of(error)}")
        if is_stale():
            return

        def tell(sofar: Result) -> None:
            if kept is None:
                self.tell(Answer(settings, Stage.SOFAR, sofar.seconds, subject, sofar))

        answer = self.solve_cold(settings, [_watch(is_stale, tell)], subject)
        if is_stale():
            return
        answer.followed = kept
        self._finish(answer, number, is_stale)

    def _finish(self, answer: Answer, number: int, is_stale: IsStale) -> None:
        """Tell a final answer, remember it as the last one, and have looks follow from it."""
        others = [known for known in self._answers if known.settings != answer.settings]
        for known in others:  # what is large
            known.variants = {}
            known.path = ()
        self._answers = [*others[-PACE.remembered :], answer]
        self._answered = number
        self.tell(answer)
        followed = None
        if answer.settings.solver in FIRST_STEPS:
            followed = Look(answer.result.iterate)
        with self._following:
            if is_stale():
                return
            self._last = answer
            self._followed = followed
        if followed is not None:
            lams = values_of_lam(answer.settings.lam).items()
            several = {label: replace(answer.settings, lam=lam) for label, lam in lams}
            self._pool.submit(self._vary, answer, several, is_stale)  # when there is time

    def _settle(self, seen: Answer, is_stale: IsStale) -> Result:
        """Solve the problem that was looked at, and tell what is found if no other wish came."""
        kept = solve_warm(seen, seen.settings, is_stale)
        result = kept.result
        with self._following:
            if is_stale():
                return result
            self._last = kept
            if self._followed is not None:
                self._followed.start_from(result.iterate)
        self.tell(kept)
        return result

    def _vary(
        self, answer: Answer, several: Mapping[str, Knobs], is_stale: IsStale
    ) -> None:
        """Tell an answer once more with each variant that it has not yet."""
        for label, settings in several.items():
            if label in answer.variants or settings == answer.settings:
                continue
            try:
                found = solve_warm(answer, settings, is_stale)
            except ValueError as error:
                self.refuse(f"{label}: {sentence_of(error)}")
                continue
            if is_stale():
                return
            answer.variants = answer.variants | {label: found}
            self.tell(answer)

    def _first_look(self, subject: Subject, settings: Knobs, is_stale: IsStale) -> None:
        """Tell what one channel says at half the size without contours, if there is a point in that."""
        if settings.width < PACE.least_width:
            return
        options: dict[str, Any] = {"width": min(settings.width, subject.frame.width) // 2}
        options["contours"] = False
        if settings.uses_colours and subject.frame.image.ndim == 3:
            options["channel"] = "green"
        if settings.solver in FIRST_STEPS:
            options["max_iterations"] = FIRST_STEPS[settings.solver]
        first = self.solve_cold(settings, [_watch(is_stale)], subject, **options)
        if not is_stale():
            self.tell(replace(first, stage=Stage.FIRST))


def _with_energy(last: Answer, settings: Knobs) -> Problem:
    """The last answer's problem, with the energy that is wished for."""
    energy = {name: getattr(settings, name) for name in ENERGY_KNOBS}
    return replace(
        last.result.problem, **energy | {"regulariser": settings.used_regulariser}
    )


def solve_warm(
    answer: Answer, settings: Knobs, is_stale: IsStale = lambda: False
) -> Answer:
    """Solve what is wished for from an answer, with its light and contours."""
    before = answer.result
    problem = _with_energy(answer, settings)
    start = before.iterate.log_distance
    halvings = 0 if answer.stage == Stage.LOOK else DESCENT.like_halvings
    steps = gauss_newton(problem, start=start, settled=PACE.settled, halvings=halvings)
    result = run(steps, [_watch(is_stale)])
    return Answer(settings, Stage.KEPT, result.seconds, answer.subject, result)


class Path:
    """Notes some of the iterates of a run, all of a short one, and always the last."""

    def __init__(self) -> None:
        self.iterates: list[Iterate] = []
        self._count = 0
        self._step = 1

    def add(self, iterate: Iterate) -> None:
        """Note an iterate; an observer."""
        if (self._count - 1) % self._step:
            self.iterates.pop()  # which was the last one, and is no more
        self.iterates.append(iterate)
        self._count += 1
        if len(self.iterates) > PACE.path_length:
            self.iterates = self.iterates[:-1:2] + self.iterates[-1:]
            self._step *= 2


def _rests(is_stale: IsStale) -> bool:
    """Wait until the hand rests; return whether it does."""
    end = time.perf_counter() + PACE.rest
    while time.perf_counter() < end:
        if is_stale():
            return False
        time.sleep(PACE.rest / 20)
    return True


def _watch(
    is_stale: IsStale, tell: Callable[[Result], object] | None = None
) -> Callable[[Any], bool]:
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
