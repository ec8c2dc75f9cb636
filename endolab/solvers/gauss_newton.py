"""Gauss-Newton on the energy: the default solver.

Each step replaces both Huber penalties by the parabolas that touch them and the model by its
linearisation, normals included, and solves the quadratic that results by conjugate gradients with a
multigrid preconditioner. A step is halved until the energy falls no further, so the energies of the
iterates fall, always.

All is of v = log d. Where a wall faces the camera, brightness does not change with its slope to first order:
a step may tilt it as it likes, and is good only for a small share of its length. So the equations add a
quadratic penalty on slopes there, as large as the slopes of the last steps were (`Grid.equations_at`); as
steps become short, it vanishes.

A fast march (`fast_marching`: one pass from the nearest points outwards) explains the frame, but takes the
surface to face the camera where it enters the picture, at the border and behind contours. The true values
there are whatever makes the surface smoothest, and what is smooth is seen on a coarse grid as well as on a
fine one. So the frame is solved on ever finer grids: on the coarsest λ falls to its value from ten times
that; every finer one marches from the values that the coarser one found where the march enters (or takes
over the coarser map, if that has the lower energy), and takes a few steps. What is left for the frame's own
pixels is to be done in two or three.

A start is taken as it is if it is near, as after a small change of λ. If it is not, as in a video
whose camera moves, a grid of fewer pixels tells at little cost, and the finer ones take up what it
finds: the whole map, or its change alone, whichever has the lower energy.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace
from typing import Any

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

    Damping is added to the diagonal, as a share of what the data put there without slant. It grows by
    `damping_factor` with every step of which less than half lowered the energy, and falls by it with a whole
    one. Cut surfaces need it: what hangs together by little is to move far otherwise.
    """

    # log d that a pixel moves in a step, at most: a factor of 1.65 in distance.
    longest_step: float = 0.5
    shortest_share: float = 2.0**-6  # of a step, below which the search along it gives up
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
    # Of a look: how near its first surface comes to where it ends; its steps afterwards, and those of
    # conjugate gradients in each.
    look_tolerance: float = 1e-2
    look_steps: int = 1
    look_inner_steps: int = 2
    # Share by which energies of one map differ, once distances were in another unit.
    same_energy: float = 1e-9


DESCENT = Descent()


@dataclass(frozen=True)
class _State:
    """A map on a grid, its energy, and how the last step came there."""

    grid: Grid
    v: FloatArray
    lam: float
    terms: dict[str, float]
    share: float = 1.0  # of the last step that was taken; 0 if no share lowered the energy
    left: float = np.inf  # how much the energy may still fall, as the last step tells
    fall: float = np.nan  # of the energy, by the last step
    rate: float = DESCENT.first_rate  # ratio of a fall to the one before, lately
    steps: int = 0  # of the inner solver
    damping: float = DESCENT.least_damping
    slants: FloatArray | None = None  # tan² of a likely step: its last ones' geometric mean
    coefficients: Coefficients | None = None  # of the last step, as is the multigrid
    multigrid: Multigrid | None = None

    @classmethod
    def at(cls, grid: Grid, v: FloatArray, lam: float) -> _State:
        """Return the state at a map, no higher than the grid's ceiling."""
        return cls.without_ceiling(
            grid, np.minimum(v, grid.ceiling) if grid.is_cut else v, lam
        )

    @classmethod
    def without_ceiling(cls, grid: Grid, v: FloatArray, lam: float) -> _State:
        return cls(grid, v, lam, grid.terms(v, lam))

    def at_weight(self, lam: float) -> _State:
        """Return the same map under another weight of the regulariser; room for equations is kept."""
        return replace(self, lam=lam, terms=self.grid.terms(self.v, lam), fall=np.nan)

    @property
    def energy(self) -> float:
        return sum(self.terms.values())

    def iterate(self, previous: Iterate | None = None, **shown: Any) -> Iterate:
        """Return what observers see of it, after a previous iterate."""
        v = inner(self.v)
        return Iterate.of(self.grid.problem, v, previous, terms=self.terms, **shown)

    @property
    def next_damping(self) -> float:
        factor = DESCENT.damping_factor
        if self.share < 0.5:
            raised = max(factor * self.damping, DESCENT.raised_damping)
            return min(raised, DESCENT.most_damping)
        if self.share < 1:
            return self.damping
        return max(self.damping / factor, DESCENT.least_damping)

    def has_converged(self, tolerance: float) -> bool:
        return self.left <= tolerance * self.energy + DESCENT.rounding

    def take_step(self, inner_steps: int = DESCENT.inner_steps) -> _State:
        """Take one Gauss-Newton step, halved until the energy falls no further."""
        coefficients, descent = self.grid.equations_at(
            self.v, self.lam, self.slants, self.coefficients
        )
        multigrid = self.multigrid
        retried_damping = max(10 * self.next_damping, DESCENT.raised_damping)
        for damping in (self.next_damping, retried_damping):
            multigrid = Multigrid(coefficients, damping, multigrid)
            delta, steps, unsolved = multigrid.solve(
                descent, DESCENT.inner_precision, inner_steps
            )
            promise = max(0.5 * dot(descent, delta) / self.grid.count, 0.0)
            slants = self.grid.slants(delta)
            lowest = self._along(delta, promise)
            longest = float(np.abs(delta).max())
            # Cut off at its longest, it was another step.
            if lowest is self and longest > DESCENT.longest_step:
                lowest = self._along(delta * (DESCENT.longest_step / longest), promise)
            if lowest is not self:
                break
        room: dict[str, Any] = {"coefficients": coefficients, "multigrid": multigrid}
        room |= {"steps": steps, "damping": damping}
        left = promise * (1 + unsolved)
        if lowest is self:
            return replace(self, share=0.0, left=left, fall=0.0, rate=1.0, **room)
        if self.slants is not None:
            slants = np.sqrt(slants * self.slants)
        if lowest.share == 1:
            slants *= DESCENT.slope_relief
        fall = self.energy - lowest.energy
        rate = self.rate
        if not np.isnan(self.fall):
            rate = (self.rate + min(fall / self.fall, DESCENT.most_rate)) / 2
        left = max(left, _falls_to_come(fall, rate, promise if lowest.share == 1 else 0.0))
        return replace(lowest, left=left, fall=fall, rate=rate, slants=slants, **room)

    def _along(self, delta: FloatArray, promise: float) -> _State:
        """Go the share of a step that lowers the energy most, of 1, 1/2, 1/4, ...; nowhere if none does.

        Half a step promises 3/4 of what the whole one does: no need to try it where the whole gave more.
        """
        lowest = self
        share = 1.0
        longest = DESCENT.longest_step
        step = np.clip(delta, -longest, longest)
        while share >= DESCENT.shortest_share:
            moved = self.v + share * step
            if self.grid.is_cut:
                np.minimum(moved, self.grid.ceiling, out=moved)
            terms = self.grid.terms(moved, self.lam)
            tried = replace(self, v=moved, terms=terms, share=share)
            if tried.energy < lowest.energy:
                lowest = tried
            elif lowest is not self:
                break
            if self.energy - lowest.energy > 0.75 * promise:
                break
            share /= 2
        return lowest

    def descend(self, tolerance: float) -> _State:
        """Take up to `Descent.coarse_steps` steps."""
        state = self
        for _ in range(DESCENT.coarse_steps):
            state = state.take_step()
            if state.share == 0 or state.has_converged(tolerance):
                break
        return state


def _falls_to_come(fall: float, rate: float, promise: float) -> float:
    """Return what further falls sum to, each a share r of the last: fall (r + r² + ...) = fall r/(1 - r).

    r is the rate of the last falls, or larger: a whole step that fell by (1 + q) · promise, q > 0, was solved
    with a quadratic that bends more than the energy, as Huber's parabolas do. Then a share q of the error
    remains, and q² of the fall.
    """
    if fall > promise > 0:
        rate = max(rate, min(fall / promise - 1, DESCENT.most_rate) ** 2)
    return fall * rate / (1 - rate)


def _begin_march(
    grid: Grid, guess: FloatArray | None, lam: float, march: bool
) -> tuple[_State, bool]:
    """March with the guess's values where it enters, or the guess itself if its energy is less.

    The march is sharper, and right on smooth walls; over folds that hide something it is rough, and
    so it is in noise, the more so the finer the grid: once it has lost there is no need to `march`
    on finer ones. The first march crosses cuts: what lies behind them then comes loose only as far as the
    energy wants, while regions that are held by little would stay where a cut march puts them.
    """
    if guess is None:
        return _State.at(grid, replace(grid, link=grid.uncut_links).march(), lam), True
    given = _State.at(grid, guess, lam)
    if march:
        marched = _State.at(grid, grid.march(guess), lam)
        if marched.energy <= given.energy:
            return marched, True
    return given, False


def _guesses(
    grids: list[Grid], tolerance: float
) -> Generator[tuple[FloatArray, bool], None, None]:
    """Maps at full size, as found on ever finer grids but the finest, and whether to march there."""
    lam = grids[0].problem.lam
    guess = None
    march = True
    for level in range(len(grids) - 1, 0, -1):
        state, march = _begin_march(grids[level], guess, lam, march)
        v = state.v
        for factor in DESCENT.continuation if guess is None else (1.0,):
            v = _State.at(grids[level], v, factor * lam).descend(tolerance).v
        shown = guess = grids[level - 1].interpolate(v)
        for coarse in range(level - 1, 0, -1):
            shown = grids[coarse - 1].interpolate(shown)
        yield shown, march


def _coarsen(grid: Grid, most: float = np.inf) -> list[Grid]:
    """Return the grid and `most` coarser ones, each of half the rows and columns of the one before."""
    grids = [grid]
    while len(grids) <= most and min(grids[-1].mask.shape) >= 2 * DESCENT.least_size:
        grids.append(grids[-1].coarser)
    return grids


def _adapt_start(
    finest: Grid, start: FloatArray, tolerance: float, halvings: int
) -> FloatArray:
    """Return the start if it is near, or what ever finer grids make of it."""
    lam = finest.problem.lam
    grids = _coarsen(finest, halvings)
    starts = [start]
    if len(grids) == 1:
        return start
    for grid in grids[:-1]:
        starts.append(grid.restrict(starts[-1]))
    begun = _State.at(grids[-1], starts[-1], lam)
    state = begun.take_step()
    if begun.energy <= DESCENT.start_excess * state.energy:
        return start
    state = state.descend(tolerance)
    for level in range(len(grids) - 2, -1, -1):
        fine = grids[level]
        change = fine.interpolate(state.v - starts[level + 1])
        maps = fine.interpolate(state.v), starts[level] + change
        state = min((_State.at(fine, v, lam) for v in maps), key=lambda state: state.energy)
        if level > 0:
            state = state.descend(tolerance)
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
    is kept. The run has converged when by the last steps no more than the share `tolerance` of the energy is
    left to fall: their quadratics promise no more, the inner solver left no more of them, and falls at the
    rate of the last ones sum to no more. That is an estimate: where an energy creeps, hundreds of further
    steps find up to 10 % more, rarely a quarter. It ends as SETTLED when of two steps neither changed
    distances by more than the share `settled`, root mean square, though the energy still falls. A start whose
    energy is `converged_at` is where an earlier run ended: it stays, unless one step tells that it has not.
    The run ends as STALLED when no share of a step lowers the energy although more is left. A step costs
    O(pixels).

    With a start, it comes first, and then what coarser grids make of it if it is far. Without one come d₀,
    what each coarse grid makes of the frame, and the march at full size, each if its energy is lower. Then
    one iterate for each step, `max_iterations` in all at most after the first, with the scalars "step" (share
    of the Gauss-Newton step that was taken), "damping" and "inner" (conjugate gradient steps). The energy
    falls from each to the next. ValueError if `start` or `inflow` cannot be used or the BRDF not inverted.
    """
    mask = problem.mask
    check_maps(mask, start, inflow)
    number("tolerance", tolerance, 0)
    number("settled", settled, 0)
    check_int("max_iterations", max_iterations)
    check_int("halvings", halvings)
    finest = Grid.of(problem, inflow)
    if start is not None:
        given = start if inflow is None else np.where(np.isnan(inflow), start, inflow)
        v = pad_maps(np.where(mask, given, 0.0))
        state = _State.at(finest, v, problem.lam)
        iterate = state.iterate()
        yield iterate
        difference = abs(state.energy - converged_at)
        if max_iterations > 0 and difference <= DESCENT.same_energy * state.energy:
            tried = state.take_step()
            if tried.has_converged(tolerance):
                return Status.CONVERGED
            if tried.iterate(iterate).change < settled:
                return Status.SETTLED
        if max_iterations > 0 and halvings > 0:
            found = _adapt_start(finest, v, tolerance, halvings)
            adapted = _State.at(finest, found, problem.lam)
            if adapted.energy < state.energy:
                state = adapted
                iterate = state.iterate(iterate)
                yield iterate
    else:
        v = pad_maps(np.where(mask, problem.log_d0, 0.0))
        iterate = _State.without_ceiling(finest, v, problem.lam).iterate()
        yield iterate
        guess = None
        march = True
        for guess, is_best in _guesses(_coarsen(finest), tolerance):
            march = is_best
            shown = _State.without_ceiling(finest, guess, problem.lam)
            if iterate.k < max_iterations and shown.energy < iterate.energy:
                iterate = shown.iterate(iterate)
                yield iterate
        state, _ = _begin_march(finest, guess, problem.lam, march)
        if iterate.k < max_iterations and state.energy < iterate.energy:
            iterate = state.iterate(iterate)
            yield iterate
    moved = np.inf
    while iterate.k < max_iterations:
        state = state.take_step()
        if state.share == 0:
            return Status.CONVERGED if state.has_converged(tolerance) else Status.STALLED
        if state.energy < iterate.energy:
            scalars = {
                "step": state.share,
                "damping": state.damping,
                "inner": float(state.steps),
            }
            iterate = state.iterate(iterate, scalars=scalars)
            yield iterate
        if state.has_converged(tolerance):
            return Status.CONVERGED
        if max(moved, iterate.change) < settled:
            return Status.SETTLED
        moved = iterate.change
    return Status.MAX_ITERATIONS


class Look:
    """Follow a surface on few pixels while its energy changes, for a picture that follows a hand.

    v(λ) is about v(λ₀) + P (c(λ) - c(λ₀)), where c is what half as many rows and columns make of the same
    picture, and P leads from there to all pixels: what λ changes is smooth, and what is fine stays.
    """

    def __init__(self, surface: Iterate) -> None:
        problem = surface.problem
        self._set_grids(problem)
        start = pad_maps(np.where(problem.mask, surface.log_distance, 0.0))
        if self._coarse is not self._fine:
            start = self._fine.restrict(start)
        begun = _State.at(self._coarse, start, problem.lam)
        self._state = begun.descend(DESCENT.look_tolerance)
        self.start_from(surface)

    def start_from(self, surface: Iterate) -> None:
        """Follow from this surface of the energy that was followed last, at full size."""
        self._fine_start = pad_maps(
            np.where(surface.problem.mask, surface.log_distance, 0.0)
        )
        self._start = self._state.v

    def _set_grids(self, problem: Problem) -> None:
        self._problem = problem
        grids = _coarsen(Grid.of(problem), 1)
        self._fine = grids[0]
        self._coarse = grids[-1]

    def follow(self, problem: Problem) -> Iterate:
        """Step towards the surface of the same picture with another energy, and return it at full size."""
        names = ("xi", "regulariser", "epsilon", "threshold")
        if any(getattr(problem, name) != getattr(self._problem, name) for name in names):
            self._set_grids(problem)
            self._state = _State.at(self._coarse, self._state.v, problem.lam)
        state = self._state.at_weight(problem.lam)
        for _ in range(DESCENT.look_steps):
            state = state.take_step(DESCENT.look_inner_steps)
        self._state = state
        change = state.v - self._start
        if self._coarse is not self._fine:
            change = self._fine.interpolate(change)
        v = self._fine_start + change
        return Iterate.of(problem, inner(v), terms=self._fine.terms(v, problem.lam))
