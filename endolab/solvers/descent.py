"""Steps of Gauss-Newton down the energy, from any surface.

Each step replaces both Huber penalties by the parabolas that touch them and the model by its
linearisation, normals included, and solves the quadratic that results by conjugate gradients with a
multigrid preconditioner. A step is halved until the energy falls no further, so the energies of the
iterates fall, always.

All is of v = log d. Where a wall faces the camera, brightness does not change with its slope to first order:
a step may tilt it as it likes, and is good only for a small part of its length. So the equations add a
quadratic penalty on slopes there, as large as the slopes of the last steps were (`Grid.equations_at`); as
steps become short, it vanishes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from endolab.numerics.arrays import FloatArray
from endolab.numerics.compiled import pad_maps
from endolab.solvers.grid import Grid
from endolab.solvers.multigrid import Multigrid, dot
from endolab.solvers.normal_equations import Coefficients
from endolab.solvers.problem import Problem


@dataclass(frozen=True)
class Descent:
    """The constants of the method, chosen by hand; the tests of `gauss_newton` hold what they lead to.

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
    to_come: float = np.inf  # how much the energy may still fall, as the step tells
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
    """Return a map, no higher than the grid's ceiling, with its energy."""
    v = grid.below_ceiling(v)
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
        to_come = promise * (1 + unsolved)
        if now.length > 0:
            last_fall = fall
            fall = before.energy - now.energy
            if not np.isnan(last_fall):
                rate = (rate + min(fall / last_fall, DESCENT.most_rate)) / 2
            further = falls_to_come(fall, rate, promise if now.length == 1 else 0.0)
            to_come = max(to_come, further)
        now = now._replace(to_come=to_come, damping=damping, inner=inner)
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
            tried = evaluate(grid, start.v + length * step, lam)._replace(length=length)
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
    return step.to_come <= tolerance * step.energy + DESCENT.rounding


def falls_to_come(fall: float, rate: float, promise: float) -> float:
    """Return what further falls sum to, each r times the last: fall (r + r² + ...) = fall r/(1 - r).

    r is the rate of the last falls, or larger: a whole step that fell by (1 + q) · promise, q > 0, was solved
    with a quadratic that bends more than the energy, as Huber's parabolas do. Then q of the error
    remains, and q² of the fall.
    """
    if fall > promise > 0:
        rate = max(rate, min(fall / promise - 1, DESCENT.most_rate) ** 2)
    return fall * rate / (1 - rate)


def energy_left(problem: Problem, log_distance: FloatArray) -> float:
    """Share of its energy that one step from a map of v = log d, (H, W), would still remove.

        (E(v) - E(v + s δ)) / E(v)

    0 at a minimum. Where it is large, that much at least is left, and further steps may remove more.
    """
    grid = Grid.of(problem)
    v = pad_maps(np.where(problem.mask, log_distance, 0.0))
    start = Step(v, grid.terms(v, problem.lam))
    step = next(descend(grid, start, problem.lam))
    return (start.energy - step.energy) / max(start.energy, DESCENT.rounding)
