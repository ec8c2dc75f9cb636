"""Normal equations in the shape of an arrow: a few common unknowns and many small groups' own.

The own unknowns are eliminated group by group (Schur complement), so the cost grows with the number
of groups and not with its cube.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from endolab.operators import FloatArray, IntArray

GONE = 1e-13  # eigenvalue, relative to the diagonal, of a direction that the data do not tell
ROWS = 256  # of a tall matrix, that are multiplied at once


@dataclass(frozen=True)
class Linearised:
    """Residuals and their derivatives.

    Attributes
    ----------
    residual : (n, m) float array
        n measurements of m numbers each (2 for pixels, 1 for grey levels).
    by_common : (n, m, p) float array
        Derivatives by the common unknowns.
    by_own : (n, m, b) float array
        Derivatives by the unknowns of the measurement's own group.
    prior : (q,) float array
        Residuals of what is known beforehand, in standard deviations.
    prior_by_common : (q, p) float array
        Their derivatives.
    """

    residual: FloatArray
    by_common: FloatArray
    by_own: FloatArray
    prior: FloatArray
    prior_by_common: FloatArray


@dataclass(frozen=True)
class Covariance:
    """Uncertainty of a fit, at its end.

    Attributes
    ----------
    common : (p, p) float array
        Covariance of the common unknowns; inf on the diagonal of one that the data do not tell.
    own : (groups, b, b) float array
        Covariance of each group's own unknowns, the common ones' uncertainty included; inf likewise.
    """

    common: FloatArray
    own: FloatArray


def _sums(values: FloatArray, group: IntArray, groups: int) -> FloatArray:
    """Sum over the measurements of each group; the groups are in order, none is empty."""
    total: FloatArray = np.add.reduceat(values, np.searchsorted(group, np.arange(groups)), axis=0)
    return total


def _inverses(matrices: FloatArray, diagonal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Invert symmetric matrices (..., n, n) where they tell something.

    Returns the pseudo-inverses and, as columns (..., n, n), the directions they do not tell, zero
    elsewhere. Both are judged after scaling to the diagonal (..., n).
    """
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    values, vectors = np.linalg.eigh(matrices * scale[..., None] * scale[..., None, :])
    gone = values < GONE
    vectors = vectors * scale[..., None]
    told = vectors / np.sqrt(np.where(gone, np.inf, values))[..., None, :]
    return told @ np.swapaxes(told, -1, -2), vectors * gone[..., None, :]


def product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return aᵀ b for two tall matrices, (n, p) and (n, q), by pieces of rows.

    The pieces are so small that BLAS keeps to one thread. On a whole tall matrix it takes several,
    and on a busy machine these wait for each other ten times longer than they work.
    """
    pieces = len(a) // ROWS
    whole = pieces * ROWS
    left, right = (m[:whole].reshape(pieces, ROWS, m.shape[1]) for m in (a, b))
    total: FloatArray = np.matmul(np.swapaxes(left, 1, 2), right).sum(axis=0) + a[whole:].T @ b[whole:]
    return total


class Arrow:
    """Normal equations of a linearised model with weights, own unknowns eliminated."""

    def __init__(self, lin: Linearised, weight: FloatArray, group: IntArray) -> None:
        groups = int(group[-1]) + 1
        root = np.sqrt(weight)[:, None]
        r = lin.residual * root
        a, b = lin.by_common * root[..., None], lin.by_own * root[..., None]
        flat = a.reshape(r.size, a.shape[-1])
        self.common = product(flat, flat) + lin.prior_by_common.T @ lin.prior_by_common
        self.common_gradient = product(flat, r.reshape(-1, 1))[:, 0] + lin.prior_by_common.T @ lin.prior
        self.own = _sums(np.swapaxes(b, 1, 2) @ b, group, groups)
        self.own_gradient = _sums(np.einsum("nmi,nm->ni", b, r), group, groups)
        self.cross = _sums(np.swapaxes(b, 1, 2) @ a, group, groups)  # (groups, b, p)

    def solve(self, damping: float) -> tuple[FloatArray, FloatArray]:
        """Solve for the step with the diagonal grown by a factor 1 + damping (Levenberg-Marquardt)."""
        own, common = self.own.copy(), self.common.copy()
        for matrix in (own, common):
            diagonal = np.einsum("...ii->...i", matrix)
            diagonal += damping * diagonal + (diagonal == 0)
        gain = np.linalg.solve(own, self.cross)
        rest = np.linalg.solve(own, self.own_gradient[..., None])[..., 0]
        scale = 1 / np.sqrt(np.diag(common))
        reduced = common - np.einsum("gbi,gbj->ij", self.cross, gain)
        right = self.common_gradient - np.einsum("gbi,gb->i", gain, self.own_gradient)
        step = -scale * np.linalg.lstsq(reduced * scale * scale[:, None], right * scale, rcond=1e-14)[0]
        return step, -rest - gain @ step

    def length(self, common: FloatArray, own: FloatArray) -> float:
        """Length of a step in standard errors; no unknown moves by more of its own."""
        square = common @ self.common @ common + 2 * np.einsum("gb,gbp,p->", own, self.cross, common)
        return float(np.sqrt(max(square + np.einsum("gi,gij,gj->", own, self.own, own), 0.0)))

    def covariance(self) -> Covariance:
        """Invert the normal equations; unknowns that they do not tell get inf."""
        alone, lost_own = _inverses(self.own, np.einsum("gii->gi", self.own))
        gain = alone @ self.cross
        reduced = self.common - np.einsum("gbi,gbj->ij", self.cross, gain)
        diagonal = np.diag(self.common)
        common, lost = _inverses(reduced, diagonal)
        own = alone + gain @ common @ np.swapaxes(gain, 1, 2)
        # What a lost direction moves, in units of what is known of it without the others, is lost too.
        unknown = np.any(np.abs(lost) * np.sqrt(diagonal)[:, None] > 1e-3, axis=1)
        common[unknown, unknown] = np.inf
        spread = np.sqrt(np.einsum("gii->gi", alone))
        unknown = np.any(np.abs(gain @ lost) > 1e-3 * spread[..., None], axis=-1)
        unknown |= np.any(lost_own != 0, axis=-1) & (spread == 0)
        group, index = np.nonzero(unknown)
        own[group, index, index] = np.inf
        return Covariance(common, own)
