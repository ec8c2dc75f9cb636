"""How a surface answers to small changes: the Gauss-Newton model of the energy, at the estimate.

With J the model's derivatives by v = log d, W the data's weights and R the regulariser's parabolas,

    H = Jᵀ W J + R,        x = H⁻¹ Jᵀ W δI

is what becomes of v if the picture changes by δI.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from endolab.numerics.arrays import FloatArray
from endolab.numerics.compiled import inner, pad_maps
from endolab.numerics.derivatives import shift
from endolab.solvers.energy import model_image
from endolab.solvers.grid import Grid
from endolab.solvers.multigrid import Multigrid
from endolab.solvers.normal_equations import Coefficients
from endolab.solvers.problem import Problem


@dataclass(frozen=True)
class LinearSolve:
    """How well H x = b is solved."""

    precision: float = 3e-2  # residual left, a tenth of what draws scatter by
    most_steps: int = 15
    # Share of the data's diagonal that is added to H, for pixels that nothing holds.
    damping: float = 1e-3


LINEAR_SOLVE = LinearSolve()


@dataclass(frozen=True)
class Linearised:
    """The model at a map v = log d of a problem; maps are (H, W), 0 outside the mask."""

    grid: Grid
    coefficients: Coefficients
    multigrid: Multigrid
    model: FloatArray  # I of the surface
    residual: FloatArray  # of it and the picture

    @classmethod
    def at(cls, problem: Problem, log_distance: FloatArray) -> Linearised:
        """Linearise at log d (H, W)."""
        mask = problem.mask
        v = np.where(mask, log_distance, 0.0)
        grid = Grid.of(problem)
        coefficients, _ = grid.equations_at(pad_maps(v), problem.lam)
        # Pixels that the solver holds beneath their ceiling are as free to be wrong as others.
        coefficients = Coefficients(coefficients.parts, grid.structure(grid.free))
        model = np.where(mask, model_image(problem, v), 0.0)
        residual = np.where(mask, model - problem.image, 0.0)
        return cls(
            grid,
            coefficients,
            Multigrid(coefficients, LINEAR_SOLVE.damping),
            model,
            residual,
        )

    @property
    def problem(self) -> Problem:
        """The problem."""
        return self.grid.problem

    @property
    def weight(self) -> FloatArray:
        """W; 0 where the picture says nothing."""
        return inner(self.coefficients.weight)

    # J --------------------------------------------------------------------------------

    def _sides(self) -> tuple[FloatArray, ...]:
        """Whether there is a step to the right, left, below and above."""
        across, down = inner(self.grid.link).astype(np.float64)
        return across, shift(across, -1, 1, 0.0), down, shift(down, -1, 0, 0.0)

    def _by_slopes(self) -> tuple[FloatArray, FloatArray]:
        """b of J, by the sums of the differences to both sides."""
        right, left, below, above = self._sides()
        root = inner(self.coefficients.by_v_u) * (1 - 0.5 * right * left)
        return root, inner(self.coefficients.by_v_v) * (1 - 0.5 * below * above)

    def apply(self, x: FloatArray) -> FloatArray:
        """J x: how the picture changes with v."""
        right, left, below, above = self._sides()
        by_u, by_w = self._by_slopes()
        along_u = right * (shift(x, 1, 1, 0.0) - x) + left * (x - shift(x, -1, 1, 0.0))
        along_w = below * (shift(x, 1, 0, 0.0) - x) + above * (x - shift(x, -1, 0, 0.0))
        return inner(self.coefficients.by_v) * x + by_u * along_u + by_w * along_w

    def adjoint(self, f: FloatArray) -> FloatArray:
        """Jᵀ f."""
        right, left, below, above = self._sides()
        by_u, by_w = (factor * f for factor in self._by_slopes())
        out = (
            inner(self.coefficients.by_v) * f
            + by_u * (left - right)
            + by_w * (above - below)
        )
        out += shift(by_u * right, -1, 1, 0.0) - shift(by_u * left, 1, 1, 0.0)
        return out + shift(by_w * below, -1, 0, 0.0) - shift(by_w * above, 1, 0, 0.0)

    # H⁻¹ ------------------------------------------------------------------------------

    def solve(self, b: FloatArray) -> FloatArray:
        """H⁻¹ b."""
        x = self.multigrid.solve(
            pad_maps(np.where(self.problem.mask, b, 0.0)),
            LINEAR_SOLVE.precision,
            LINEAR_SOLVE.most_steps,
        )[0]
        return inner(x).astype(np.float64)

    def to_picture(self, change: FloatArray) -> FloatArray:
        """How v answers to a change of the picture, of stored values."""
        return self.solve(self.adjoint(self.weight * change))

    def to_light(self, change: FloatArray) -> FloatArray:
        """How v answers to light that is brighter by this share, a change of its logarithm.

        What is common to all pixels moves all of them alike, as ξ̃ goes with it.
        """
        common = float(np.median(change[self.problem.mask]))
        per_share = self.model / self.problem.photometry.gamma
        return (
            self.to_picture(per_share * (change - common))
            - 0.5 * common * self.problem.mask
        )
