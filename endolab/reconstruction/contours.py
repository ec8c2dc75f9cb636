"""Where the surface is torn: at the picture's steep lines, if the energy says that it pays.

A contour that is really there lets the picture be explained by a much smoother surface. Which of the lines
of a picture (`preprocessing.contours`) are contours, how steep they are tells better than the energy: nine of
ten that are steeper than `STEEP` are in traced colons, and one of two that are a little less so, however much
energy they save. What the energy tells is whether there is anything to be torn at all.

The torn surface begins as the smooth one: what lies behind an open line comes loose only as far as the
energy wants. A start on the torn side would not do: regions that are held by little stay as far as they
are put.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace

from endolab.depth.gauss_newton import gauss_newton
from endolab.depth.problem import Problem
from endolab.depth.result import Iterate, staged
from endolab.numerics.arrays import BoolArray
from endolab.preprocessing.contours import find_contours
from endolab.reconstruction.problem_setup import noted

SMOOTH, CONTOURS = "smooth", "contours"  # stages
STEEP = 0.07  # of the lines that are opened, at least: log d₀ per 1/320 of the width
# Share of the smooth surface's energy that a cut as long as the picture's height must save.
PRICE = 0.05


def price_of(cuts: BoolArray, mask: BoolArray) -> float:
    """What cuts must save, as a share of the energy of the smooth surface."""
    return PRICE * float(cuts.sum()) * mask.shape[1] / float(mask.sum())


def torn_at(problem: Problem, steep: float = STEEP) -> Problem:
    """Tear the surface at all lines that are so steep, if there are any."""
    cuts = find_contours(problem.log_facing, problem.mask) > steep
    return replace(problem, cuts=cuts if cuts.any() else None)


def torn_where_it_pays(
    problem: Problem, smooth: Iterate, always: bool = False, steps: int = 30, number: int = 0
) -> Generator[Iterate, None, Iterate]:
    """Solve again with the surface torn, if that pays; or else return the `smooth` surface.

    The iterates are yielded. With `always`, it need not pay.
    """
    torn = torn_at(problem)
    if torn.cuts is None:
        return smooth
    found = yield from staged(
        gauss_newton(torn, start=smooth.log_distance, max_iterations=steps), CONTOURS, number
    )
    cost = found.energy + price_of(torn.cuts, problem.mask) * smooth.energy
    return found if always or cost < smooth.energy else smooth


def torn(problem: Problem) -> Generator[Iterate, None, Iterate]:
    """Solve a problem smooth, and then torn if the picture has any contours; return the last surface."""
    smooth = yield from staged(gauss_newton(problem), SMOOTH)
    found = yield from torn_where_it_pays(problem, smooth, always=True)
    return replace(found, problem=noted(found.problem, contours=found.problem.cuts is not None))
