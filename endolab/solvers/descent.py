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

# An energy as small as that of residuals of 1e-12.
LEAST_ENERGY = 1e-24
# Ratio of a fall of the energy to the one before, as is believed at most.
MOST_RATE = 0.95


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
    """What a step hands on to the next one.

    Damping is added to the diagonal, as a fraction of what the data put there without slant. It grows
    fourfold with every step of which less than half lowered the energy, to 1 at least, and falls so with a
    whole one. Cut surfaces need it: what hangs together by little is to move far otherwise.
    """

    damping: float = 1e-3
    slants: FloatArray | None = None  # tan² of a likely step: its last ones' geometric mean
    coefficients: Coefficients | None = (
        None  # whose room is used again, as is the multigrid's
    )
    multigrid: Multigrid | None = None

    def learn(self, step: Step, slants: FloatArray, coefficients: Coefficients) -> None:
        """Take over from a step; of what was solved, tan² of the slope is `slants`."""
        self.coefficients = coefficients
        self.damping = step.damping
        if step.length < 0.5:
            self.damping = float(np.clip(4 * step.damping, 1.0, 1e3))
        elif step.length == 1:
            self.damping = max(step.damping / 4, Memory.damping)
        if step.length > 0:
            if self.slants is not None:
                slants = np.sqrt(slants * self.slants)
            self.slants = slants * (0.25 if step.length == 1 else 1.0)


def evaluate(grid: Grid, v: FloatArray, lam: float) -> Step:
    """Return a map, no higher than the grid's ceiling, with its energy."""
    v = grid.below_ceiling(v)
    return Step(v, grid.terms(v, lam))


def descend(
    grid: Grid,
    now: Step,
    lam: float,
    memory: Memory | None = None,
    inner_steps: int = 20,
) -> Iterator[Step]:
    """Gauss-Newton steps from a map on, none of which raises the energy, without end.

    Of each, the equations of `normal_equations` are solved for δ, v goes to v + s δ, and what is still to be
    gained is told: the quadratic's promise ½ bᵀδ, or what falls at the rate of the last ones sum to.
    Conjugate gradients take `inner_steps` at most.
    """
    memory = memory or Memory()
    fall = np.nan
    rate = 0.65  # as is believed at first
    while True:
        before = now
        coefficients, b = grid.equations_at(
            before.v, lam, memory.slants, memory.coefficients
        )
        # A step of which no length lowers the energy is solved once more, held back by more damping.
        for damping in (memory.damping, max(10 * memory.damping, 1.0)):
            multigrid = Multigrid(coefficients, damping, memory.multigrid)
            delta, inner, unsolved = multigrid.solve(b, 0.15, inner_steps)
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
                rate = (rate + min(fall / last_fall, MOST_RATE)) / 2
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
    most = 0.5  # of log d that a pixel moves: a factor of 1.65 in distance
    steps = [np.clip(delta, -most, most)]
    if longest > most:
        steps.append(delta * (most / longest))
    for step in steps:
        lowest = start._replace(length=0.0)
        length = 1.0
        while length >= 2.0**-6:
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
    return step.to_come <= tolerance * step.energy + LEAST_ENERGY


def falls_to_come(fall: float, rate: float, promise: float) -> float:
    """Return what further falls sum to, each r times the last: fall (r + r² + ...) = fall r/(1 - r).

    r is the rate of the last falls, or larger: a whole step that fell by (1 + q) · promise, q > 0, was solved
    with a quadratic that bends more than the energy, as Huber's parabolas do. Then q of the error
    remains, and q² of the fall.
    """
    if fall > promise > 0:
        rate = max(rate, min(fall / promise - 1, MOST_RATE) ** 2)
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
    return (start.energy - step.energy) / max(start.energy, LEAST_ENERGY)
