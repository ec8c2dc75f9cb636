"""Gauss-Newton on the energy, on ever finer grids: the default solver. Its steps are those of `descent`.

A fast march (`fast_marching`: one pass from the nearest points outwards) explains the frame, but takes the
surface to face the camera where it enters the picture, at the border and behind contours: the *inflow*. The
true values there are whatever makes the surface smoothest, and what is smooth is seen on a coarse grid as
well as on a fine one. So the frame is solved on ever finer grids: on the coarsest λ falls to its value from
ten times that; every finer one marches from the values that the coarser one found where the march enters (or
takes over the coarser map, if that has the lower energy), and takes a few steps. What is left for the frame's
own pixels is to be done in two or three.

A start is taken as it is if it is near, as after a small change of λ. If it is not, as in a video
whose camera moves, a grid of fewer pixels tells at little cost, and the finer ones take up what it
finds: the whole map, or its change alone, whichever has the lower energy.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

import numpy as np

from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import check_int, number
from endolab.numerics.compiled import inner, pad_maps
from endolab.numerics.iteration import Status
from endolab.solvers.descent import (
    Memory,
    Step,
    descend,
    evaluate,
    has_converged,
)
from endolab.solvers.grid import Grid
from endolab.solvers.problem import Problem, check_maps
from endolab.solvers.result import Iterate, Solver


def settle(steps: Iterator[Step], tolerance: float) -> Step:
    """Take up to four steps, as on each of the coarser grids."""
    for step in islice(steps, 4):
        if step.length == 0 or has_converged(step, tolerance):
            break
    return step


def _coarsen(grid: Grid, most: float = np.inf) -> list[Grid]:
    """Return the grid and `most` coarser ones, each of half the rows and columns of the one before.

    The coarsest has 24 rows and columns or more.
    """
    grids = [grid]
    while len(grids) <= most and min(grids[-1].mask.shape) >= 48:
        grids.append(grids[-1].coarser)
    return grids


def _starts(grids: list[Grid], tolerance: float) -> Iterator[Step]:
    """Maps at full size: what ever finer grids make of the frame, and at last where to step from.

    Each grid marches with the values of the guess where it enters, or takes the guess if its energy is less.
    The march is sharper, and right on smooth walls; over folds that hide something it is rough, and so it is
    in noise, the more so the finer the grid: once it has lost there is no need to march on finer ones. The
    first march crosses cuts: what lies behind them then comes loose only as far as the energy wants, while
    regions that are held by little would stay where a cut march puts them.
    """
    lam = grids[0].problem.lam
    coarsest = grids[-1]
    v = replace(coarsest, link=coarsest.uncut_links).march()
    marches = True
    for level in range(len(grids) - 1, -1, -1):
        grid = grids[level]
        state = evaluate(grid, v, lam)
        if marches and grid is not coarsest:
            marched = evaluate(grid, grid.march(v), lam)
            marches = marched.energy <= state.energy
            state = marched if marches else state
        if level == 0:
            yield state
            return
        for factor in (10.0, 3.0, 1.0) if grid is coarsest else (1.0,):
            start = evaluate(grid, state.v, factor * lam)
            state = settle(descend(grid, start, factor * lam), tolerance)
        v = shown = grids[level - 1].interpolate(state.v)
        for fine in reversed(grids[: level - 1]):
            shown = fine.interpolate(shown)
        yield Step(shown, grids[0].terms(shown, lam))


def _adapt_start(
    finest: Grid, start: FloatArray, tolerance: float, halvings: int
) -> FloatArray:
    """Return the start if it is near, or what ever finer grids make of it.

    It is near if its energy on the coarsest is no more than 1.2 times that after one step.
    """
    lam = finest.problem.lam
    grids = _coarsen(finest, halvings)
    if len(grids) == 1:
        return start
    starts = [start]
    for grid in grids[:-1]:
        starts.append(grid.restrict(starts[-1]))
    coarsest = grids[-1]
    begun = evaluate(coarsest, starts[-1], lam)
    steps = descend(coarsest, begun, lam)
    if begun.energy <= 1.2 * next(steps).energy:
        return start
    state = settle(steps, tolerance)
    for level in range(len(grids) - 2, -1, -1):
        fine = grids[level]
        found = fine.interpolate(state.v)
        maps = found, starts[level] + found - fine.interpolate(starts[level + 1])
        state = min(
            (evaluate(fine, v, lam) for v in maps),
            key=lambda state: state.energy,
        )
        if level > 0:
            state = settle(descend(fine, state, lam), tolerance)
    given = pad_maps(np.nan_to_num(finest.inflow))
    return np.where(pad_maps(np.isnan(finest.inflow)), state.v, given)


def gauss_newton(
    problem: Problem,
    start: FloatArray | None = None,
    inflow: FloatArray | None = None,
    tolerance: float = 1e-2,
    max_iterations: int = 30,
    settled: float = 0.0,
    converged_at: float = np.nan,
    halvings: int = 2,
) -> Solver:
    """Minimise the energy by Gauss-Newton steps; see the head of this file.

    `start` (H, W) is log d to start from, of an earlier result say: then there is no march, and coarser grids
    are used only if it is far from the frame's surface. A grid that is halved so many times, `halvings`,
    tells whether it is: 2 for a start from anywhere, 1 for the surface of a like problem, as of fewer pixels,
    0 for one that is known to be near. `inflow` is log d where it is known, nan elsewhere, and
    is kept. The run has converged when by the last steps no more than `tolerance` times the energy is
    left to fall: their quadratics promise no more, the inner solver left no more of them, and falls at the
    rate of the last ones sum to no more. That is an estimate: where an energy creeps, hundreds of further
    steps find up to 10 % more, rarely a quarter. It ends as SETTLED when of two steps neither changed
    distances by more than a fraction `settled`, r.m.s., though the energy still falls. A start whose
    energy is `converged_at` is where an earlier run ended: it stays, unless one step tells that it has not.
    The run ends as STALLED when no length of a step lowers the energy although more is left. A step costs
    O(pixels).

    With a start, it comes first, and then what coarser grids make of it if it is far. Without one come d₀,
    what each coarse grid makes of the frame, and the march at full size, each if its energy is lower. Then
    one iterate for each step, `max_iterations` in all at most after the first, with the scalars "step" (what
    part of the Gauss-Newton step was taken), "damping" and "inner" (conjugate gradient steps). The energy
    falls from each to the next. ValueError if `start` or `inflow` cannot be used or the BRDF not inverted.
    """
    mask = problem.mask
    check_maps(mask, start, inflow)
    number("tolerance", tolerance, 0)
    number("settled", settled, 0)
    check_int("max_iterations", max_iterations)
    check_int("halvings", halvings)
    lam = problem.lam
    finest = Grid.of(problem, inflow)

    def show(found: Step, previous: Iterate | None = None, **scalars: float) -> Iterate:
        return Iterate.of(
            problem, inner(found.v), previous, terms=found.terms, scalars=scalars
        )

    if start is not None:
        given = start if inflow is None else np.where(np.isnan(inflow), start, inflow)
        v = pad_maps(np.where(mask, given, 0.0))
        state = evaluate(finest, v, lam)
        iterate = show(state)
        yield iterate
        # In another unit of distance energies of one map differ by so much.
        is_same = abs(state.energy - converged_at) <= 1e-9 * state.energy
        if max_iterations > 0 and is_same:
            tried = next(descend(finest, state, lam))
            if has_converged(tried, tolerance):
                return Status.CONVERGED
            if show(tried, iterate).change < settled:
                return Status.SETTLED
        if max_iterations > 0 and halvings > 0:
            v = _adapt_start(finest, v, tolerance, halvings)
            adapted = evaluate(finest, v, lam)
            if adapted.energy < state.energy:
                state = adapted
                iterate = show(state, iterate)
                yield iterate
    else:
        iterate = show(evaluate(finest, pad_maps(finest.log_d0), lam))
        yield iterate
        for state in _starts(_coarsen(finest), tolerance):
            if iterate.k < max_iterations and state.energy < iterate.energy:
                iterate = show(state, iterate)
                yield iterate
    moved = np.inf
    steps = descend(finest, state, lam)
    while iterate.k < max_iterations:
        step = next(steps)
        if step.length == 0:
            return Status.CONVERGED if has_converged(step, tolerance) else Status.STALLED
        if step.energy < iterate.energy:
            taken = {"step": step.length, "damping": step.damping}
            iterate = show(step, iterate, **taken, inner=float(step.inner))
            yield iterate
        if has_converged(step, tolerance):
            return Status.CONVERGED
        if max(moved, iterate.change) < settled:
            return Status.SETTLED
        moved = iterate.change
    return Status.MAX_ITERATIONS


class Look:
    """Follow a surface on few pixels while its energy changes, for a picture that follows a hand.

    v(λ) is about v(λ₀) + P (c(λ) - c(λ₀)), where c is what half as many rows and columns make of the same
    picture, and P leads from there to all pixels: what λ changes is smooth, and what is fine stays. The
    energy that is told is that of c.
    """

    def __init__(self, surface: Iterate, is_minimum: bool = True) -> None:
        """Begin at a surface, which the first look corrects if it is no minimum of its energy."""
        problem = surface.problem
        self._set_grids(problem)
        v = self._fine.restrict(pad_maps(np.where(problem.mask, surface.log_distance, 0.0)))
        self._v = self._coarse.below_ceiling(v)
        if is_minimum:
            begun = evaluate(self._coarse, self._v, problem.lam)
            steps = descend(self._coarse, begun, problem.lam, self._memory)
            self._v = settle(steps, 1e-2).v
        self.start_from(surface)

    def start_from(self, surface: Iterate) -> None:
        """Follow from this surface of the energy that was followed last, at full size, in whatever unit."""
        v = (
            surface.log_distance
            - _log_unit(surface.problem)
            + _log_unit(self._coarse.problem)
        )
        self._fine_start = pad_maps(np.where(surface.problem.mask, v, 0.0))
        self._start = self._v

    def _set_grids(self, problem: Problem) -> None:
        self._fine = Grid.of(problem)
        self._coarse = self._fine.coarser
        self._memory = Memory()

    def follow(self, problem: Problem) -> Iterate:
        """Step towards the surface of the same picture with another energy, and return it at full size.

        With another gain it begins at the same surface in another unit.
        """
        before = self._coarse.problem
        if any(
            getattr(problem, name) != getattr(before, name)
            for name in ("xi", "regulariser", "camera")
        ):
            self._set_grids(problem)
        elif problem.image is not before.image or any(
            getattr(problem, name) != getattr(before, name)
            for name in ("epsilon", "threshold", "photometry")
        ):
            self._coarse = self._fine.coarser_under(problem)
        moved = _log_unit(problem) - _log_unit(before)
        coarse, fine = (moved * pad_maps(one.mask) for one in (self._coarse, self._fine))
        self._v, self._start = self._v + coarse, self._start + coarse
        self._fine_start = self._fine_start + fine
        now = evaluate(self._coarse, self._v, problem.lam)
        found = next(descend(self._coarse, now, problem.lam, self._memory, inner_steps=2))
        self._v = found.v
        v = self._fine_start + self._fine.interpolate(self._v - self._start)
        return Iterate.of(problem, inner(v), terms=found.terms)


def _log_unit(problem: Problem) -> float:
    """log of what distances are in the unit of a problem's gain: they go with its square root."""
    return 0.5 * float(np.log(problem.photometry.gain or 1.0))
