"""Answers that follow a hand: the newest wish wins, and what was found of light and contours is held.

    a knob moves       look   a step on a quarter of the pixels, from the last answer
    the hand rests     kept   the same problem at full size, from where light and contours were found
    in idle time              the same for other λ, and on to larger ones until too little is explained
    asked anew         anew   light and contours as well: what `reconstruct` makes of the frame

An energy's other solvers have no looks: their iterates are shown as they come. One thread does all of it;
whatever takes long asks at each step whether a newer wish has come. A kept answer follows from the wish and
from what is held alone, so that `held.npz` and the settings give it again, bit for bit.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property

import numpy as np
from skimage.measure import label

from endolab.numerics.arrays import FloatArray
from endolab.numerics.iteration import Status
from endolab.numerics.threads import limit_threads
from endolab.reconstruction.contrast import (
    ENOUGH_CONTRAST,
    explained_share,
    noise_of,
    suggest_lam,
)
from endolab.reconstruction.held import Held
from endolab.reconstruction.pipeline import reconstruct
from endolab.reconstruction.report import warnings
from endolab.reconstruction.uncertainty import Uncertainty, noise_left
from endolab.solvers.energy import contradicts, model_image
from endolab.solvers.gauss_newton import Look
from endolab.solvers.result import Iterate, Observer, Result
from endolab.workbench.plots.scales import truth_for
from endolab.workbench.tuning.source import Knobs, Source, Subject

REST = 0.15  # s without a wish, after which the hand rests
# Times the present λ, for the λ curve: from a tenth to ten times, the near ones first.
LAM_FACTORS = (0.32, 3.2, 0.1, 10.0)
# s between the iterates that are shown: of a frame's first run, coarse ones too, and of later ones
FIRST_SIGHTS = 0.4
BETWEEN = 0.06
LARGEST_LAM = 100.0  # that the slider reaches
PATH_LENGTH = 60  # iterates of the last run that can be looked at, at most
FOLLOWS = "gauss_newton"  # the solver whose looks follow a hand
WITH_ENERGY = (FOLLOWS, "primal_dual")


class AnswerKind(StrEnum):
    """How an answer was found: some in passing, KEPT and ANEW to their end."""

    LOOK = "look"  # on few pixels, from the last answer
    ITERATE = "iterate"  # of a run that goes on, or of the last one
    KEPT = "kept"
    ANEW = "anew"


@dataclass(frozen=True, eq=False)
class Still:
    """What stays while energy and light are turned."""

    subject: Subject  # what is looked at
    truth: FloatArray | None  # distance, (H, W), in the answers' unit; nan outside the mask
    noise: float  # of the grey picture, stored values
    noise_left: float  # of what is explained, once it was smoothed

    @classmethod
    def of(cls, subject: Subject, result: Result) -> Still:
        """Note what a result that was found anew is compared with."""
        truth = subject.truth
        if truth is not None:
            truth = truth_for(result, truth)
        return cls(subject, truth, noise_of(result.problem), noise_left(result)[0])


@dataclass(eq=False)
class Answer:
    """What the tuner found for one position of the knobs."""

    settings: Knobs
    kind: AnswerKind
    still: Still
    result: Result
    held: Held | None = None  # what it was solved with; None if all was found anew
    path: Sequence[Iterate] = ()  # iterates of the run, some of many
    uncertainty: Uncertainty | None = None

    @cached_property
    def residual(self) -> FloatArray:
        """Model minus frame, (H, W), grey levels of 255; nan where the picture says nothing against it."""
        problem = self.result.problem
        residual = model_image(problem, self.result.iterate.log_distance) - problem.image
        return np.where(contradicts(problem, residual), 255 * residual, np.nan)

    @cached_property
    def explained(self) -> float:
        """Share of the picture's contrast that the surface explains."""
        problem = self.result.problem
        return explained_share(problem, self.residual / 255, self.still.noise_left)

    @cached_property
    def errors(self) -> tuple[float, float] | None:
        """Mean and median error of the distance, %, if the truth is known."""
        if self.still.truth is None:
            return None
        error = 100 * np.abs(self.result.distance / self.still.truth - 1)
        known = error[np.isfinite(error)]
        return float(known.mean()), float(np.median(known))

    @cached_property
    def doubts(self) -> Sequence[str]:
        """What is doubtful about the surface, a sentence each."""
        return tuple(warnings(self.result))

    @property
    def is_final(self) -> bool:
        """Whether its solver has come to its end."""
        return self.kind in (AnswerKind.KEPT, AnswerKind.ANEW)

    @property
    def uses_lam(self) -> bool:
        """Whether its solver minimises an energy, which λ is part of."""
        return self.settings.solver in WITH_ENERGY

    @property
    def contours(self) -> int:
        """How many lines the surface is cut along."""
        cuts = self.result.problem.cuts
        return 0 if cuts is None else int(label(cuts.any(axis=0), connectivity=2).max())


def shown_as(iterate: Iterate) -> Result:
    """Return an iterate of a run that goes on as a result."""
    row = {"k": iterate.k, "energy": iterate.energy, **iterate.terms}
    return Result(iterate, Status.STOPPED, [row], 0.0)


def solve(
    wish: Knobs,
    subject: Subject,
    observers: Iterable[Observer] = (),
    still: Still | None = None,
    held: Held | None = None,
) -> Answer:
    """Find an answer, here and now: all anew, as `reconstruct` does, or with what is held."""
    steps = Path()
    result = reconstruct(
        subject.frame,
        wish.calibration_of(subject),
        held=held,
        observers=[steps.add, *observers],
        **wish.solving_settings(subject).keywords,
    )
    path = [one for one in steps.iterates if one.mask.shape == result.mask.shape]
    kind = AnswerKind.ANEW if held is None else AnswerKind.KEPT
    return Answer(wish, kind, still or Still.of(subject, result), result, held, path)


class Engine:
    """Answers the newest wish in a thread of its own.

    `show` is told each answer there, `note` that the hand rests or that more is known of λ, `refuse` a
    sentence for what cannot be answered.
    """

    def __init__(
        self,
        source: Source,
        show: Callable[[Answer], object],
        note: Callable[[], object] = lambda: None,
        refuse: Callable[[str], object] = lambda sentence: None,
    ) -> None:
        self.source = source  # to be replaced at any time
        self.show = show
        self.note = note
        self.refuse = refuse
        self.base: Answer | None = None  # whose light and contours are held
        self.tried: list[Answer] = []  # with these
        self._held: Held | None = None
        self._look: Look | None = None
        self._last: Iterate | None = None  # at full size, a look as well
        self._wish = Knobs()  # the newest
        self._anew = False  # whether all is to be found again
        self._news = threading.Event()  # a wish that nobody looks at yet
        self._asking = threading.Lock()
        self._thread = ThreadPoolExecutor(1, "endolab tuner")

    # From any thread ---------------------------------------------------------------------

    def ask(self, wish: Knobs, anew: bool = False) -> None:
        """Wish for an answer, and drop what was wished for before; returns at once."""
        with self._asking:
            self._anew |= anew
            self._wish = wish
            self._news.set()
        self.do(self._answer)

    def do(self, job: Callable[[], object]) -> None:
        """Do a job in the engine's thread, whatever is wished for meanwhile; returns at once."""

        def refuse_or_do() -> None:
            try:
                job()
            except Exception as error:  # whatever it is, the next wish may do better
                self.refuse((str(error).strip() or type(error).__name__).splitlines()[0])

        self._thread.submit(refuse_or_do)

    def wait(self, timeout: float | None = None) -> None:
        """Wait until all wishes and jobs are done; TimeoutError after so many seconds."""
        self._thread.submit(lambda: None).result(timeout)

    def close(self) -> None:
        """Stop what is being solved, and end the thread."""
        self._news.set()
        self._thread.shutdown(cancel_futures=True)

    def is_stale(self) -> bool:
        """Whether a newer wish has come than the one that is being answered."""
        return self._news.is_set()

    def best_lam(self, answer: Answer) -> tuple[float | None, bool]:
        """Return the largest λ that explains enough, with this answer's solver, and whether more may do."""
        curve = self.curve_of(answer)
        lams = [one.settings.lam for one in curve]
        return suggest_lam(lams, [one.explained for one in curve])

    def recall(self, wish: Knobs) -> Answer | None:
        """Return what was solved for a wish, if it was, with what is held."""
        return next((one for one in self.tried if one.settings == wish), None)

    def curve_of(self, answer: Answer) -> list[Answer]:
        """Return what was solved that differs from an answer by λ alone, by λ."""
        like = [
            one
            for one in self.tried
            if replace(one.settings, lam=answer.settings.lam) == answer.settings
        ]
        return sorted(like, key=lambda one: one.settings.lam)

    # In the engine's thread --------------------------------------------------------------

    def _answer(self) -> None:
        if not self.is_stale():  # the newest was answered with the one before
            return
        self._news.clear()
        wish = self._wish
        base = self.base
        subject = self.source.subject(wish)
        if (
            base is None
            or self._anew
            or subject is not base.still.subject
            or not wish.follows(base.settings)
        ):
            answer = self._find_anew(wish, subject)
        else:
            answer = self.recall(wish) or self._follow(wish)
        if answer is None:
            return
        if answer not in self.tried:
            self.tried.append(answer)
        self._last = answer.result.iterate
        self.show(answer)
        if self._look is not None:
            self._look.follow(answer.result.problem)
            self._look.start_from(self._last)
        if self._rests():
            self.note()
            if answer.uses_lam:
                self._try_others(answer)

    def _find_anew(self, wish: Knobs, subject: Subject) -> Answer | None:
        """Find all anew, and hold what was found of light and contours; None if a newer wish came."""
        answer = solve(wish, subject, [self._show_long(wish, subject)])
        with self._asking:
            if self.is_stale() and self.base is not None:
                return None
            self._anew = False
        result = answer.result
        light = wish.calibration_of(subject).photometry
        self._held = Held(result.problem, light, result.iterate.log_distance)
        self.base = answer
        self.tried = []
        self._look = Look(result.iterate) if answer.uses_lam else None
        return answer

    def _follow(self, wish: Knobs) -> Answer | None:
        """Show what follows at once; once the hand rests, solve at full size. None if a newer wish came."""
        base = self.base
        assert base is not None
        assert self._held is not None
        subject = base.still.subject
        if wish.solver == FOLLOWS and self._look is not None:
            problem = self._held.problem_with(wish, wish.calibration_of(subject))
            with limit_threads(1):
                self._last = self._look.follow(problem)
            sofar = shown_as(self._last)
            self.show(Answer(wish, AnswerKind.LOOK, base.still, sofar, self._held))
            if not self._rests():
                return None
        answer = self.solve_held(wish, [self._show_long(wish, subject, self._held)])
        return None if self.is_stale() else answer

    def _show_long(
        self, wish: Knobs, subject: Subject, held: Held | None = None
    ) -> Observer:
        """Show iterates of a solver that has no looks, and of a frame's first run.

        Stops when a newer wish came.
        """
        base = self.base
        still = base.still if base is not None and base.still.subject is subject else None
        shape = None if base is None else base.result.mask.shape
        pause = FIRST_SIGHTS if still is None else BETWEEN
        last_shown = 0.0

        def watch(iterate: Iterate) -> bool:
            nonlocal last_shown
            follows = wish.solver != FOLLOWS and iterate.mask.shape == shape
            is_due = time.perf_counter() - last_shown > pause
            if is_due and (still is None or follows):
                sofar = shown_as(iterate)
                if still is not None:
                    self._last = iterate
                of = still or Still.of(subject, sofar)
                self.show(Answer(wish, AnswerKind.ITERATE, of, sofar, held))
                last_shown = time.perf_counter()
            return self.is_stale() and base is not None

        return watch

    def solve_held(self, wish: Knobs, observers: Iterable[Observer] = ()) -> Answer:
        """Solve with what is held.

        Gauss-Newton begins where light and contours were found; the paper's path is slow, and goes on from
        what is shown.
        """
        base = self.base
        held = self._held
        assert base is not None
        assert held is not None
        if wish.solver == "primal_dual" and self._last is not None:
            held = replace(held, start=self._last.log_distance)
        return solve(wish, base.still.subject, observers, base.still, held)

    def _rests(self) -> bool:
        """Wait until the hand rests; return whether it does."""
        return not self._news.wait(REST)

    def _try_others(self, answer: Answer) -> None:
        """Solve for other λ, and on to the right until too little is explained."""
        wish = answer.settings
        wanted = [wish.lam * factor for factor in LAM_FACTORS]

        def stop(iterate: Iterate) -> bool:
            return self.is_stale()

        while wanted:
            other = replace(wish, lam=float(f"{wanted.pop(0):.2g}"))
            if not 0 < other.lam <= LARGEST_LAM:
                continue
            if self.recall(other) is None:
                found = self.solve_held(other, [stop])
                if self.is_stale():
                    return
                found.path = ()
                self.tried.append(found)
                self.note()
            curve = self.curve_of(answer)
            if not wanted and curve[-1].explained >= ENOUGH_CONTRAST:
                wanted.append(3.2 * curve[-1].settings.lam)


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
        if len(self.iterates) > PATH_LENGTH:
            self.iterates = self.iterates[:-1:2] + self.iterates[-1:]
            self._step *= 2
