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
from dataclasses import dataclass, replace
from typing import Any

from endolab.depth.gauss_newton import gauss_newton
from endolab.depth.problem import Problem
from endolab.depth.result import Iterate, Result, staged
from endolab.model.endoscope import Endoscope
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.preprocessing.contours import find_contours
from endolab.preprocessing.frame import Frame
from endolab.reconstruction.problem_setup import make_problem, noted, on_grid, remarked, two_sizes

SMOOTH, CONTOURS = "smooth", "contours"  # stages
STEEP = 0.07  # of the lines that are opened, at least: log d₀ per 1/320 of the width
# Share of the smooth surface's energy that a cut as long as the picture's height must save: one that is asked
# for or that something else speaks for, and one for which only the energy does, so that gentle folds of a
# real phantom stay whole.
PRICE, UNASKED = 0.03, 0.1


def price_of(cuts: BoolArray, mask: BoolArray, price: float = PRICE) -> float:
    """What cuts must save, as a share of the energy of the smooth surface."""
    return price * float(cuts.sum()) * mask.shape[1] / float(mask.sum())


def pays(torn: Iterate, smooth: Iterate, price: float = UNASKED) -> bool:
    """Whether a torn surface's cuts save this price."""
    cuts = torn.problem.cuts
    return cuts is not None and torn.energy / smooth.energy + price_of(cuts, torn.mask, price) < 1


def torn_at_contours(problem: Problem) -> Problem:
    """Tear the surface at the picture's contours, if there are any."""
    cuts = find_contours(problem.log_facing, problem.mask) > STEEP
    return replace(problem, cuts=cuts if cuts.any() else None)


def torn_where_it_pays(
    smooth: Iterate, always: bool = False, steps: int = 30, number: int = 0, price: float = UNASKED
) -> Generator[Iterate, None, Iterate]:
    """Solve a problem again with the surface torn, if that pays; or else return the `smooth` surface.

    The iterates are yielded. With `always`, it need not pay.
    """
    torn = torn_at_contours(smooth.problem)
    if torn.cuts is None:
        return smooth
    found = yield from staged(
        gauss_newton(torn, start=smooth.log_distance, max_iterations=steps), CONTOURS, number
    )
    return found if always or pays(found, smooth, price) else smooth


@dataclass(frozen=True)
class OneChannel:
    """One channel of a frame, in full and on as few pixels as the search for contours needs."""

    fine: Problem
    coarse: Problem

    @classmethod
    def of(
        cls, frame: Frame, calibration: Endoscope, channel: str | None, search: bool, **how: Any
    ) -> OneChannel:
        """Prepare it, see `make_problems`; on few pixels only if there is a `search`."""
        if not search:
            fine = make_problem(frame, calibration, channel=channel, **how)
            return cls(fine, fine)
        (fine,), (coarse,) = two_sizes(frame, calibration, [channel], **how)
        return cls(fine, coarse)


def judged(
    channel: OneChannel, contours: bool | None, before: Result | None = None
) -> Generator[Iterate, None, tuple[Problem, FloatArray | None]]:
    """Tear the surface of one channel where contours are found in its picture, before it is solved.

    `contours` says whether to, by default if that explains the picture much better. What was torn in an
    earlier result, `before`, is torn without asking. Returns the problem, and log d (H, W) to begin with, or
    None.
    """
    fine = channel.fine
    if fine.cuts is not None or contours is False:
        return noted(fine, contours=fine.cuts is not None), None
    if before is not None:
        again = before.problem.cuts is not None
        return remarked_on_contours(torn_at_contours(fine) if again else fine), None
    smooth = yield from staged(gauss_newton(channel.coarse), SMOOTH)
    surface = yield from torn_where_it_pays(smooth, bool(contours))
    if surface.problem.cuts is None:
        return remarked_on_contours(fine), None
    torn = torn_at_contours(fine)
    return remarked_on_contours(torn), on_grid(surface, torn)


def remarked_on_contours(problem: Problem) -> Problem:
    """Say whether contours were found, and what became of them."""
    if problem.cuts is None:
        sentence = "No contour was torn: nothing in the picture speaks clearly for one."
    else:
        count = int(problem.cuts.sum())
        sentence = (
            f"The surface is torn along {count} px of contours, where folds seem to hide what is behind them."
        )
    return noted(remarked(problem, sentence), contours=problem.cuts is not None)
