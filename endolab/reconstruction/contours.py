"""Where the surface is torn: at the picture's steep lines, if the evidence says that it pays.

A contour that is really there lets the picture be explained by a much smoother surface. The steeper a line of
a picture (`preprocessing.contours`), the more likely it is a contour: nine of ten that are steeper than the
first of `BARS` are in traced colons, and six to eight of ten that are steeper than the third; among polyps
these are two or three of ten. Which bar is right for a picture, its colours tell (`separation`). In one
channel the first bar is taken, and the energy tells whether there is anything to be torn at all.

The torn surface begins as the smooth one: what lies behind an open line comes loose only as far as the
energy wants. A start on the torn side would not do: regions that are held by little stay as far as they
are put.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace

import numpy as np

from endolab.depth.gauss_newton import gauss_newton
from endolab.depth.problem import Problem
from endolab.depth.result import Iterate, Result, carrying, staged
from endolab.model.endoscope import Endoscope
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.preprocessing.contours import find_contours
from endolab.preprocessing.frame import Frame
from endolab.reconstruction.problem_setup import (
    PosedProblem,
    Preparation,
    make_problems,
    on_grid,
    two_sizes,
)

TORN_SOLVE_STEPS = 30  # of the solver at most, once the surface is torn
SMOOTH, CONTOURS = "smooth", "contours"  # stages
BARS = (0.07, 0.05, 0.035, 0.025)  # how steep lines must be to be opened: log d₀ per 1/320 of the longer side
ENERGY, THE_COLOURS = "energy", "colour evidence"  # cues that decide on contours
# Share of the smooth surface's energy that a cut as long as the picture's height must save if only the energy
# speaks for it, so that gentle folds of a real phantom stay whole.
PRICE = 0.1
HALFWAY = 1e-9  # share of a pixel within which it is halfway between two


def length_of(discontinuities: BoolArray | None, mask: BoolArray) -> float:
    """How long cuts are, in heights of the picture."""
    return (
        0.0 if discontinuities is None else float(discontinuities.sum()) * max(mask.shape) / float(mask.sum())
    )


def pays(torn: Iterate, smooth: Iterate, price: float = PRICE) -> bool:
    """Whether a torn surface's cuts save this price."""
    return torn.energy / smooth.energy + price * length_of(torn.problem.discontinuities, torn.mask) < 1


def torn_at_contours(problem: Problem, bar: float = BARS[0], lines: FloatArray | None = None) -> Problem:
    """Tear the surface at the picture's lines that are steeper than a bar, if there are any."""
    lines = find_contours(problem.log_facing, problem.mask) if lines is None else lines
    discontinuities = lines > bar
    return replace(problem, discontinuities=discontinuities if discontinuities.any() else None)


def enlarged_cuts(cuts: BoolArray, shape: tuple[int, ...]) -> BoolArray:
    """Cut steps (2, h, w), as `Problem` has them, on more pixels (H, W).

    A pixel halfway between two of the fewer counts as the one nearer to the picture's middle.
    """
    rows, columns = (
        np.floor(fewer / 2 + (1 - HALFWAY) * fewer / more * (np.arange(more) + 0.5 - more / 2)).astype(int)
        for fewer, more in zip(cuts.shape[1:], shape, strict=True)
    )
    enlarged = cuts[:, rows[:, None], columns]
    enlarged[0] &= np.diff(columns, append=columns[-1]) > 0
    enlarged[1] &= np.diff(rows, append=rows[-1])[:, None] > 0
    return enlarged


def torn_where_it_pays(
    smooth: Iterate, always: bool = False, price: float = PRICE
) -> Generator[Iterate, None, Iterate]:
    """Solve a problem again with the surface torn, if that pays; or else return the `smooth` surface.

    The iterates are yielded. With `always`, it need not pay.
    """
    torn = torn_at_contours(smooth.problem)
    if torn.discontinuities is None:
        return smooth
    solver = gauss_newton(torn, start=smooth.log_distance, max_iterations=TORN_SOLVE_STEPS)
    provenance = replace(smooth.provenance, bar=BARS[0])
    surface = yield from staged(carrying(solver, provenance), CONTOURS)
    return surface if always or pays(surface, smooth, price) else smooth


def bar_of(result: Result | Iterate) -> float | None:
    """The bar over which a surface was torn, or None; the first, if its cuts were given."""
    return None if result.problem.discontinuities is None else result.provenance.bar or BARS[0]


@dataclass(frozen=True)
class OneChannel:
    """One channel of a frame, in full and on as few pixels as the search for contours needs."""

    fine: PosedProblem
    coarse: PosedProblem

    @classmethod
    def of(cls, frame: Frame, calibration: Endoscope, preparation: Preparation, search: bool) -> OneChannel:
        """Prepare it; on few pixels only if there is a `search`."""
        channels = [preparation.channel]
        if not search:
            (fine,) = make_problems(frame, calibration, preparation, channels)
            return cls(fine, fine)
        (fine,), (coarse,) = two_sizes(frame, calibration, preparation, channels)
        return cls(fine, coarse)


def choose_bar(
    channel: OneChannel, contours: bool | None, before: Result | None = None
) -> Generator[Iterate, None, tuple[PosedProblem, FloatArray | None]]:
    """Tear the surface of one channel where contours are found in its picture, before it is solved.

    `contours` says whether to, by default if that explains the picture much better. What was torn in an
    earlier result, `before`, is torn without asking. Returns the problem, and log d (H, W) to begin with, or
    None.
    """
    fine, coarse = channel.fine, channel.coarse
    given = fine.problem.discontinuities is not None
    if given or contours is False:
        return fine.noted(contours=given), None
    if before is not None:
        bar = bar_of(before)
        return remarked_on_contours(fine if bar is None else _torn_in_full(fine, bar)), None
    smooth = yield from staged(carrying(gauss_newton(coarse.problem), coarse.provenance), SMOOTH)
    surface = yield from torn_where_it_pays(smooth, bool(contours))
    if surface.problem.discontinuities is None:
        return remarked_on_contours(fine), None
    torn = _torn_in_full(fine, BARS[0])
    return remarked_on_contours(torn), on_grid(surface, torn.problem)


def _torn_in_full(fine: PosedProblem, bar: float) -> PosedProblem:
    return PosedProblem(torn_at_contours(fine.problem, bar), replace(fine.provenance, bar=bar))


def remarked_on_contours(posed: PosedProblem, cue: str = ENERGY) -> PosedProblem:
    """Say whether contours were found, what became of them, and what decided that."""
    discontinuities = posed.problem.discontinuities
    if discontinuities is None:
        sentence = "Contours: none torn, as no line of the picture gives clear evidence."
    else:
        count = int(discontinuities.sum())
        sentence = f"Contours: {count:,} px torn ({cue or 'as before'})."
    return posed.remarked(sentence).noted(contours=discontinuities is not None)
