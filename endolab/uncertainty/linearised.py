"""How a surface answers to small changes: the Gauss-Newton model of the energy, at the estimate.

With J the model's derivatives by v = log d, W the data's weights and R the regulariser's parabolas,

    H = Jᵀ W J + R,        x = H⁻¹ Jᵀ W δI

is what becomes of v if the picture changes by δI. If the regulariser is a prior and the picture's errors are
white, of a variance such that the energy over it is a log-likelihood, H⁻¹ times that variance is the
covariance of v; draws of δI and of the prior's own part, whose covariances are W⁻¹ and R, have it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from endolab.depth.curvature import whole
from endolab.depth.energy import model_image
from endolab.depth.grid import Grid
from endolab.depth.multigrid import Multigrid
from endolab.depth.normal_equations import Coefficients
from endolab.depth.problem import CURVATURE, FIRST, REGULARISERS, Problem
from endolab.numerics.arrays import FloatArray
from endolab.numerics.compiled import inner, padded
from endolab.numerics.derivatives import hessian_stencils, shifted

PRECISION, MOST = 3e-2, 15  # of a solve: residual left, a tenth of what draws scatter by; steps
DAMPING = 1e-3  # share of the data's diagonal that is added to H, for pixels that hang by nothing


@dataclass(frozen=True)
class Linearised:
    """The model at a map v = log d of a problem; maps are (H, W), 0 outside the mask."""

    problem: Problem
    coefficients: Coefficients
    multigrid: Multigrid
    link: FloatArray  # (2, H, W), steps that derivatives take
    model: FloatArray  # I of the surface
    residual: FloatArray  # of it and the picture

    @classmethod
    def at(cls, problem: Problem, log_distance: FloatArray) -> Linearised:
        """Linearise at log d (H, W)."""
        mask = problem.mask
        v = np.where(mask, log_distance, 0.0)
        grid = Grid.of(problem)
        found, _ = grid.linearised(padded(v), problem.lam)
        # Pixels that the solver holds beneath their ceiling are as free to be wrong as others.
        coefficients = Coefficients(found.parts, grid.structure(grid.free))
        model = np.where(mask, model_image(problem, v), 0.0)
        return cls(
            problem,
            coefficients,
            Multigrid(coefficients, DAMPING),
            inner(grid.link).astype(np.float64),
            model,
            np.where(mask, model - problem.image, 0.0),
        )

    @property
    def weight(self) -> FloatArray:
        """W; 0 where the picture says nothing."""
        return inner(self.coefficients.weight)

    # J --------------------------------------------------------------------------------

    def _sides(self) -> tuple[FloatArray, ...]:
        """Whether there is a step to the right, left, below and above."""
        across, down = self.link
        return across, shifted(across, -1, 1, 0.0), down, shifted(down, -1, 0, 0.0)

    def _by_slopes(self) -> tuple[FloatArray, FloatArray]:
        """b of J, by the sums of the differences to both sides."""
        right, left, below, above = self._sides()
        one = inner(self.coefficients.by_v_u) * (1 - 0.5 * right * left)
        return one, inner(self.coefficients.by_v_v) * (1 - 0.5 * below * above)

    def applied(self, x: FloatArray) -> FloatArray:
        """J x: how the picture changes with v."""
        right, left, below, above = self._sides()
        by_u, by_w = self._by_slopes()
        along_u = right * (shifted(x, 1, 1, 0.0) - x) + left * (x - shifted(x, -1, 1, 0.0))
        along_w = below * (shifted(x, 1, 0, 0.0) - x) + above * (x - shifted(x, -1, 0, 0.0))
        return inner(self.coefficients.by_v) * x + by_u * along_u + by_w * along_w

    def adjoint(self, f: FloatArray) -> FloatArray:
        """Jᵀ f."""
        right, left, below, above = self._sides()
        by_u, by_w = (one * f for one in self._by_slopes())
        out = inner(self.coefficients.by_v) * f + by_u * (left - right) + by_w * (above - below)
        out += shifted(by_u * right, -1, 1, 0.0) - shifted(by_u * left, 1, 1, 0.0)
        return out + shifted(by_w * below, -1, 0, 0.0) - shifted(by_w * above, 1, 0, 0.0)

    # H⁻¹ ------------------------------------------------------------------------------

    def solved(self, b: FloatArray) -> FloatArray:
        """H⁻¹ b."""
        x = self.multigrid.solve(padded(np.where(self.problem.mask, b, 0.0)), PRECISION, MOST)[0]
        return inner(x).astype(np.float64)

    def to_picture(self, change: FloatArray) -> FloatArray:
        """How v answers to a change of the picture, of stored values."""
        return self.solved(self.adjoint(self.weight * change))

    def to_light(self, change: FloatArray) -> FloatArray:
        """How v answers to light that is brighter by this share, a change of its logarithm.

        What is common to all pixels moves all of them alike, as ξ̃ goes with it.
        """
        common = np.median(change[self.problem.mask])
        per_share = self.model / self.problem.photometry.gamma
        return self.to_picture(per_share * (change - common)) - 0.5 * common * self.problem.mask

    # R --------------------------------------------------------------------------------

    def prior_draw(self, rng: np.random.Generator) -> FloatArray:
        """A right-hand side whose covariance is R."""
        slope = inner(self.coefficients.slope)
        return slope * self._spread(self._rooted(rng.standard_normal((3, *slope.shape))))

    def _rooted(self, form: FloatArray) -> FloatArray:
        """A root of Q, Cholesky's, times three maps."""
        q = inner(self.coefficients.smoothness)
        if len(q) == 1:
            return np.sqrt(q[0]) * form
        q00, q01, q02, q11, q12, q22 = q
        a, b, c = form
        l00 = np.sqrt(np.maximum(q00, 0))
        l10, l20 = _over(q01, l00), _over(q02, l00)
        l11 = np.sqrt(np.maximum(q11 - l10**2, 0))
        l21 = _over(q12 - l10 * l20, l11)
        l22 = np.sqrt(np.maximum(q22 - l20**2 - l21**2, 0))
        return np.stack([l00 * a, l10 * a + l11 * b, l20 * a + l21 * b + l22 * c])

    def _spread(self, form: FloatArray) -> FloatArray:
        """Dᵀ of three maps, D being the gradient, the Hessian or the form of `curvature`."""
        right, left, below, above = self._sides()
        uu, uv, vv = form
        if self.problem.regulariser == REGULARISERS[FIRST]:
            u, w = uu * right, vv * below
            return shifted(u, -1, 1, 0.0) + shifted(w, -1, 0, 0.0) - u - w
        if self.problem.regulariser != REGULARISERS[CURVATURE]:
            along_u, mixed, along_v = hessian_stencils(self.link > 0)
            return _second(uu * along_u, np.sqrt(2) * uv * mixed, vv * along_v)
        known = whole(self.problem.mask, self.problem.cuts)
        uu, uv, vv = uu * known[0], uv * known[1], vv * known[2]
        shares = inner(self.coefficients.structure.shares)
        by_u, by_w, by_value = (shares[0, k] * uu + shares[1, k] * uv + shares[2, k] * vv for k in range(3))
        u, w = by_u * right, by_w * below
        out = _second(uu, uv, vv) - by_u * (left - right) - by_w * (above - below) - by_value
        out += shifted(by_u * left, 1, 1, 0.0) - shifted(u, -1, 1, 0.0)
        return out + shifted(by_w * above, 1, 0, 0.0) - shifted(w, -1, 0, 0.0)


def _over(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.divide(a, b, out=np.zeros_like(a), where=b > 0)


def _second(uu: FloatArray, uv: FloatArray, vv: FloatArray) -> FloatArray:
    """Adjoint of the second differences along rows, mixed and along columns."""
    out = uv - 2 * uu - 2 * vv
    out += shifted(uu, -1, 1, 0.0) + shifted(uu, 1, 1, 0.0) + shifted(vv, -1, 0, 0.0) + shifted(vv, 1, 0, 0.0)
    above = shifted(uv, -1, 0, 0.0)
    return out - shifted(uv, -1, 1, 0.0) - above + shifted(above, -1, 1, 0.0)
