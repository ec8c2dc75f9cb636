"""Gauss-Newton on the energy: the default solver.

Each step replaces both Huber penalties by the parabolas that touch them and the model by its
linearisation, normals included, and solves the quadratic that results by conjugate gradients with a
multigrid preconditioner. A step is halved until the energy falls no further, so the energies of the
iterates fall, always.

All is of v = log d. Where a wall faces the camera, brightness does not change with its slope to first order:
a step may tilt it as it likes, and is good only for a small part of its length. So the equations add a
quadratic penalty on slopes there, as large as the slopes of the last steps were (`Grid.equations_at`); as
steps become short, it vanishes.

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
from dataclasses import dataclass, replace
from itertools import islice
from typing import NamedTuple

import numpy as np

from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import check_int, number
from endolab.numerics.compiled import inner, pad_maps
from endolab.numerics.iteration import Status
from endolab.solvers.grid import Grid
from endolab.solvers.multigrid import Multigrid, dot
from endolab.solvers.normal_equations import Coefficients
from endolab.solvers.problem import Problem, check_maps
from endolab.solvers.result import Iterate, Solver


@dataclass(frozen=True)
class Descent:
    """The constants of the method, chosen by hand; the tests of this module hold what they lead to.

    Damping is added to the diagonal, as a fraction of what the data put there without slant. It grows by
    `damping_factor` with every step of which less than half lowered the energy, and falls by it with a whole
    one. Cut surfaces need it: what hangs together by little is to move far otherwise.
    """

    # log d that a pixel moves in a step, at most: a factor of 1.65 in distance.
    longest_step: float = 0.5
    shortest_length: float = 2.0**-6  # of a step, below which the search along it gives up
    slope_relief: float = 0.25  # what remains of the damping of slopes after a whole step
    rounding: float = 1e-24  # an energy as small as that of residuals of 1e-12
    least_damping: float = 1e-3
    raised_damping: float = 1.0  # the least after less than half of a step
    most_damping: float = 1e3
    damping_factor: float = 4.0
    inner_precision: float = 0.15  # residual that conjugate gradients leave
    inner_steps: int = 20  # of conjugate gradients, at most
    # Ratio of a fall of the energy to the one before: as is believed at first, and at most.
    first_rate: float = 0.65
    most_rate: float = 0.95
    least_size: int = 24  # rows and columns of the coarsest grid
    # Multiples of λ on the coarsest grid, one after the other.
    continuation: tuple[float, ...] = (10.0, 3.0, 1.0)
    coarse_steps: int = 4  # on each of the coarser grids
    # How often the grid is halved to see whether a start is near: one that may be from anywhere, and the
    # surface of a like problem, as of fewer pixels. It is near if its energy there is no more than
    # `start_excess` times the energy after one step.
    start_halvings: int = 2
    like_halvings: int = 1
    start_excess: float = 1.2
    # Of a look: how near its first surface comes to where it ends, and steps of conjugate gradients in each
    # of its own afterwards.
    look_tolerance: float = 1e-2
    look_inner_steps: int = 2
    # By what fraction energies of one map differ, once distances were in another unit.
    same_energy: float = 1e-9


DESCENT = Descent()


class Step(NamedTuple):
    """A map on a grid, padded, its energy, and how a step came there."""

    v: FloatArray
    terms: dict[str, float]
    length: float = 1.0  # of the step that was taken; 0 if no length lowered the energy
    left: float = np.inf  # how much the energy may still fall, as the step tells
    damping: float = np.nan
    inner: int = 0  # steps of the inner solver

    @property
    def energy(self) -> float:
        """Sum of the terms."""
        return sum(self.terms.values())


@dataclass(eq=False)
class Memory:
    """What a step hands on to the next one."""

    damping: float = DESCENT.least_damping
    slants: FloatArray | None = None  # tan² of a likely step: its last ones' geometric mean
    coefficients: Coefficients | None = (
        None  # whose room is used again, as is the multigrid's
    )
    multigrid: Multigrid | None = None

    def learn(self, step: Step, slants: FloatArray, coefficients: Coefficients) -> None:
        """Take over from a step; of what was solved, tan² of the slope is `slants`."""
        self.coefficients = coefficients
        self.damping = step.damping
        factor = DESCENT.damping_factor
        if step.length < 0.5:
            raised = max(factor * step.damping, DESCENT.raised_damping)
            self.damping = min(raised, DESCENT.most_damping)
        elif step.length == 1:
            self.damping = max(step.damping / factor, DESCENT.least_damping)
        if step.length > 0:
            if self.slants is not None:
                slants = np.sqrt(slants * self.slants)
            self.slants = slants * (DESCENT.slope_relief if step.length == 1 else 1.0)


def evaluate(grid: Grid, v: FloatArray, lam: float) -> Step:
    """Return a map with its energy."""
    return Step(v, grid.terms(v, lam))


def descend(
    grid: Grid,
    now: Step,
    lam: float,
    memory: Memory | None = None,
    inner_steps: int = DESCENT.inner_steps,
) -> Iterator[Step]:
    """Gauss-Newton steps from a map on, none of which raises the energy, without end.

    Of each, the equations of `normal_equations` are solved for δ, v goes to v + s δ, and what is still to be
    gained is told: the quadratic's promise ½ bᵀδ, or what falls at the rate of the last ones sum to.
    """
    memory = memory or Memory()
    fall = np.nan
    rate = DESCENT.first_rate
    while True:
        before = now
        coefficients, b = grid.equations_at(
            before.v, lam, memory.slants, memory.coefficients
        )
        # A step of which no length lowers the energy is solved once more, held back by more damping.
        for damping in (memory.damping, max(10 * memory.damping, DESCENT.raised_damping)):
            multigrid = Multigrid(coefficients, damping, memory.multigrid)
            delta, inner, unsolved = multigrid.solve(
                b, DESCENT.inner_precision, inner_steps
            )
            promise = max(0.5 * dot(b, delta) / grid.count, 0.0)
            now = line_search(grid, before, lam, delta, promise)
            memory.multigrid = multigrid
            if now.length > 0:
                break
        left = promise * (1 + unsolved)
        if now.length > 0:
            last_fall = fall
            fall = before.energy - now.energy
            if not np.isnan(last_fall):
                rate = (rate + min(fall / last_fall, DESCENT.most_rate)) / 2
            left = max(left, falls_to_come(fall, rate, promise if now.length == 1 else 0.0))
        now = now._replace(left=left, damping=damping, inner=inner)
        memory.learn(now, grid.slants(delta), coefficients)
        yield now


def line_search(
    grid: Grid, start: Step, lam: float, delta: FloatArray, promise: float
) -> Step:
    """Go the length of a step that lowers the energy most, of 1, 1/2, 1/4, ...; nowhere if none does.

    Half a step promises 3/4 of what the whole one does: no need to try it where the whole gave more.
    A step that is cut off at the longest is another one: where it fails, all of it is shortened.
    """
    longest = float(np.abs(delta).max())
    steps = [np.clip(delta, -DESCENT.longest_step, DESCENT.longest_step)]
    if longest > DESCENT.longest_step:
        steps.append(delta * (DESCENT.longest_step / longest))
    for step in steps:
        lowest = start._replace(length=0.0)
        length = 1.0
        while length >= DESCENT.shortest_length:
            v = grid.below_ceiling(start.v + length * step)
            tried = Step(v, grid.terms(v, lam), length)
            if tried.energy < lowest.energy:
                lowest = tried
            elif lowest.length > 0:
                break
            if start.energy - lowest.energy > 0.75 * promise:
                break
            length /= 2
        if lowest.length > 0:
            break
    return lowest


def has_converged(step: Step, tolerance: float) -> bool:
    """Whether no more than this fraction of the energy is left to fall."""
    return step.left <= tolerance * step.energy + DESCENT.rounding


def falls_to_come(fall: float, rate: float, promise: float) -> float:
    """Return what further falls sum to, each r times the last: fall (r + r² + ...) = fall r/(1 - r).

    r is the rate of the last falls, or larger: a whole step that fell by (1 + q) · promise, q > 0, was solved
    with a quadratic that bends more than the energy, as Huber's parabolas do. Then q of the error
    remains, and q² of the fall.
    """
    if fall > promise > 0:
        rate = max(rate, min(fall / promise - 1, DESCENT.most_rate) ** 2)
    return fall * rate / (1 - rate)


def settle(steps: Iterator[Step], tolerance: float) -> Step:
    """Take up to `Descent.coarse_steps` steps."""
    for step in islice(steps, DESCENT.coarse_steps):
        if step.length == 0 or has_converged(step, tolerance):
            break
    return step


def _coarsen(grid: Grid, most: float = np.inf) -> list[Grid]:
    """Return the grid and `most` coarser ones, each of half the rows and columns of the one before."""
    grids = [grid]
    while len(grids) <= most and min(grids[-1].mask.shape) >= 2 * DESCENT.least_size:
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
    v = coarsest.below_ceiling(replace(coarsest, link=coarsest.uncut_links).march())
    marches = True
    for level in range(len(grids) - 1, -1, -1):
        grid = grids[level]
        state = evaluate(grid, grid.below_ceiling(v), lam)
        if marches and grid is not coarsest:
            marched = evaluate(grid, grid.below_ceiling(grid.march(v)), lam)
            marches = marched.energy <= state.energy
            state = marched if marches else state
        if level == 0:
            yield state
            return
        for factor in DESCENT.continuation if grid is coarsest else (1.0,):
            start = evaluate(grid, grid.below_ceiling(state.v), factor * lam)
            state = settle(descend(grid, start, factor * lam), tolerance)
        v = shown = grids[level - 1].interpolate(state.v)
        for fine in reversed(grids[: level - 1]):
            shown = fine.interpolate(shown)
        yield evaluate(grids[0], shown, lam)


def _adapt_start(
    finest: Grid, start: FloatArray, tolerance: float, halvings: int
) -> FloatArray:
    """Return the start if it is near, or what ever finer grids make of it."""
    lam = finest.problem.lam
    grids = _coarsen(finest, halvings)
    if len(grids) == 1:
        return start
    starts = [start]
    for grid in grids[:-1]:
        starts.append(grid.restrict(starts[-1]))
    coarsest = grids[-1]
    begun = evaluate(coarsest, coarsest.below_ceiling(starts[-1]), lam)
    steps = descend(coarsest, begun, lam)
    if begun.energy <= DESCENT.start_excess * next(steps).energy:
        return start
    state = settle(steps, tolerance)
    for level in range(len(grids) - 2, -1, -1):
        fine = grids[level]
        change = fine.interpolate(state.v - starts[level + 1])
        maps = fine.interpolate(state.v), starts[level] + change
        state = min(
            (evaluate(fine, fine.below_ceiling(v), lam) for v in maps),
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
    halvings: int = DESCENT.start_halvings,
) -> Solver:
    """Minimise the energy by Gauss-Newton steps; see the head of this file.

    `start` (H, W) is log d to start from, of an earlier result say: then there is no march, and coarser grids
    are used only if it is far from the frame's surface. A grid that is halved so many times, `halvings`,
    tells whether it is; 0 if it is known to be near. `inflow` is log d where it is known, nan elsewhere, and
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
        state = evaluate(finest, finest.below_ceiling(v), lam)
        iterate = show(state)
        yield iterate
        difference = abs(state.energy - converged_at)
        if max_iterations > 0 and difference <= DESCENT.same_energy * state.energy:
            tried = next(descend(finest, state, lam))
            if has_converged(tried, tolerance):
                return Status.CONVERGED
            if show(tried, iterate).change < settled:
                return Status.SETTLED
        if max_iterations > 0 and halvings > 0:
            v = finest.below_ceiling(_adapt_start(finest, v, tolerance, halvings))
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

    def __init__(self, surface: Iterate) -> None:
        problem = surface.problem
        self._set_grids(problem)
        v = self._fine.restrict(pad_maps(np.where(problem.mask, surface.log_distance, 0.0)))
        begun = evaluate(self._coarse, self._coarse.below_ceiling(v), problem.lam)
        steps = descend(self._coarse, begun, problem.lam, self._memory)
        self._v = settle(steps, DESCENT.look_tolerance).v
        self.start_from(surface)

    def start_from(self, surface: Iterate) -> None:
        """Follow from this surface of the energy that was followed last, at full size."""
        self._fine_start = pad_maps(
            np.where(surface.problem.mask, surface.log_distance, 0.0)
        )
        self._start = self._v

    def _set_grids(self, problem: Problem) -> None:
        self._fine = Grid.of(problem)
        self._coarse = self._fine.coarser
        self._memory = Memory()

    def follow(self, problem: Problem) -> Iterate:
        """Step towards the surface of the same picture with another energy, and return it at full size."""
        before = self._coarse.problem
        if any(
            getattr(problem, name) != getattr(before, name)
            for name in ("xi", "regulariser", "camera")
        ):
            self._set_grids(problem)
        elif any(
            getattr(problem, name) != getattr(before, name)
            for name in ("epsilon", "threshold", "photometry")
        ):
            self._coarse = self._fine.coarser_under(problem)
        now = evaluate(self._coarse, self._coarse.below_ceiling(self._v), problem.lam)
        steps = descend(
            self._coarse, now, problem.lam, self._memory, DESCENT.look_inner_steps
        )
        found = next(steps)
        self._v = found.v
        v = self._fine_start + self._fine.interpolate(self._v - self._start)
        return Iterate.of(problem, inner(v), terms=found.terms)
