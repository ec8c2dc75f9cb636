"""How a surface answers to small changes: the Gauss-Newton model of the energy, at the estimate.

With J the model's derivatives by v = log d, W the data's weights and R the regulariser's parabolas,

    H = Jᵀ W J + R,        x = H⁻¹ Jᵀ W δI

is what becomes of v if the picture changes by δI.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

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
    def by_light(self) -> FloatArray:
        """Change of I per change of the light's logarithm."""
        return self.model / self.problem.photometry.gamma

    @property
    def weight(self) -> FloatArray:
        """W; 0 where the picture says nothing."""
        return inner(self.coefficients.weight)

    @cached_property
    def jacobian(self) -> scipy.sparse.csr_array:
        """J, (N, N), of the frame's pixels, row by row: slopes are means of the differences to both sides."""
        right, below = inner(self.grid.link).astype(np.float64)
        left = shift(right, -1, 1, 0.0)
        above = shift(below, -1, 0, 0.0)
        by_u = inner(self.coefficients.by_v_u) * (1 - 0.5 * right * left)
        by_w = inner(self.coefficients.by_v_v) * (1 - 0.5 * below * above)
        middle = (
            inner(self.coefficients.by_v) + by_u * (left - right) + by_w * (above - below)
        )
        width = right.shape[1]
        bands = {
            0: middle,
            1: by_u * right,
            -1: -by_u * left,
            width: by_w * below,
            -width: -by_w * above,
        }
        columns = np.stack([*bands.values()]).reshape(len(bands), -1)
        # That matrix's bands are stored by its columns: J's rows.
        transposed = scipy.sparse.dia_array(
            (columns, [-step for step in bands]), shape=(middle.size, middle.size)
        )
        return transposed.T.tocsr()

    def apply(self, x: FloatArray) -> FloatArray:
        """J x: how the picture changes with v."""
        return np.asarray(self.jacobian @ x.ravel()).reshape(x.shape)

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
        weighted = (self.weight * change).ravel()
        return self.solve((self.jacobian.T @ weighted).reshape(change.shape))

    def to_light(self, change: FloatArray) -> FloatArray:
        """How v answers to light that is brighter by this share, a change of its logarithm.

        What is common to all pixels moves all of them alike, as ξ̃ goes with it.
        """
        mask = self.problem.mask
        common = float(np.median(change[mask]))
        by_shape = np.where(mask, self.by_light * (change - common), 0.0)
        return self.to_picture(by_shape) - 0.5 * common * mask

    def in_light(self, change: FloatArray | float) -> FloatArray:
        """A change of the picture as one of its light's logarithm; 0 where there is none."""
        by_light = self.by_light
        return np.asarray(
            np.divide(change, by_light, out=np.zeros_like(by_light), where=by_light > 0)
        )
