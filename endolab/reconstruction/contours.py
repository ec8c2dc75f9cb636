"""Where the surface is torn, by the vote of the energy.

A contour that is really there lets the picture be explained by a much smoother surface; a vessel or
a stain that is taken for one saves little. So lines of the picture (`preprocessing.contours`) are
opened one batch after the other, the steepest first, on a small copy of it, each time from the surface
before: what lies behind an open line comes loose only as far as the energy wants. The batch with which
energy and price are least is what the surface is torn at, at full size, again from the smooth one.

A start on the torn side would not do: regions that are held by little stay as far as they are put.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace

import cv2
import numpy as np

from endolab.depth.gauss_newton import gauss_newton
from endolab.depth.problem import AT_LEAST, EXACT, NONE, Problem
from endolab.depth.result import Iterate, Result, staged
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.preprocessing.contours import find_contours
from endolab.preprocessing.frame import Frame
from endolab.reconstruction.problem_setup import LEAST_SIDE, noted, on_grid, remarked

SMOOTH, VOTE, CONTOURS = "smooth", "vote", "contours"  # stages
WIDTH = 160  # px; of the picture that is put to the vote
STEEPNESS = (0.2, 0.14, 0.1, 0.07)  # of the lines that are opened: log d₀ per 1/320 of the width
STEPS = 6  # for each of them
# Share of the smooth surface's energy that a cut as long as the picture's height must save: one that is asked
# for or that something else speaks for, and one for which only the energy does, so that gentle folds of a
# real phantom stay whole.
PRICE, UNASKED = 0.06, 0.1


def small(problem: Problem) -> Problem:
    """Return the problem of a smaller picture, without cuts; the problem itself if it is small enough."""
    camera = problem.camera
    height = round(camera.height * WIDTH / camera.width)
    if camera.width <= WIDTH or height < LEAST_SIDE:
        return problem if problem.cuts is None else replace(problem, cuts=None)
    most = max(1.0, float(problem.image.max()))  # direct light merged of colours may be brighter than a frame
    frame = Frame(problem.image / most, problem.mask).resize(WIDTH, height, problem.photometry.gamma)
    evidence = None
    if problem.evidence is not None:

        def mostly(kind: int) -> BoolArray:
            share = (problem.mask & (problem.evidence == kind)).astype(np.float64)
            return np.asarray(cv2.resize(share, (WIDTH, height), interpolation=cv2.INTER_AREA)) > 0.5

        evidence = np.select([mostly(NONE), mostly(AT_LEAST)], [NONE, AT_LEAST], EXACT).astype(np.int8)
    camera = camera.resize(WIDTH, height)
    mask = frame.mask & camera.field.valid
    return replace(
        problem,
        image=most * frame.image,
        mask=mask,
        camera=camera,
        evidence=evidence,
        cuts=None,
        picture=None,
    )


def price_of(cuts: BoolArray, mask: BoolArray, price: float = PRICE) -> float:
    """What cuts must save, as a share of the energy of the smooth surface."""
    return price * float(cuts.sum()) * mask.shape[1] / float(mask.sum())


def voted(
    problem: Problem, smooth: Iterate, always: bool, number: int, price: float = UNASKED
) -> Generator[Iterate, None, float | None]:
    """How steep a line must be to be torn; None if tearing does not pay, unless it must `always` be."""
    tried = small(problem)
    steepness = find_contours(tried.log_facing, tried.mask)
    start = yield from staged(
        gauss_newton(tried, start=on_grid(smooth, tried), max_iterations=STEPS), VOTE, number
    )
    whole, best, least, count = start.energy, None, np.inf if always else 1.0, 0
    for steep in STEEPNESS:
        cuts = steepness > steep
        if cuts.sum() == count:
            continue
        count = int(cuts.sum())
        solver = gauss_newton(replace(tried, cuts=cuts), start=start.log_distance, max_iterations=STEPS)
        start = yield from staged(solver, VOTE, number)
        cost = start.energy / whole + price_of(cuts, tried.mask, PRICE if always else price)
        if cost < least:
            best, least = steep, cost
    return best


def torn_at(problem: Problem, steep: float) -> Problem:
    """Tear the surface at all lines that are so steep, if there are any."""
    cuts = find_contours(problem.log_facing, problem.mask) > steep
    return replace(problem, cuts=cuts if cuts.any() else None)


def steepness_of(problem: Problem) -> float | None:
    """How steep the lines are, at least, at which a problem's surface is torn; None if it is not."""
    if problem.cuts is None:
        return None
    least = float(find_contours(problem.log_facing, problem.mask)[problem.cuts].min(initial=np.inf))
    return max(least * (1 - 1e-9), STEEPNESS[-1])


def pays(torn: Iterate, smooth: Iterate, price: float = UNASKED) -> bool:
    """Whether a torn surface's cuts save this price."""
    cuts = torn.problem.cuts
    return cuts is None or torn.energy / smooth.energy + price_of(cuts, torn.mask, price) < 1


def torn_where_it_pays(
    problem: Problem,
    smooth: Iterate,
    always: bool = False,
    steps: int = 30,
    number: int = 0,
    price: float = UNASKED,
) -> Generator[Iterate, None, Iterate]:
    """Solve again with the surface torn, if that pays; or else return the `smooth` surface.

    The iterates are yielded, those of the vote and those of the problem. With `always`, it need not pay.
    """
    steep = yield from voted(problem, smooth, always, number, price)
    torn = problem if steep is None else torn_at(problem, steep)
    if torn.cuts is None:
        return smooth
    found = yield from staged(
        gauss_newton(torn, start=smooth.log_distance, max_iterations=steps), CONTOURS, number
    )
    return found if always or found.energy < smooth.energy else smooth


def judged(
    problem: Problem, contours: bool | None, before: Result | None = None
) -> Generator[Iterate, None, tuple[Problem, FloatArray | None]]:
    """Tear the surface of one channel where contours are found in its picture, before it is solved.

    `contours` says whether to, by default if that explains the picture much better. Lines as steep as those
    of an earlier result, `before`, are torn without asking. Returns the problem, and log d (H, W) to begin
    with, or None.
    """
    if problem.cuts is not None or contours is False:
        return problem, None
    begin = None
    if before is not None:
        steep = steepness_of(before.problem)
    else:
        smooth = yield from staged(gauss_newton(small(problem)), SMOOTH)
        steep = yield from voted(problem, smooth, bool(contours), 0)
    if steep is not None:
        problem = torn_at(problem, steep)
    if before is None and problem.cuts is not None:
        begin = on_grid(smooth, problem)
    return remarked_on_contours(problem), begin


def remarked_on_contours(problem: Problem) -> Problem:
    """Say whether contours were found, and what became of them."""
    if problem.cuts is None:
        sentence = "No contour was torn: a smooth surface explains the picture as well."
    else:
        count = int(problem.cuts.sum())
        sentence = (
            f"The surface is torn along {count} px of contours, where folds seem to hide what is behind "
            "them: so it explains the picture better."
        )
    return noted(remarked(problem, sentence), contours=problem.cuts is not None)
