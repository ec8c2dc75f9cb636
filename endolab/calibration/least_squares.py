"""Robust least squares with many small blocks of unknowns: the solver of both calibrations.

The unknowns are a few *common* ones c (the camera, or k, γ and the BRDF) and, for each group g of
residuals (a view, or a frame), a few of its *own* o_g (its pose, or its gain). What is minimised is

    Σ ρ(|r| / σ) + ½ Σ P (c - c₀)²        over all measurements

with P the inverse variances of what is known beforehand, 1/`sd`². No two groups' own
unknowns meet, so that the normal equations have the shape of an arrow:

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

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np
import scipy

from endolab.calibration import constants
from endolab.numerics.arrays import BoolArray, FloatArray, IntArray, nan_if_undefined
from endolab.numerics.iteration import Status

Row = tuple[str, float, float, str]  # name, value, its standard error, unit


def list_rows(
    values: Mapping[str, tuple[float, str]], errors: Mapping[str, float]
) -> list[Row]:
    """List values, with their units, and their standard errors; nan where there is none."""
    return [
        (name, value, errors.get(name, np.nan), unit)
        for name, (value, unit) in values.items()
    ]


# The problem ----------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Model:
    """A calibration problem: n measurements of m numbers (2 for pixels, 1 for grey levels)."""

    group: IntArray  # (n,), of each measurement, in ascending order, without gaps from 0
    mean: FloatArray  # (p,), of each common unknown before the fit
    sd: FloatArray  # (p,), its standard deviation: 0 if it is given, inf if nothing is known

    # Of one number of a measurement, the least standard deviation; by default, rounding.
    smallest: ClassVar[float] = 1e-4

    def linearise(
        self, common: FloatArray, own: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals, (n, m), and their derivatives by the common and the own unknowns, (n, m, p or b).

        Residuals are nan at unknowns that are out of bounds.
        """
        raise NotImplementedError

    def usable(self, common: FloatArray, own: FloatArray) -> BoolArray:
        """Which measurements can be believed at all, (n,): not saturated, in front of the camera."""
        raise NotImplementedError


# Normal equations -----------------------------------------------------------------------
class Arrow:
    """Normal equations of a linearised model with weights (n,), own unknowns eliminated.

    Residuals and derivatives are as of `Model.linearise`.
    """

    def __init__(
        self,
        residual: FloatArray,
        by_common: FloatArray,
        by_own: FloatArray,
        weight: FloatArray,
        group: IntArray,
    ) -> None:
        root = np.sqrt(weight)[:, None]
        r = (residual * root)[..., None]
        a = by_common * root[..., None]
        b = by_own * root[..., None]
        across = np.swapaxes(b, 1, 2)
        first = np.searchsorted(group, np.arange(group[-1] + 1))
        # BLAS would take several threads, which on a busy machine wait for each other.
        self.common = np.einsum("nmp,nmq->pq", a, a)
        self.gradient = np.einsum("nmp,nmi->p", a, r)
        self.own = np.add.reduceat(across @ b, first)
        self.own_gradient = np.add.reduceat(across @ r, first)[..., 0]
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
@dataclass(frozen=True, eq=False)
class Fit:
    """What a fit found; `status` says why it ended."""

    common: FloatArray  # (p,)
    own: FloatArray  # (groups, b)
    residual: FloatArray  # (n, m)
    used: BoolArray  # (n,), measurements that count
    sigma: float  # standard deviation of one number of a residual
    status: Status


def robust_sigma(
    residual: FloatArray,
    used: BoolArray,
    unknowns: int,
    smallest: float = 0.0,
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
    limit = constants.OUTLIER**2 / 2
    kept = scipy.special.gammainc(m / 2 + 1, limit) / scipy.special.gammainc(m / 2, limit)
    for _ in range(30):
        inner = size[size < constants.OUTLIER * sigma]
        count = max(m * len(inner) - unknowns, 1)
        sigma = max(float(np.sqrt(np.sum(inner**2) / count / kept)), smallest)
    return sigma


def _equations(
    model: Model,
    used: BoolArray,
    sigma: float,
    limit: float,
    common: FloatArray,
    own: FloatArray,
) -> tuple[float, Arrow]:
    """Return a cost that is linear beyond `limit` σ, and equations of squares that have its gradient.

    Common unknowns that are given are not in them.
    """
    residual, by_common, by_own = model.linearise(common, own)
    size = np.linalg.norm(residual, axis=1) / sigma
    weight = used * np.minimum(1, limit / np.maximum(size, 1e-9)) / sigma**2
    free = model.sd > 0
    off = (common - model.mean)[free]
    certainty = model.sd[free] ** -2
    known = np.sum(certainty * off**2)
    arrow = Arrow(residual, by_common[..., free], by_own, weight, model.group)
    arrow.common += np.diag(certainty)
    arrow.gradient += certainty * off
    return float(np.sum(scipy.special.huber(limit, size[used])) + 0.5 * known), arrow


def _descend(
    equations: Callable[[FloatArray, FloatArray], tuple[float, Arrow]],
    common: FloatArray,
    own: FloatArray,
    free: BoolArray,
    tolerance: float,
) -> tuple[FloatArray, FloatArray, Status]:
    """Minimise a cost, of which equations are given, by steps of Levenberg and Marquardt.

    Common unknowns that are not free stay. A step is the last if it moves no unknown by more than
    `tolerance` of its standard error.
    """
    cost, arrow = equations(common, own)
    damping = 1e-10
    for _ in range(200):
        step, own_step = arrow.solve(damping)
        # Undamped, a step's length in standard errors, squared, is how far it goes down the gradient.
        fall = -step @ arrow.gradient - np.sum(own_step * arrow.own_gradient)
        # A step that is short because it was damped proves nothing.
        is_last = damping < 1e-3 and fall < tolerance**2
        moved = common.copy()
        moved[free] += step
        ahead = moved, own + own_step
        lower, arrow_ahead = equations(*ahead)
        # An increase that is nothing against the tolerance is rounding.
        if lower <= cost * (1 + 1e-12) + 5e-9:
            (common, own), cost, arrow = ahead, lower, arrow_ahead
            damping = max(damping / 10, 1e-10)
        else:
            damping = max(10 * damping, 1e-6)
        if is_last:
            return common, own, Status.CONVERGED
        if damping > 1e12:
            return common, own, Status.STALLED
    return common, own, Status.MAX_ITERATIONS


def fit(
    model: Model,
    common: FloatArray,
    own: FloatArray,
    among: BoolArray | bool = True,
) -> Fit:
    """Fit a model from its unknowns: the common ones, (p,), and each group's own, (groups, b).

    Of the measurements, those `among` (n,) count. ValueError if none is usable, or too few are left.
    """
    free = model.sd > 0
    residual = model.linearise(common, own)[0]
    used = np.zeros(len(model.group), bool)
    sigma = np.inf
    near = False
    choices: set[bytes] = set()
    for _ in range(30):
        good = model.usable(common, own) & among
        before = sigma
        groups = len(np.unique(model.group[good]))
        count = np.count_nonzero(free) + own.shape[1] * groups
        sigma = robust_sigma(residual, good, count, model.smallest)
        near = near or abs(before - sigma) < 0.1 * sigma
        if near:
            size = np.linalg.norm(residual, axis=1)
            # A measurement on the border would go in and out for ever: who is in stays a little longer.
            good = good & (size < np.where(used, 1.01, 1.0) * constants.OUTLIER * sigma)
            if good.tobytes() in choices:
                break
            choices.add(good.tobytes())
        used = good
        # The Huber penalty only has to come near.
        limit, tolerance = (1e9, 0.01) if near else (1.5, 1.0)
        equations = partial(_equations, model, used, sigma, limit)
        common, own, status = _descend(equations, common, own, free, tolerance)
        residual = model.linearise(common, own)[0]
    else:
        status = Status.STALLED
    return Fit(common, own, residual, used, sigma, status)


def covariances(model: Model, fitted: Fit) -> tuple[FloatArray, FloatArray]:
    """Return the covariance of the common unknowns, (p, p), and of the own ones, (groups, b, b), of a fit.

    The latter includes the former. 0 for what is given, inf on the diagonal of what is not told.
    """
    free = model.sd > 0
    unknowns = fitted.common, fitted.own
    arrow = _equations(model, fitted.used, fitted.sigma, 1e9, *unknowns)[1]
    of_free, of_own = arrow.covariance()
    covariance = np.zeros((len(free), len(free)))
    covariance[np.ix_(free, free)] = of_free
    return covariance, of_own


# Frames left out ------------------------------------------------------------------------
def jackknife(
    model: Model, fitted: Fit, frame: IntArray, known: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return `covariances` that follow from how far a fit moves without each frame in turn.

    What is wrong with a frame is wrong with many of its measurements, so that C, the covariance of the fit,
    is too small. With r the residuals, a their derivatives by the common unknowns when the own ones give way,
    all over σ, the common unknowns move without frame f of F, to first order, by

        Δ_f = (1 - C Σ aᵀ a)⁻¹ C Σ aᵀ r        over the measurements of f

    Then their covariance is (F-1)/F Σ Δ_f Δ_fᵀ, and C more if F - 1 is no more than the unknowns; and
    what was known beforehand, of the standard deviations `known`, (p,), moves them by C/sd² of its own error.
    `frame`, (n,), is the number of each measurement's, from 0. What is not told stays so.
    """
    frames = frame.max() + 1
    covariance, of_own = covariances(model, fitted)
    lost = np.isinf(np.diag(covariance))
    before = np.where(lost | lost[:, None], 0.0, covariance)
    residual, by_common, by_own = model.linearise(fitted.common, fitted.own)
    weight = fitted.used / fitted.sigma**2
    arrow = Arrow(residual, by_common, by_own, weight, model.group)
    _, gain, *_ = arrow._eliminate(1e-13)
    slopes = by_common - by_own @ gain[model.group]
    believed = (model.sd > 0) & np.isfinite(model.sd)
    pull = before[:, believed] / model.sd[believed]
    after = before - pull @ pull.T
    if frames > 1:
        moves = []
        for one in range(frames):
            a = slopes[frame == one].reshape(-1, len(before))
            part = before @ (a.T * np.repeat(weight[frame == one], residual.shape[1]))
            move = np.linalg.solve(
                np.eye(len(before)) - part @ a, part @ residual[frame == one].ravel()
            )
            moves.append(move)
        # F frames move F - 1 unknowns at most, and few of them may do so too little by chance.
        after *= frames - 1 <= np.sum(np.diag(before) > 0)
        after += np.cov(np.transpose(moves), bias=True) * (frames - 1)
    pull *= known[believed] / model.sd[believed]
    after += pull @ pull.T
    of_own = of_own + gain @ (after - before) @ np.swapaxes(gain, 1, 2)
    after[lost, lost] = np.inf
    return after, of_own


def hold_out(
    model: Model, fitted: Fit, frame: IntArray, sigma: float
) -> tuple[FloatArray, float]:
    """Fit all but a part of the frames, and predict that part but for its own unknowns; each part in turn.

    `frame`, (n,), is the number of each measurement's, from 0. Returns of each frame the mean square of the
    residuals predicted, each at most (`OUTLIER` `sigma`)², as where nothing can be predicted, nan where none
    can be used; and the root of the mean over measurements that the fit of all counts.
    """
    squares = np.full(len(frame), np.inf)
    for part in range(3):
        held = frame % 3 == part
        try:
            common = fit(model, fitted.common, fitted.own, ~held).common
            given = replace(model, mean=common, sd=0 * common)
            predicted = fit(given, common, fitted.own, held)
        except (ValueError, ArithmeticError):
            continue
        good = model.usable(common, predicted.own)
        off = np.where(good, np.sum(predicted.residual**2, axis=1), np.nan)
        squares[held] = off[held]
    squares = np.minimum(squares, (constants.OUTLIER * sigma) ** 2)
    known = np.isfinite(squares)
    with nan_if_undefined():
        rms = float(np.sqrt(np.mean(squares[known & fitted.used])))
        means = np.bincount(frame, np.where(known, squares, 0)) / np.bincount(frame, known)
    return means, rms


def is_better(squares: FloatArray, than: FloatArray) -> bool:
    """Tell whether frames held out are predicted better, by more than 2 of the ± of that."""
    falls = np.nan_to_num(than - squares)
    return bool(falls.sum() > 2 * falls.std() * np.sqrt(len(falls)))
