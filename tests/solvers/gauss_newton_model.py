"""The compiled linearisation of the energy in plain NumPy, to read and to test against."""

from dataclasses import dataclass

import numpy as np

from endolab.model.surface import slant, to_xi
from endolab.numerics.compiled import inner, pad_maps
from endolab.numerics.derivatives import forward_gradient, gradient, hessian
from endolab.solvers.energy import contradicts, energy_terms
from endolab.solvers.grid import Grid
from endolab.solvers.multigrid import multiply
from endolab.solvers.normal_equations import BY_U, BY_V, BY_W, SLOPE, SMOOTHNESS, WEIGHT
from endolab.solvers.problem import Problem
from tests.tools.adjoints import (
    forward_gradient_adjoint,
    gradient_adjoint,
    hessian_adjoint,
)

OPERATORS = {  # and their adjoints: of a map, mask and cuts
    "first": [forward_gradient, forward_gradient_adjoint],
    "second": [hessian, hessian_adjoint],
}
TWINS = {  # of GaussNewtonModel: maps of `Coefficients`
    "by_v": BY_V,
    "by_v_u": BY_U,
    "by_v_v": BY_W,
    "data_weight": WEIGHT,
    "xi_slope": SLOPE,
    "smoothness": SMOOTHNESS,
}


@dataclass(frozen=True)
class GaussNewtonModel:
    """The energy around a depth map, as a quadratic: what one Gauss-Newton step minimises.

    Both Huber penalties are replaced by the parabolas that touch them (iteratively reweighted
    least squares), the model image by its linearisation

        I_model(v + δ) ≈ I_model(v) + a δ + b·∇δ,    a = ∂I/∂v = -2 I/γ,   b = 2 ∂I/∂P G⁻¹ ∇v.

    All arrays are (H, W) and 0 outside the mask; the first five are 0, too, where the picture is no
    evidence against the model.
    """

    problem: Problem
    residual: np.ndarray  # I_model - I
    by_v: np.ndarray  # a
    by_v_u: np.ndarray  # b
    by_v_v: np.ndarray
    data_weight: np.ndarray  # IRLS weight of the residual
    xi: np.ndarray  # ξ/ξ̃
    xi_slope: np.ndarray  # its derivative by v
    # Weight of |D ξ|²: λ g s² / max(‖D ξ‖, ε), s the energy's derivative scale.
    smoothness: np.ndarray

    @classmethod
    def at(cls, problem, log_distance):
        """Linearise around v = log d, (H, W)."""
        mask = problem.mask
        cuts = problem.cuts
        field = problem.field
        scale = problem.derivative_scale
        guu, guv, gvv = np.moveaxis(field.inverse_metric, -1, 0)
        f_u, f_v = gradient(log_distance, mask, cuts, edge_order=1)
        shade = problem.photometry.shade(
            log_distance, slant(f_u, f_v, field), field.cos_alpha
        )
        intensity, by_v, by_slant = shade
        residual = intensity - problem.image
        xi = (
            to_xi(np.where(mask, log_distance, 0.0), problem.xi, field.cos_alpha)
            / problem.xi_median
        )
        xi = np.where(mask, xi, 0.0)
        derivative = OPERATORS[problem.regulariser][0](xi, mask, cuts)
        by_gradient = (
            2 * by_slant * (guu * f_u + guv * f_v),
            2 * by_slant * (guv * f_u + gvv * f_v),
        )
        weight = 1 / np.maximum(np.abs(residual) / problem.threshold, 1.0)
        size = np.linalg.norm(scale * derivative, axis=0)
        smoothness = (
            problem.lam
            * problem.edge_weight
            * scale**2
            / np.maximum(size, problem.epsilon)
        )
        counts = contradicts(problem, residual)
        slope = xi if problem.xi == "d" else -xi
        data = (
            np.where(counts, piece, 0.0)
            for piece in (residual, by_v, *by_gradient, weight)
        )
        return cls(
            problem,
            *data,
            *(np.where(mask, piece, 0.0) for piece in (xi, slope, smoothness)),
        )

    @property
    def gradient(self):
        """Derivative of the energy by v, (H, W)."""
        smooth = self.xi_slope * self._smooth(self.xi)
        return (
            self._data_adjoint(self.data_weight * self.residual) + smooth
        ) / self.problem.mask.sum()

    def multiply(self, delta):
        """Matrix of the quadratic times a change of v, (H, W) to (H, W)."""
        mask = self.problem.mask
        delta_u, delta_v = gradient(delta, mask, self.problem.cuts, edge_order=1)
        change = self.by_v * delta + self.by_v_u * delta_u + self.by_v_v * delta_v
        data = self._data_adjoint(self.data_weight * np.where(mask, change, 0.0))
        return (data + self.xi_slope * self._smooth(self.xi_slope * delta)) / mask.sum()

    def _data_adjoint(self, residual):
        around = (self.by_v_u * residual, self.by_v_v * residual)
        return self.by_v * residual + gradient_adjoint(
            around, self.problem.mask, self.problem.cuts
        )

    def _smooth(self, xi):
        """Dᵀ (smoothness · D ξ)."""
        operator, adjoint = OPERATORS[self.problem.regulariser]
        where = self.problem.mask, self.problem.cuts
        return adjoint(self.smoothness * operator(xi, *where), *where)


def energy(problem, v):
    return sum(energy_terms(problem, v).values())


def derivative(function, v, direction, h=1e-6):
    """Central difference of a function of v along a direction."""
    return (function(v + h * direction) - function(v - h * direction)) / (2 * h)


def slope_of_energy(problem, v):
    """Derivative of the energy by each pixel of the mask, from differences, (H, W)."""
    slope = np.zeros(v.shape)
    for pixel in map(tuple, np.argwhere(problem.mask)):
        unit = np.zeros(v.shape)
        unit[pixel] = 1.0
        slope[pixel] = derivative(lambda x: energy(problem, x), v, unit)
    return slope


def relative(found, expected):
    return np.abs(found - expected) / np.abs(expected).max()


def inside(problem, v):
    """A map as the compiled loops take it: 0 outside the mask, with a rim."""
    return pad_maps(np.where(problem.mask, v, 0.0))


def check_the_compiled(problem, v, rng):
    """Coefficients, slope and matrix of the compiled loops are the readable ones."""
    grid = Grid.of(problem)
    model = GaussNewtonModel.at(problem, v)
    coefficients, descent = grid.equations_at(inside(problem, v), problem.lam)
    for readable, compiled in TWINS.items():
        found = inner(coefficients.parts[compiled])
        expected = getattr(model, readable)
        assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max(), (
            readable
        )
    count = problem.mask.sum()
    assert relative(-inner(descent) / count, model.gradient).max() < 1e-12
    x = np.where(problem.mask, rng.normal(size=v.shape), 0.0)
    product = np.zeros_like(descent)
    multiply(coefficients.matrix(0.0), pad_maps(x), product)
    assert relative(inner(product), count * model.multiply(x)).max() < 1e-12
