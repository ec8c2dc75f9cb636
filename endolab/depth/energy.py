"""The one energy: how well a depth map explains a frame, and how smooth it is.

    E(v) = mean ρ(I_model(v) - I) + λ mean g ‖D ξ(v)/ξ̃‖_ε,        v = log d

ρ is Huber's penalty, D the gradient or the Hessian, ξ̃ the median of ξ at the start d₀, and
derivatives are per 1/320 of the picture's width, so that one λ serves all ξ, units and sizes
(paper, Section V; conventions in README.md). What solvers minimise, recordings show and tests
check is this function.

A picture is not always evidence: a saturated pixel says that the surface is at least this bright,
so that its residual counts only where the model is darker, and a highlight or an overlay says
nothing. There the surface is what its neighbours and the regulariser make of it; the mean is
still over all pixels of the mask.

Normals in the model are from central differences of v, and from two pixels where a neighbour
is missing: then the normal equations couple no pixels further apart than the Hessian's do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from endolab.depth.problem import AT_LEAST, EXACT, Problem
from endolab.model.surface import slant, to_xi
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.derivatives import (
    forward_gradient,
    forward_gradient_adjoint,
    gradient,
    gradient_adjoint,
    hessian,
    hessian_adjoint,
)
from endolab.numerics.penalties import huber


def model_image(problem: Problem, log_distance: FloatArray) -> FloatArray:
    """The frame that a depth map predicts, with normals from its gradient.

    Parameters
    ----------
    problem : Problem
    log_distance : (H, W) float array
        v = log d.

    Returns
    -------
    (H, W) float array
        Stored values; nan outside the mask.
    """
    tan2 = slant(*gradient(log_distance, problem.mask, problem.cuts, edge_order=1), problem.field)
    predicted = problem.photometry.shade(log_distance, tan2, problem.field.cos_alpha)[0]
    return np.where(problem.mask, predicted, np.nan)


def contradicted(problem: Problem, residual: FloatArray) -> BoolArray:
    """Where the picture is evidence against a model that is brighter by this residual, (H, W)."""
    if problem.evidence is None:
        return problem.mask
    one_sided = (problem.evidence == AT_LEAST) & (np.where(problem.mask, residual, 0.0) < 0)
    return problem.mask & ((problem.evidence == EXACT) | one_sided)


def _scaled_xi(problem: Problem, log_distance: FloatArray) -> FloatArray:
    """Return ξ/ξ̃, 0 outside the mask."""
    xi = to_xi(np.where(problem.mask, log_distance, 0.0), problem.xi, problem.field.cos_alpha)
    return np.where(problem.mask, xi, 0.0) / problem.xi_median


def _roughness(problem: Problem, xi: FloatArray) -> tuple[FloatArray, FloatArray]:
    """D ξ/ξ̃ in the energy's unit, (2 or 3, H, W), and its norm, (H, W)."""
    operator = forward_gradient if problem.regulariser == "first" else hessian
    derivative = operator(xi, problem.mask, problem.cuts) * problem.derivative_scale
    return derivative, np.linalg.norm(derivative, axis=0)


def energy_terms(problem: Problem, log_distance: FloatArray) -> dict[str, float]:
    """The two terms of the energy of a depth map.

    Parameters
    ----------
    problem : Problem
    log_distance : (H, W) float array
        v = log d, finite inside the mask.

    Returns
    -------
    dict
        "data" and "regulariser" (λ included); the energy is their sum.
    """
    mask, count = problem.mask, int(problem.mask.sum())
    residual = model_image(problem, log_distance) - problem.image
    residual = residual[contradicted(problem, residual)]
    size = _roughness(problem, _scaled_xi(problem, log_distance))[1]
    roughness = problem.edge_weight * huber(size, problem.epsilon) / problem.epsilon
    return {
        "data": float(huber(residual, problem.threshold).sum() / count),
        "regulariser": float(problem.lam * roughness[mask].sum() / count),
    }


@dataclass(frozen=True)
class GaussNewtonModel:
    """The energy around a depth map, as a quadratic: what one Gauss-Newton step minimises.

    Both Huber penalties are replaced by the parabolas that touch them (iteratively reweighted
    least squares), the model image by its linearisation

        I_model(v + δ) ≈ I_model(v) + a δ + b·∇δ,    a = ∂I/∂v = -2 I/γ,   b = 2 ∂I/∂P G⁻¹ ∇v.

    All arrays are (H, W) and 0 outside the mask; the first five are 0, too, where the picture is no
    evidence against the model.

    Attributes
    ----------
    residual : array
        I_model - I.
    by_v, by_v_u, by_v_v : arrays
        a and the two components of b.
    data_weight : array
        IRLS weight of the residual.
    xi, xi_slope : arrays
        ξ/ξ̃ and its derivative by v.
    smoothness : array
        Weight of |D ξ|² per pixel: λ g s² / max(‖D ξ‖, ε), s the energy's derivative scale.
    """

    problem: Problem
    residual: FloatArray
    by_v: FloatArray
    by_v_u: FloatArray
    by_v_v: FloatArray
    data_weight: FloatArray
    xi: FloatArray
    xi_slope: FloatArray
    smoothness: FloatArray

    @classmethod
    def at(cls, problem: Problem, log_distance: FloatArray) -> GaussNewtonModel:
        """Linearise around v = log d, (H, W)."""
        mask, field = problem.mask, problem.field
        guu, guv, gvv = np.moveaxis(field.inverse_metric, -1, 0)
        f_u, f_v = gradient(log_distance, mask, problem.cuts, edge_order=1)
        shade = problem.photometry.shade(log_distance, slant(f_u, f_v, field), field.cos_alpha)
        intensity, by_v, by_slant = shade
        residual = intensity - problem.image
        xi = _scaled_xi(problem, log_distance)
        size = _roughness(problem, xi)[1]
        smoothness = problem.lam * problem.edge_weight * problem.derivative_scale**2
        pieces = (
            residual,
            by_v,
            2 * by_slant * (guu * f_u + guv * f_v),
            2 * by_slant * (guv * f_u + gvv * f_v),
            1 / np.maximum(np.abs(residual) / problem.threshold, 1.0),
            xi,
            xi if problem.xi == "d" else -xi,
            smoothness / np.maximum(size, problem.epsilon),
        )
        counts = contradicted(problem, residual)
        places = (*[counts] * 5, mask, mask, mask)
        return cls(problem, *(np.where(at, piece, 0.0) for at, piece in zip(places, pieces, strict=True)))

    @property
    def gradient(self) -> FloatArray:
        """Derivative of the energy by v, (H, W)."""
        smooth = self.xi_slope * self._smooth(self.xi)
        return (self._data_adjoint(self.data_weight * self.residual) + smooth) / self._count

    def multiply(self, delta: FloatArray) -> FloatArray:
        """Matrix of the quadratic times a change of v, (H, W) to (H, W)."""
        problem = self.problem
        delta_u, delta_v = gradient(delta, problem.mask, problem.cuts, edge_order=1)
        change = self.by_v * delta + self.by_v_u * delta_u + self.by_v_v * delta_v
        data = self._data_adjoint(self.data_weight * np.where(problem.mask, change, 0.0))
        return (data + self.xi_slope * self._smooth(self.xi_slope * delta)) / self._count

    @property
    def _count(self) -> int:
        return int(self.problem.mask.sum())

    def _data_adjoint(self, residual: FloatArray) -> FloatArray:
        around = (self.by_v_u * residual, self.by_v_v * residual)
        return self.by_v * residual + gradient_adjoint(*around, self.problem.mask, self.problem.cuts)

    def _smooth(self, xi: FloatArray) -> FloatArray:
        """Dᵀ (smoothness · D ξ)."""
        first = self.problem.regulariser == "first"
        operator, adjoint = (
            (forward_gradient, forward_gradient_adjoint) if first else (hessian, hessian_adjoint)
        )
        where = (self.problem.mask, self.problem.cuts)
        return adjoint(self.smoothness * operator(xi, *where), *where)
