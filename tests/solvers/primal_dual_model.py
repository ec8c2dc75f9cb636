"""The primal-dual scheme in plain NumPy, from the library's operators, to read and to test against."""

import numpy as np
from scipy import ndimage

from endolab.model.surface import from_xi, slant, to_xi
from endolab.numerics.derivatives import gradient
from endolab.solvers.primal_dual import BALANCE
from tests.solvers.gauss_newton_model import OPERATORS


def patch_means(p, mask, radius):
    """Mean over the pixels of the mask within a radius, along the row, then the column."""
    patch = np.ones(2 * radius + 1)
    for axis in (1, 0):
        sums = ndimage.convolve1d(
            np.where(mask, p, 0.0), patch, axis=axis, mode="constant"
        )
        p = np.where(mask, sums / patch_sizes(mask, radius, axis), 0.0)
    return p


def patch_sizes(mask, radius, axis):
    """How many pixels of the mask are within a radius."""
    patch = np.ones(2 * radius + 1)
    return np.maximum(
        ndimage.convolve1d(1.0 * mask, patch, axis=axis, mode="constant"), 1
    )


class PrimalDualModel:
    """Primal, extrapolated and dual variable, and the step sizes of each pixel."""

    def __init__(self, problem, v, radius, safety):
        self.problem = problem
        self.radius = radius
        self.safety = safety
        self.x = self.ahead = self.xi(v)
        first = problem.regulariser == "first"
        self.q = np.zeros((2 if first else 6, *v.shape))
        self.pace = BALANCE / self.curvature(self.x, problem.image)
        widest = ndimage.maximum_filter(np.where(problem.mask, self.pace, 0.0), 3)
        norm = (np.sqrt(8) if first else 8) * problem.derivative_scale
        self.sigma = 1 / (norm**2 * np.where(widest > 0, widest, 1.0))

    def xi(self, v):
        problem = self.problem
        xi = to_xi(np.where(problem.mask, v, 3.0), problem.xi, problem.field.cos_alpha)
        return xi / problem.xi_median

    def curvature(self, x, intensity):
        """(∂I/∂ξ)²."""
        return (2 * intensity / (self.problem.photometry.gamma * x)) ** 2

    @property
    def v(self):
        problem = self.problem
        return from_xi(self.x * problem.xi_median, problem.xi, problem.field.cos_alpha)

    def step(self, theta):
        problem = self.problem
        where = (self.problem.mask, self.problem.cuts)
        # normals of the last map
        p = gradient(self.v, *where, edge_order=1)
        for _ in range(2):
            p = [patch_means(q, problem.mask, self.radius) for q in p]
        intensity, _, by_slant = problem.photometry.shade(
            self.v, slant(*p, problem.field), problem.field.cos_alpha
        )
        # dual ascent
        operator, adjoint = OPERATORS[problem.regulariser]
        bound = problem.lam * problem.edge_weight
        self.q = self.q + self.sigma * problem.derivative_scale * operator(
            self.ahead, *where
        )
        self.q = self.q / (1 + self.sigma * problem.epsilon / bound)
        self.q = self.q / np.maximum(1, np.linalg.norm(self.q, axis=0) / bound)
        pull = problem.derivative_scale * adjoint(self.q, *where)
        # data
        residual = intensity - problem.image
        slope = (
            (-2 if problem.xi == "d" else 2)
            * intensity
            / (problem.photometry.gamma * self.x)
        )
        weight = 1 / np.maximum(1, np.abs(residual) / problem.threshold)
        curvature = weight * slope**2
        self.limit = np.minimum(
            2 * self.safety / (1 + self.gain(p, intensity, by_slant) ** 2), 0.999
        )
        theta = np.minimum(
            theta * self.pace / BALANCE, self.limit / (1 - self.limit) / curvature
        )
        a = self.x - theta * weight * residual * slope / (1 + theta * curvature)
        # primal descent
        new = (self.x - self.pace * pull + self.pace * a / theta) / (
            1 + self.pace / theta
        )
        new = np.clip(new, 0.5 * self.x, 2 * self.x)
        self.ahead = 2 * new - self.x
        self.x = new

    def gain(self, p, intensity, by_slant):
        guu, guv, gvv = np.moveaxis(self.problem.field.inverse_metric, -1, 0)
        turn = -self.problem.photometry.gamma * by_slant / intensity
        sizes = [patch_sizes(self.problem.mask, self.radius, axis) for axis in (1, 0)]
        passes = [np.minimum(1, 1.5 / size) for size in sizes]
        along = (
            np.abs(guu * p[0] + guv * p[1]) * passes[0]
            + np.abs(guv * p[0] + gvv * p[1]) * passes[1]
        )
        return turn * along
