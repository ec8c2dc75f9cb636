"""Robust least squares with many small blocks of unknowns: the solver of both calibrations.

The unknowns are a few *common* ones c (the camera, or k, γ and the BRDF) and, for each group g of
residuals (a view, or a frame), a few of its *own* o_g (its pose, or its gain). What is minimised is

    Σ ρ(|r| / σ) + ½ Σ P (c - c₀)² + ½ Σ S o_g²        over all measurements

with P and S the `certainty` of what is known beforehand. No two groups' own unknowns meet, so that the
normal equations have the shape of an arrow:

    | A    C₁ᵀ  C₂ᵀ  … |   | δc  |       | a  |        A    `common`
    | C₁   B₁          |   | δo₁ |       | b₁ |        B_g  `own`, small: of one group
    | C₂        B₂     | · | δo₂ |  =  - | b₂ |        C_g  `cross`
    | …             …  |   |  …  |       | …  |        a, b_g  the gradients

`Arrow` eliminates the own unknowns, group by group, solves for the common ones and goes back:

    (A - Σ C_gᵀ B_g⁻¹ C_g) δc = -(a - Σ C_gᵀ B_g⁻¹ b_g),      δo_g = -B_g⁻¹ (b_g + C_g δc)

A Huber penalty brings the start near; then the residuals below `OUTLIER` standard deviations count all
alike, and the others not at all, because a Huber penalty is still pulled by them. σ and the choice of
residuals are frozen while a cost is minimised; rounds repeat until a choice comes up again.
"""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy

from endolab.numerics.arrays import BoolArray, FloatArray, IntArray
from endolab.numerics.iteration import Status

HUBER = 1.5  # standard deviations where the parabola becomes a line
OUTLIER = 3.5  # standard deviations beyond which a residual is an outlier
SMALLEST_SIGMA = 1e-4  # be it of pixels or grey levels: rounding would count


# The problem ----------------------------------------------------------------------------
@dataclass(frozen=True)
class Linearised:
    """Residuals and their derivatives: n measurements of m numbers (2 for pixels, 1 for grey levels)."""

    residual: FloatArray  # (n, m)
    by_common: FloatArray  # (n, m, p), derivatives by the common unknowns
    by_own: FloatArray  # (n, m, b), by the unknowns of the measurement's own group
    off: FloatArray | float = 0.0  # (p,), c - c₀: common unknowns less what they should be
    certainty: FloatArray | float = 0.0  # (p,), the inverse of the variance of that
    own: FloatArray | float = 0.0  # (groups, b), own unknowns that should be 0
    own_certainty: FloatArray | float = 0.0  # (b,), likewise


class Model(Protocol):
    """What the solver asks of a calibration problem."""

    @property
    def group(self) -> IntArray:
        """Group of each measurement, (n,), in ascending order, without gaps from 0."""
        ...

    def linearise(self, unknowns: Any) -> Linearised:
        """Residuals and derivatives at the unknowns."""
        ...

    def take_step(self, unknowns: Any, common: FloatArray, own: FloatArray) -> Any:
        """Return the unknowns after a step, (p,) and (groups, b); None if it leads out of bounds."""
        ...

    def usable(self, unknowns: Any) -> BoolArray:
        """Which measurements can be believed at all, (n,): not saturated, in front of the camera."""
        ...


# Normal equations -----------------------------------------------------------------------
def _square(a: FloatArray) -> FloatArray:
    """Return aᵀ a for a tall matrix, (n, p), by pieces of rows.

    The pieces are so small that BLAS keeps to one thread. On a whole tall matrix it takes several,
    and on a busy machine these wait for each other ten times longer than they work.
    """
    square = np.zeros((a.shape[1],) * 2)
    for piece in np.array_split(a, len(a) // 256 + 1):
        square += piece.T @ piece
    return square


class Arrow:
    """Normal equations of a linearised model with weights, own unknowns eliminated."""

    def __init__(self, lin: Linearised, weight: FloatArray, group: IntArray) -> None:
        root = np.sqrt(weight)[:, None]
        r = (lin.residual * root)[..., None]
        a = lin.by_common * root[..., None]
        b = lin.by_own * root[..., None]
        across = np.swapaxes(b, 1, 2)
        first = np.searchsorted(group, np.arange(group[-1] + 1))
        self.common = _square(a.reshape(r.size, -1))
        self.common += np.eye(a.shape[-1]) * lin.certainty
        self.gradient = np.einsum("nmp,nmi->p", a, r) + lin.certainty * lin.off
        self.own = np.add.reduceat(across @ b, first)
        self.own += np.eye(b.shape[-1]) * lin.own_certainty
        self.own_gradient = np.add.reduceat(across @ r, first)[..., 0]
        self.own_gradient += lin.own_certainty * lin.own
        self.cross = np.add.reduceat(across @ a, first)  # (groups, b, p)

    def _eliminate(
        self, damping: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Take the own unknowns out of equations whose diagonal has grown by a factor 1 + damping.

        Returns B⁻¹, B⁻¹ C, what is left for the common unknowns, scaled to A's diagonal, and that scale.
        """
        own = self.own.copy()
        common = self.common.copy()
        for matrix in (own, common):
            diagonal = np.einsum("...ii->...i", matrix)
            diagonal += damping * diagonal + (diagonal == 0)
        alone = np.asarray(np.linalg.inv(own), dtype=np.float64)
        gain = alone @ self.cross
        reduced = common - np.einsum("gbi,gbj->ij", self.cross, gain)
        scale = 1 / np.sqrt(np.diag(common))
        return alone, gain, reduced * scale * scale[:, None], scale

    def solve(self, damping: float) -> tuple[FloatArray, FloatArray]:
        """Solve for the step of Levenberg and Marquardt."""
        alone, gain, reduced, scale = self._eliminate(damping)
        right = self.gradient - np.einsum("gbi,gb->i", gain, self.own_gradient)
        step = -scale * np.linalg.lstsq(reduced, right * scale, rcond=1e-14)[0]
        return step, -np.einsum("gij,gj->gi", alone, self.own_gradient) - gain @ step

    def covariance(self) -> tuple[FloatArray, FloatArray]:
        """Invert the normal equations: (p, p), and (groups, b, b), common uncertainty included.

        Unknowns that they do not tell get inf on the diagonal. Such have a variance of 1e11 times that
        which they would have alone, or more.
        """
        alone, gain, reduced, scale = self._eliminate(1e-13)
        common = np.linalg.inv(reduced) * scale * scale[:, None]
        own = alone + gain @ common @ np.swapaxes(gain, 1, 2)
        for matrix, equations in ((common, self.common), (own, self.own)):
            variance = np.einsum("...ii->...i", matrix)
            inflation = variance * np.einsum("...ii->...i", equations)
            variance[~((inflation > 0) & (inflation < 1e11))] = np.inf
        return common, own


# The fit --------------------------------------------------------------------------------
@dataclass(frozen=True)
class Fit:
    """What a fit found; `status` says why it ended."""

    unknowns: Any  # as the model keeps them
    residual: FloatArray  # (n, m)
    used: BoolArray  # (n,), measurements that count
    sigma: float  # standard deviation of one number of a residual
    covariance: FloatArray  # (p, p), of the common unknowns; inf on the diagonal of what is not told
    own_covariance: FloatArray  # (groups, b, b), the common unknowns' uncertainty included
    status: Status


def robust_sigma(
    residual: FloatArray,
    used: BoolArray,
    unknowns: int,
    smallest: float = SMALLEST_SIGMA,
) -> float:
    """Estimate σ of one number of a residual, (n, m), from measurements that may hold outliers.

    It is the standard deviation of the residuals below `OUTLIER` σ, corrected for the tail that this leaves
    out and for the number of `unknowns` fitted to them; never below `smallest`.
    """
    size = np.linalg.norm(residual[used], axis=1)
    m = residual.shape[1]
    if size.size == 0:
        raise ValueError("no measurement is left to fit")
    sigma = float(np.median(size)) / np.sqrt(scipy.special.chdtri(m, 0.5))
    # E[r² | r < OUTLIER σ] of a chi-squared variable, per number.
    limit = OUTLIER**2 / 2
    kept = scipy.special.gammainc(m / 2 + 1, limit) / scipy.special.gammainc(m / 2, limit)
    for _ in range(30):
        inner = size[size < OUTLIER * sigma]
        count = max(m * len(inner) - unknowns, 1)
        sigma = max(float(np.sqrt(np.sum(inner**2) / count / kept)), smallest)
    return sigma


def _weigh(
    lin: Linearised, used: BoolArray, sigma: float, limit: float
) -> tuple[float, FloatArray]:
    """Return a cost that is linear beyond `limit` σ, and weights of squares that have its gradient."""
    size = np.linalg.norm(lin.residual, axis=1) / sigma
    known = np.sum(lin.certainty * np.square(lin.off))
    known += np.sum(lin.own_certainty * np.square(lin.own))
    cost = np.sum(scipy.special.huber(limit, size[used])) + 0.5 * known
    return float(cost), used * np.minimum(1, limit / np.maximum(size, 1e-9)) / sigma**2


def _descend(
    model: Model,
    unknowns: Any,
    used: BoolArray,
    sigma: float,
    limit: float,
    tolerance: float,
) -> tuple[Any, Status]:
    """Minimise the cost of `_weigh` by steps of Levenberg and Marquardt.

    A step is the last if it moves no unknown by more than `tolerance` of its standard error.
    """
    lin = model.linearise(unknowns)
    cost, weight = _weigh(lin, used, sigma, limit)
    damping = 1e-10
    for _ in range(200):
        arrow = Arrow(lin, weight, model.group)
        step = arrow.solve(damping)
        # Undamped, a step's length in standard errors, squared, is how far it goes down the gradient.
        fall = -step[0] @ arrow.gradient - np.sum(step[1] * arrow.own_gradient)
        # A step that is short because it was damped proves nothing.
        is_last = damping < 1e-3 and fall < tolerance**2
        there = model.take_step(unknowns, *step)
        ahead = lin if there is None else model.linearise(there)
        lower, weight_ahead = _weigh(ahead, used, sigma, limit)
        # An increase that is nothing against the tolerance is rounding.
        if there is not None and lower <= cost * (1 + 1e-12) + 5e-9:
            unknowns, lin, cost, weight = there, ahead, lower, weight_ahead
            damping = max(damping / 10, 1e-10)
        else:
            damping = max(10 * damping, 1e-6)
        if is_last:
            return unknowns, Status.CONVERGED
        if damping > 1e12:
            return unknowns, Status.STALLED
    return unknowns, Status.MAX_ITERATIONS


def fit(model: Model, start: Any, smallest: float = SMALLEST_SIGMA) -> Fit:
    """Fit a model from its unknowns `start`.

    σ is never taken to be below `smallest`: what the measurements are good for at best. ValueError if no
    measurement is usable, or too few are left.
    """
    unknowns = start
    lin = model.linearise(start)
    loose = lin.by_own.shape[-1] - np.count_nonzero(lin.own_certainty)
    count = lin.by_common.shape[-1] + loose * (int(model.group[-1]) + 1)
    used = np.zeros(len(model.group), bool)
    sigma = np.inf
    near = False
    choices: set[bytes] = set()
    for _ in range(30):
        good = model.usable(unknowns)
        before = sigma
        sigma = robust_sigma(lin.residual, good, count, smallest)
        near = near or abs(before - sigma) < 0.1 * sigma
        if near:
            size = np.linalg.norm(lin.residual, axis=1)
            # A measurement on the border would go in and out for ever: who is in stays a little longer.
            good = good & (size < np.where(used, 1.01, 1.0) * OUTLIER * sigma)
            if good.tobytes() in choices:
                break
            choices.add(good.tobytes())
        used = good
        # The Huber penalty only has to come near.
        limit, tolerance = (1e9, 1e-4) if near else (HUBER, 1.0)
        unknowns, status = _descend(model, unknowns, used, sigma, limit, tolerance)
        lin = model.linearise(unknowns)
    else:
        status = Status.STALLED
    covariance = Arrow(lin, used / sigma**2, model.group).covariance()
    return Fit(unknowns, lin.residual, used, sigma, *covariance, status)
