"""The linear answer of a surface to a small change of its picture.

With J the model's derivatives by v = log d, W the data's weights and R the regulariser's parabolas,

    H = Jᵀ W J + R,        δv = H⁻¹ Jᵀ W δI.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from endolab.numerics.arrays import FloatArray
from endolab.numerics.compiled import inner, pad_maps
from endolab.numerics.resampling import nearest_pixels, resample_cuts
from endolab.numerics.stencils import CENTRAL, Differences, links
from endolab.solvers.energy import model_image
from endolab.solvers.grid import Grid
from endolab.solvers.multigrid import Multigrid
from endolab.solvers.normal_equations import WEIGHT, Coefficients
from endolab.solvers.problem import Problem
from endolab.solvers.result import Iterate


class Linearised:
    """The model at a map v = log d of a problem; maps are (H, W), 0 outside the mask.

    H x = b is solved until so much of the residual is left, a tenth of what draws scatter by, or for so many
    steps.
    """

    accuracy = (3e-2, 15)

    def __init__(self, problem: Problem, log_distance: FloatArray) -> None:
        self.problem = problem
        self.v = np.where(problem.mask, log_distance, 0.0)
        self.grid = Grid.of(problem)
        found, _ = self.grid.equations_at(pad_maps(self.v), problem.lam)
        # Pixels that the solver holds beneath their ceiling are as free to be wrong as others.
        self.coefficients = Coefficients(found.parts, self.grid.structure(self.grid.free))
        self.multigrid = Multigrid(self.coefficients)
        model = model_image(problem, self.v)
        self.model = np.where(problem.mask, model, 0.0)  # I of the surface
        self.by_light = self.model / problem.photometry.gamma  # ∂I by the light's logarithm
        # A row of J is a + b·∇, ∇ being the mean of the differences to both sides; W is 0 where the picture
        # says nothing.
        self.differences = Differences(links(problem.mask, problem.cuts), CENTRAL)
        self.by_v, by_u, by_w, self.weight = inner(found.parts[: WEIGHT + 1])
        self.by_slope = np.stack([by_u, 0 * by_u, by_w])

    def apply(self, x: FloatArray) -> FloatArray:
        """J x: how the picture changes with v."""
        return self.by_v * x + (self.by_slope * self.differences.apply(x)).sum(axis=0)

    def adjoint(self, y: FloatArray) -> FloatArray:
        """Jᵀ y."""
        return self.by_v * y + self.differences.adjoint(self.by_slope * y)

    def solve(self, b: FloatArray) -> FloatArray:
        """H⁻¹ b."""
        b = pad_maps(np.where(self.problem.mask, b, 0.0))
        return inner(self.multigrid.solve(b, *self.accuracy)[0]).copy()

    def to_picture(self, change: FloatArray) -> FloatArray:
        """How v answers to a change of the picture, of stored values."""
        return self.solve(self.adjoint(self.weight * change))

    def to_light(self, change: FloatArray) -> FloatArray:
        """How v answers to a change of the light's logarithm.

        What is common to all pixels moves all of them alike, as ξ̃ goes with it.
        """
        mask = self.problem.mask
        common = float(np.median(change[mask]))
        by_shape = np.where(mask, self.by_light * (change - common), 0.0)
        return self.to_picture(by_shape) - 0.5 * common * mask

    def in_light(self, change: FloatArray | float) -> FloatArray:
        """A change of the picture as one of its light's logarithm."""
        return change / np.maximum(self.by_light, 1e-6)


def on_fewer_pixels(iterate: Iterate, most: int = 400) -> Iterate:
    """The same at the nearest of fewer pixels, so many rows and columns at most.

    σ is as smooth as textures, which go with the width.
    """
    problem = iterate.problem
    old = problem.mask.shape
    height, width = (round(size * min(1.0, most / max(old))) for size in old)
    nearest = nearest_pixels(old, (height, width))
    smaller = replace(
        problem,
        image=problem.image[nearest],
        mask=problem.mask[nearest],
        evidence=None if problem.evidence is None else problem.evidence[nearest],
        cuts=None if problem.cuts is None else resample_cuts(problem.cuts, (height, width)),
        camera=problem.camera.resize(width, height),
        picture=None,
        seen=None,
    )
    return Iterate.of(smaller, iterate.log_distance[nearest])


def far_end_moves(iterate: Iterate, moved: FloatArray) -> float:
    """How much farther the farthest twentieth comes if log d changes by that, (H, W); the median stays."""
    mask = iterate.mask
    far = mask & (iterate.distance >= np.percentile(iterate.distance[mask], 95))
    return float(np.expm1(np.median(moved[far]) - np.median(moved[mask])))


def far_end_by_gamma(iterate: Iterate, change: float) -> float:
    """How much farther the farthest twentieth comes if γ grows, as a fraction; the median stays."""
    few = on_fewer_pixels(iterate, 160)
    light = change * np.log(
        np.maximum(few.problem.image, 0.5 / 255)
    )  # of I^γ, its logarithm
    return far_end_moves(few, Linearised(few.problem, few.log_distance).to_light(light))
