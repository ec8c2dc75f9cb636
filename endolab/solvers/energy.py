"""The one energy: how well a depth map explains a frame, and how smooth it is.

    E(v) = mean ρ(I_model(v) - I) + λ mean w ‖D ξ(v)/ξ̃‖_ε,        v = log d

ρ is Huber's penalty, D the gradient or the Hessian, ξ̃ the median of ξ at the start d₀, and
derivatives are per 1/320 of the longer side, so that one λ serves all ξ, units and sizes
(paper, Section V; symbols in `notebooks/guides/symbols.md`).

Where the picture leaves a surface free, as at the border of a tube, the regulariser chooses it. What
solvers minimise, recordings show and tests check is this function.

A picture is not always evidence: a saturated pixel says that the surface is at least this bright,
so that its residual counts only where the model is darker, and a highlight or an overlay says
nothing. There the surface is what its neighbours and the regulariser make of it; the mean is
still over all pixels of the mask.

Normals in the model are from central differences of v, and from two pixels where a neighbour
is missing: then the normal equations couple no pixels further apart than the Hessian's do.
"""

import numpy as np

from endolab.model.surface import slant
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.compiled import pad_maps
from endolab.numerics.stencils import central_gradient
from endolab.solvers.grid import Grid
from endolab.solvers.problem import EXACT, LOWER_BOUND, Problem


def model_image(problem: Problem, log_distance: FloatArray) -> FloatArray:
    """The frame (H, W) that a map of v = log d predicts, normals from its gradient; nan outside the mask."""
    v_u, v_v = central_gradient(log_distance, problem.mask, problem.cuts)
    tan2 = slant(v_u, v_v, problem.field)
    light = problem.photometry
    attenuation = light.attenuation(problem.field.cos_alpha)
    predicted = light.brightness(log_distance, tan2, attenuation)
    return np.where(problem.mask, predicted, np.nan)


def contradicts(problem: Problem, residual: FloatArray) -> BoolArray:
    """Where the picture is evidence against a model that is brighter by this residual, (H, W)."""
    if problem.evidence is None:
        return problem.mask
    one_sided = (problem.evidence == LOWER_BOUND) & (
        np.where(problem.mask, residual, 0.0) < 0
    )
    return problem.mask & ((problem.evidence == EXACT) | one_sided)


def energy_terms(problem: Problem, log_distance: FloatArray) -> dict[str, float]:
    """The terms "data" and "regulariser" (λ included), whose sum is the energy, of a map of v = log d."""
    v = pad_maps(np.where(problem.mask, log_distance, 0.0))
    return Grid.of(problem).terms(v, problem.lam)
