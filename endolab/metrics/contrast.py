"""How much of a picture's contrast a surface explains, by which λ can be chosen without the truth."""

from collections.abc import Sequence

import numpy as np

from endolab.frames.frame import ROUNDING
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import check_kinds
from endolab.numerics.noise import mean_weight, noise_level
from endolab.solvers.energy import contradicts, model_image
from endolab.solvers.problem import Problem
from endolab.solvers.result import Iterate, Result

# What the largest λ that does not smooth too much still explains: 1, 1 and 0.1 are λ that were found so
# on the demo's colon, on C3VD and on an in-vivo sinus, and the truth of the first two agrees.
# `tests/benchmarks/lam.py` measures the rule; 0.985 and 0.995 do as well.
ENOUGH_CONTRAST = 0.99


@check_kinds(result=Result)
def explained_contrast(result: Result) -> float:
    """Return the fraction of the picture's variance that the surface explains, noise left out.

    It is of the picture that is solved, averaged where it is noisy, and falls as λ grows: what is smoothed
    away is no longer explained.

    Parameters
    ----------
    result : Result

    Returns
    -------
    float
        1 where all but noise is explained; 0 or less where nothing is.
    """
    residual = residual_of(result.iterate)
    return explained_share(result.problem, residual, noise_left(result)[0])


def residual_of(iterate: Iterate) -> FloatArray:
    """Model minus picture, (H, W), stored values; nan where the picture says nothing against the model."""
    problem = iterate.problem
    residual = model_image(problem, iterate.log_distance) - problem.image
    return np.where(contradicts(problem, residual), residual, np.nan)


def noise_left(result: Result | Iterate) -> tuple[float, float]:
    """Standard deviation of the picture's noise, and the blur, px, that it was given since."""
    shown = result.problem.shown
    green = shown if shown.ndim == 2 else shown[..., 1]
    level = max(noise_level(green, result.mask), ROUNDING)
    smooth = result.report.smooth
    return level * mean_weight(smooth), smooth


def explained_share(problem: Problem, residual: FloatArray, noise: float) -> float:
    """Return what `explained_contrast` does.

    With r what the model is brighter than the picture I, and σ the noise that is in both, it is

        1 - max(var(r) - σ², 0) / (var(I) - σ²)

    over the pixels that can contradict the model; `residual` is r there and nan elsewhere.
    """
    compared = problem.mask & np.isfinite(residual)
    contrast = float(np.var(problem.image[compared])) - noise**2 if compared.any() else 0.0
    if contrast <= 0:
        return 1.0
    return 1 - max(float(np.var(residual[compared])) - noise**2, 0.0) / contrast


def suggest_lam(
    lams: Sequence[float], explained: Sequence[float]
) -> tuple[float | None, bool]:
    """Return the largest λ that still explains enough, 99 % of the contrast, and whether more might.

    Between two λ the explained contrast is taken to be linear in log λ.

    Parameters
    ----------
    lams : sequence of float
        λ that were tried, in any order.
    explained : sequence of float
        What each explains, as `explained_contrast` returns it.

    Returns
    -------
    lam : float or None
        None if no λ explains enough, as where tissue is wet, or the light another.
    at_least : bool
        Whether the greatest λ tried explains enough: a larger one may do as well.
    """
    order = np.argsort(lams)
    tried = np.log(np.asarray(lams, float))[order]
    excess = np.asarray(explained, float)[order] - ENOUGH_CONTRAST
    enough = np.flatnonzero(excess >= 0)
    if not len(enough):
        return None, False
    last = int(enough[-1])
    if last == len(tried) - 1:
        return float(np.exp(tried[last])), True
    part = excess[last] / (excess[last] - excess[last + 1])
    return float(np.exp(tried[last] + part * (tried[last + 1] - tried[last]))), False
