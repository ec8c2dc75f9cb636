"""Answers that follow a hand: the newest wish wins.

    a knob moves       look   a step on a quarter of the pixels, from the last answer
    the hand rests     final  the same problem at full size, as `solve` gives it of what was found
    in idle time              the same for other λ, to both sides until 99 % is crossed
    asked anew         find   light and contours as well, by these knobs

An energy's other solvers have no looks: their iterates are shown as they come. One thread does all of it;
whatever takes long asks at each step whether a newer wish has come.

An answer follows from its knobs, and from those by which light and contours were found: made afresh, it has
the same bits. So what is kept is a memory and no more, and goes where it takes too much room.
"""

from __future__ import annotations

import operator
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from skimage.measure import label

from endolab.metrics.contrast import (
    ENOUGH_CONTRAST,
    explained_share,
    noise_left,
    residual_of,
)
from endolab.numerics.arrays import FloatArray
from endolab.numerics.iteration import Status, Stopped, finish
from endolab.numerics.threads import limit_threads
from endolab.reconstruction.found import Found
from endolab.reconstruction.lamps import Lamps, divide_by_lamps
from endolab.reconstruction.pipeline import find, lamps_stay, solve_found
from endolab.reconstruction.scale import to_scale
from endolab.reconstruction.uncertainty import Uncertainty
from endolab.solvers.gauss_newton import Look
from endolab.solvers.problem import Problem
from endolab.solvers.result import SOLUTION, Iterate, Observer, Result
from endolab.workbench.tuning.source import Knobs, Source, Subject

REST = 0.15  # s without a wish, after which the hand rests
# Times the present λ, for the λ curve: from a tenth to ten times, the near ones first; and from its ends on.
LAM_FACTORS = (0.32, 3.2, 0.1, 10.0)
LAM_STEP = 3.2
# s between the iterates that are shown: of a frame's first run, coarse ones too, and of later ones
FIRST_SIGHTS = 0.4
BETWEEN = 0.06
LAMS = (1e-4, 100.0)  # that the slider reaches
PATH_LENGTH = 60  # iterates of the last run that can be looked at, at most
PATH_BYTES = 24e6  # and of their maps
KEPT_ANSWERS = 12  # beside the one on screen: as much room as their distances take
KEPT_FINDS = 2  # so many times light and contours are kept
LAMP_STEP = 3  # rows and columns from one pixel that lamps are asked of to the next
FOLLOWS = "gauss_newton"  # the solver whose looks follow a hand
WITH_ENERGY = (FOLLOWS, "primal_dual")


@dataclass(frozen=True, eq=False)
class Still:
    """What stays while energy, light and unit are turned."""

    knobs: Knobs  # by which it was found
    subject: Subject  # what is looked at
    truth: FloatArray | None  # distance, (H, W), mm; nan outside the mask
    per_mm: float  # of truth, in relative units
    noise_left: float  # of the picture once it was smoothed, stored values
    found: Found | None = None  # None while it is being found

    @classmethod
    def of(
        cls, knobs: Knobs, subject: Subject, first: Iterate, found: Found | None = None
    ) -> Still:
        """Note what answers are compared with, of the first of them, or of an iterate before it."""
        from endolab.metrics.depth_errors import resample_truth  # takes half a second

        truth = subject.truth
        per_mm = 1.0
        if truth is not None:
            truth = resample_truth(truth, first.mask.shape)
            truth[~first.mask | (truth <= 0)] = np.nan
            per_mm = float(np.nanmedian(first.distance / truth))
            if found is not None:  # whose unit may be another than that of a length
                gains = (
                    one.photometry.gain or 1.0 for one in (found.problem, first.problem)
                )
                per_mm *= float(np.sqrt(operator.truediv(*gains)))
        return cls(knobs, subject, truth, per_mm, noise_left(first)[0], found)

    def truth_in(self, unit: Result) -> FloatArray | None:
        """Return the true distance, (H, W), in the unit of a result."""
        if self.truth is None or unit.metric:
            return self.truth
        return self.per_mm * self.truth


@dataclass(eq=False)
class Answer:
    """What the tuner found for one position of the knobs."""

    settings: Knobs
    kind: Literal[
        "look", "iterate", "final"
    ]  # an iterate is of a run that goes on, or of the last one
    still: Still
    result: Result
    path: Sequence[Iterate] = ()  # iterates of the run, some of many
    state: int = 0  # counts wishes: that which it answered, when it was shown
    uncertainty: Uncertainty | None = None

    @cached_property
    def residual(self) -> FloatArray:
        """See `residual_of`; grey levels of 255."""
        return 255 * residual_of(self.result.iterate)

    @cached_property
    def explained(self) -> float:
        """Share of the picture's contrast that the surface explains."""
        problem = self.result.problem
        return explained_share(problem, self.residual / 255, self.still.noise_left)

    @cached_property
    def errors(self) -> tuple[float, float] | None:
        """Mean and median error of the distance, %, if the truth is known."""
        truth = self.still.truth_in(self.result)
        if truth is None:
            return None
        error = 100 * np.abs(self.result.distance / truth - 1)
        known = error[np.isfinite(error)]
        return float(known.mean()), float(np.median(known))

    @property
    def is_final(self) -> bool:
        """Whether its solver has come to its end."""
        return self.kind == "final"

    @property
    def is_anew(self) -> bool:
        """Whether light and contours were found by its own knobs."""
        return self.settings == self.still.knobs

    @property
    def uses_lam(self) -> bool:
        """Whether its solver minimises an energy, which λ is part of."""
        return self.settings.solver in WITH_ENERGY

    @property
    def contours(self) -> int:
        """How many lines the surface is cut along."""
        cuts = self.result.problem.cuts
        return 0 if cuts is None else int(label(cuts.any(axis=0), connectivity=2).max())

    def leave_screen(self) -> None:
        """Forget all that is made again when it is shown, its camera's rays as well, and the run."""
        for stays in ("explained", "errors"):
            getattr(self, stays)
        iterate = self.result.iterate
        camera = replace(iterate.problem.camera)
        iterate = replace(iterate, problem=replace(iterate.problem, camera=camera))
        self.result = replace(self.result, iterate=iterate)
        self.path = ()
        vars(self).pop("residual", None)

    @property
    def nbytes(self) -> int:
        """Of the maps that are its own."""
        maps = [self.result.iterate.log_distance]
        sigma, problem, found = self.uncertainty, self.result.problem, self.still.found
        if sigma is not None:
            maps += [sigma.sigma, sigma.sigma_shape, *sigma.causes.values()]
        if found is not None and problem.image is not found.problem.image:  # lamps moved
            maps += 2 * [problem.image]  # and ω
        return sum(one.nbytes for one in maps)


def shown_as(iterate: Iterate, knobs: Knobs) -> Result:
    """Return an iterate of a run that goes on as a result, in mm if a length is known."""
    row = {"k": iterate.k, "energy": iterate.energy, **iterate.terms}
    if iterate.stage == SOLUTION:
        iterate = to_scale(iterate, knobs)
    return Result(replace(iterate), Status.STOPPED, [row], 0.0)  # with maps of its own


def solve(
    wish: Knobs, subject: Subject, found: Found, observers: Iterable[Observer] = ()
) -> tuple[Result, Sequence[Iterate]]:
    """Solve with what was found, here and now; return some of the iterates, too."""
    steps = Path()
    result = solve_found(
        found,
        wish.calibration_of(subject),
        observers=[steps.add, *observers],
        **wish.solving_settings(subject).keywords,
    )
    return result, steps.iterates


def solve_anew(
    wish: Knobs, subject: Subject, watch: Observer = lambda iterate: None
) -> Answer:
    """Find light and contours by a wish's knobs, and solve with them, here and now."""
    settings = wish.solving_settings(subject).settings
    steps = find(subject.frame, wish.calibration_of(subject), settings)
    found = finish(steps, watch)
    result, path = solve(wish, subject, found, [watch])
    still = Still.of(wish, subject, result.iterate, found)
    return Answer(wish, "final", still, result, path)


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
        self.source = source
        self.show = show
        self.note = note
        self.refuse = refuse
        self.finds: list[Knobs] = []  # by which light and contours were found, ever
        self.stills: list[
            Still
        ] = []  # what of these is kept, the last that was used at the end
        self.tried: list[Answer] = []  # with these, likewise
        self.shown: Answer | None = None  # the last one
        self.settled: Answer | None = None  # the last one that was final
        self._look: Look | None = None  # at surfaces of the last of `stills`
        self._wish = Knobs()  # the newest
        self._base: Knobs | None = None  # by which its light and contours are to be found
        self._asked = self._state = (
            0  # so many wishes: in all, and up to the one that is answered
        )
        self._news = threading.Event()  # a wish that nobody looks at yet
        self._asking = threading.Lock()
        self._thread = ThreadPoolExecutor(1, "endolab tuner")

    # From any thread ---------------------------------------------------------------------

    def ask(self, wish: Knobs, anew: bool = False, found: int | None = None) -> None:
        """Wish for an answer, and drop what was wished for before; returns at once.

        Light and contours are to be those of one of `finds`; or those of the wish before, where they can
        stay; or, if asked `anew` and where they cannot, those that the wish itself finds.
        """
        with self._asking:
            base = self._base if found is None else self.finds[found]
            self._base = wish if anew or base is None or not wish.follows(base) else base
            self._wish = wish
            self._asked += 1
            self._news.set()
        self.do(self._answer)

    def do(self, job: Callable[[], object]) -> None:
        """Do a job in the engine's thread, whatever is wished for meanwhile; returns at once."""

        def refuse_or_do() -> None:
            try:
                job()
            except Stopped:  # a newer wish has come
                pass
            except Exception as error:  # whatever it is, the next wish may do better
                self.refuse((str(error).strip() or type(error).__name__).splitlines()[0])

        self._thread.submit(refuse_or_do)

    def wait(self, timeout: float | None = None) -> None:
        """Wait until all wishes and jobs are done; TimeoutError after so many seconds."""
        self._thread.submit(lambda: None).result(timeout)

    def close(self) -> None:
        """Stop what is being solved, and end the thread."""
        with self._asking:
            self._base = None
            self._news.set()
        self._thread.shutdown(cancel_futures=True)

    def is_stale(self) -> bool:
        """Whether a newer wish has come than the one that is being answered."""
        return self._news.is_set()

    def curve_of(self, answer: Answer) -> list[Answer]:
        """Return what was solved that differs from an answer by λ alone, by λ."""
        like = [
            one
            for one in self.tried
            if one.still is answer.still
            and one.settings.lam > 0
            and replace(one.settings, lam=answer.settings.lam) == answer.settings
        ]
        return sorted(like, key=lambda one: one.settings.lam)

    def number_of(self, answer: Answer) -> int | None:
        """Return which of `finds` found an answer's light and contours; None while they are being found."""
        known = answer.still.found is not None
        return self.finds.index(answer.still.knobs) if known else None

    def recall(self, wish: Knobs, still: Still) -> Answer | None:
        """Return what was solved for a wish, if it was, with what was found."""
        like = (one for one in self.tried if one.still is still)
        return next((one for one in like if one.settings == wish), None)

    def solve(
        self, wish: Knobs, still: Still, observers: Iterable[Observer] = ()
    ) -> Answer:
        """Return what was solved for a wish, or solve it here and now."""
        known = self.recall(wish, still)
        if known is not None:
            return known
        assert still.found is not None
        result, path = solve(wish, still.subject, still.found, observers)
        return Answer(wish, "final", still, result, path)

    # In the engine's thread --------------------------------------------------------------

    def _answer(self) -> None:
        if not self.is_stale():  # the newest was answered with the one before
            return
        with self._asking:
            self._news.clear()
            wish = self._wish
            base = self._base
            if base is None or not wish.follows(base):
                base = wish
            self._state = self._asked
        still = None
        try:
            still = self._find(base)
            answer = self.recall(wish, still) or self._follow(wish, still)
        except Stopped:
            raise
        except Exception:
            settled = self.settled
            with self._asking:
                # What cannot be found is nobody's base.
                if still is None and self._base == base:
                    self._base = None if settled is None else settled.still.knobs
            if self.is_stale():  # who asks for something else need not know
                raise Stopped from None
            if settled is not None and self.shown is not settled:
                self._show(settled)
            raise
        self._keep(answer)
        if answer is not self.shown or answer.state != self._state:
            self._show(answer)
        if answer.settings.solver != FOLLOWS:
            self._look = None
        elif self._look is None:
            self._look = Look(answer.result.iterate)
        else:
            surface = answer.result.iterate
            self._look.follow(problem_of(answer.settings, still, surface))
            self._look.start_from(answer.result.iterate)
        if self._rests():
            self.note()
            if answer.uses_lam:
                with suppress(ValueError):  # nobody has asked for what cannot be solved
                    self._try_others(answer)

    def _find(self, knobs: Knobs) -> Still:
        """Return what these knobs find, and keep their own answer; stopped, if nobody wants it any more."""
        still = next((one for one in self.stills if one.knobs == knobs), None)
        if still is None:
            subject = self.source.subject(knobs)
            show = self._show_long(knobs, subject)

            def watch(iterate: Iterate) -> None:
                show(iterate)
                if knobs != self._base:
                    raise Stopped

            answer = solve_anew(knobs, subject, watch)
            still = answer.still
            if knobs not in self.finds:
                self.finds.append(knobs)
            self.tried.append(answer)
        if still not in self.stills[-1:]:
            self._look = None
        self.stills = [*(one for one in self.stills if one is not still), still]
        self.stills = self.stills[-KEPT_FINDS:]
        self.tried = [one for one in self.tried if one.still in self.stills]
        return still

    def _keep(self, answer: Answer, other: Answer | None = None) -> None:
        """Keep an answer to be shown, and another; as there is room, the last of its λ curve, and of all."""
        new = [one for one in (other, answer) if one is not None]
        self.tried = [*(one for one in self.tried if one not in new), *new]
        curve = self.curve_of(answer)
        room = KEPT_ANSWERS * answer.result.iterate.log_distance.nbytes
        for one in sorted(self.tried[-2::-1], key=lambda one: one not in curve):
            one.leave_screen()
            room -= one.nbytes
            if room < 0:
                self.tried.remove(one)

    def _show(self, answer: Answer) -> None:
        self.shown = answer
        answer.state = self._state
        self.show(answer)
        if answer.is_final:
            self.settled = answer

    def _follow(self, wish: Knobs, still: Still) -> Answer:
        """Show what follows at once; once the hand rests, solve at full size. Stopped by a newer wish."""
        near = self.shown
        if near is None or near.still is not still:
            near = self.recall(still.knobs, still)
        if near is not None and wish.solver == FOLLOWS:
            if self._look is None:
                is_followed = near.settings.solver == FOLLOWS
                self._look = Look(near.result.iterate, is_followed)
            with limit_threads(1):
                surface = near.result.iterate
                look = self._look.follow(problem_of(wish, still, surface))
            self._show(Answer(wish, "look", still, shown_as(look, wish)))
            if not self._rests():
                raise Stopped
        show = self._show_long(wish, still.subject, still)
        return self.solve(wish, still, [show, self._stop_if_stale])

    def _stop_if_stale(self, iterate: Iterate) -> None:
        """End a run that nobody waits for any more; an observer."""
        if self.is_stale():
            raise Stopped

    def _show_long(
        self, wish: Knobs, subject: Subject, still: Still | None = None
    ) -> Observer:
        """Show iterates of a solver that has no looks, and all of a frame's first run."""
        before = self.settled
        is_first = before is None or before.still.subject is not subject
        pause = FIRST_SIGHTS if still is None else BETWEEN
        last_shown = 0.0

        def show(iterate: Iterate) -> None:
            nonlocal last_shown
            follows = wish.solver != FOLLOWS and iterate.stage == SOLUTION
            is_due = time.perf_counter() - last_shown > pause
            if is_due and (is_first or follows):
                of = still or Still.of(wish, subject, iterate)
                sight = shown_as(iterate, wish)
                self._show(Answer(wish, "iterate", of, sight))
                last_shown = time.perf_counter()

        return show

    def _rests(self) -> bool:
        """Wait until the hand rests; return whether it does."""
        return not self._news.wait(REST)

    def _try_others(self, answer: Answer) -> None:
        """Solve for other λ, and on to both sides until 99 % is crossed. Stopped by a newer wish."""
        wish = answer.settings
        curve = {one.settings.lam: one for one in self.curve_of(answer)}
        wanted = [wish.lam * factor for factor in LAM_FACTORS]
        while wanted := [lam for lam in wanted if LAMS[0] <= lam <= LAMS[1]]:
            for lam in (float(f"{lam:.2g}") for lam in wanted):
                other = curve[lam] = self.solve(
                    replace(wish, lam=lam), answer.still, [self._stop_if_stale]
                )
                if other not in self.tried:
                    self._keep(answer, other)
                    self.note()
            wanted = []
            if curve[min(curve)].explained < ENOUGH_CONTRAST:
                wanted.append(min(curve) / LAM_STEP)
            if curve[max(curve)].explained >= ENOUGH_CONTRAST:
                wanted.append(max(curve) * LAM_STEP)


def problem_of(wish: Knobs, still: Still, surface: Iterate) -> Problem:
    """Return what a wish asks to be solved of what was found; lamps that have moved, by a surface."""
    found = still.found
    assert found is not None
    settings = wish.solving_settings(still.subject).settings
    calibration = wish.calibration_of(still.subject)
    problem, _ = found.problem_with(settings, calibration)
    lamps = Lamps.of(calibration, settings)
    if lamps is not None and lamps_stay(found, problem, lamps):
        return problem
    ratio = None if lamps is None else lamps.ratio(surface, LAMP_STEP)
    return divide_by_lamps(problem, ratio)


class Path:
    """Notes some of the iterates of a run, all of a short one, and always the last."""

    def __init__(self) -> None:
        self.iterates: list[Iterate] = []
        self._count = 0
        self._step = 1

    def add(self, iterate: Iterate) -> None:
        """Note an iterate; an observer."""
        if iterate.stage != SOLUTION:  # the last one in mm
            return
        if (self._count - 1) % self._step:
            self.iterates.pop()  # which was the last one, and is no more
        self.iterates.append(iterate)
        self._count += 1
        length = min(PATH_LENGTH, int(PATH_BYTES // iterate.log_distance.nbytes))
        if len(self.iterates) > max(length, 2):
            self.iterates = self.iterates[:-1:2] + self.iterates[-1:]
            self._step *= 2
