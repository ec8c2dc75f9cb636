"""Checks of notebook 07: light that bounces from wall to wall, and light that is mirrored."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from endolab.course.verdict import Wrong, numbers, verdict
from endolab.datasets.traced import TracedSample
from endolab.model.interreflection import Walls
from endolab.numerics.arrays import BoolArray, FloatArray

ALBEDOS = (0.1, 0.3, 0.5, 0.75)  # on which a function is tried
MIRRORED = 0.2  # of the rest of green: a pixel where more than that is mirrored counts as such
CLOSE = 1e-3  # what another order of sums may do to a share


def _bounced_once(walls: Walls, a: float) -> dict[str, float]:
    """Share of the bounced light that has bounced once, at "", and what slips make of it, at what to say."""
    sent = a * walls.lit
    landed, total = walls.exchange @ sent, walls.bounced(a)
    once, everything = landed.sum(), total.sum()
    return {
        "": once / everything,
        "A share lies between 0 and 1, and yours is in per cent.": 100 * once / everything,
        "That is all that has bounced over what has bounced once: turn it round.": everything / once,
        "A wall sends out only the share $a$ of what it gets: where is the albedo?": once / a / everything,
        "That is what the walls send out; let `walls.exchange` hand it on to the others.": (
            sent.sum() / everything
        ),
        "That is what has bounced twice: one exchange is enough.": (
            (walls.exchange @ (a * landed)).sum() / everything
        ),
        "That is a share of all light. `walls.lit` has not bounced: leave it out of what you divide by.": (
            once / (walls.lit.sum() + everything)
        ),
        "That is the rest, which has bounced more than once.": 1 - once / everything,
        "Row i of `walls.exchange` is what patch i gets from the others: it stands before the light.": (
            (sent @ walls.exchange).sum() / everything
        ),
    }


@verdict
def exercise_1(once: Callable[[Walls, float], float], walls: Walls) -> str:
    """Look at a function that says which share of the bounced light has bounced once.

    Parameters
    ----------
    once : callable
        Takes walls and their albedo, and returns the share.
    walls : Walls
        Those to try it on.

    Returns
    -------
    Verdict
    """
    answers = [once(walls, a) for a in ALBEDOS]
    if any(np.size(answer) != 1 for answer in answers):
        raise Wrong("One number for an albedo, please: add up the light of all patches.")
    found = np.array(answers, dtype=float).ravel()
    told = [_bounced_once(walls, a) for a in ALBEDOS]
    for said in told[0]:
        if np.allclose(found, [one[said] for one in told], rtol=CLOSE):
            if said:
                raise Wrong(said)
            return (
                f"{found[0]:.0%} at an albedo of {ALBEDOS[0]:g}, {found[-1]:.0%} at {ALBEDOS[-1]:g}: "
                "counting one bounce is enough for dark walls only."
            )
    raise Wrong(
        "Not yet. Think of walls that are nearly black: what bounces twice is dimmed twice, so nearly all "
        f"has bounced once. Yours says {found[0]:.2f} at an albedo of {ALBEDOS[0]:g}."
    )


def _shares(mirrored: BoolArray, found: BoolArray) -> FloatArray:
    """Which share of what is mirrored was found, and which of what was found is mirrored."""
    both = (mirrored & found).sum()
    return np.array([both / mirrored.sum(), both / found.sum()])


@verdict
def exercise_2(shares: tuple[float, float], sample: TracedSample, found: BoolArray) -> str:
    """Look at how good a mask of highlights is said to be.

    Parameters
    ----------
    shares : two floats
        Which share of the mirrored pixels was found, and which share of those that were found is mirrored.
    sample : TracedSample
        The frame, with its light taken apart.
    found : (H, W) bool array
        The mask.

    Returns
    -------
    Verdict
    """
    answer = numbers(shares, 2, "Two numbers: which share was found, and which share is right.")
    mirror, direct = sample.mirrored, sample.direct[..., 1]
    rest = direct + sample.indirect[..., 1]
    mirrored = mirror > MIRRORED * rest
    right = _shares(mirrored, found)
    if np.allclose(answer, right, atol=CLOSE):
        return f"{right[0]:.0%} of what is mirrored was found; {right[1]:.0%} of what was found is mirrored."
    slips = {
        "Shares lie between 0 and 1, and yours are in per cent.": 100 * right,
        "You have the two the wrong way round.": right[::-1],
        "The rest is all that is not mirrored: light that bounced belongs to it, too.": _shares(
            mirror > MIRRORED * direct, found
        ),
        "A fifth of the *rest*, of which the mirrored light is no part.": _shares(
            mirror > MIRRORED * (rest + mirror), found
        ),
        "Shares of what is mirrored and of what was found, not of the whole picture.": np.full(
            2, (mirrored & found).mean()
        ),
        "You count dark pixels that both leave dark. Nearly all are, so that says little.": np.full(
            2, (mirrored == found).mean()
        ),
    }
    for said, wrong in slips.items():
        if np.allclose(answer, wrong, atol=CLOSE):
            raise Wrong(said)
    which = int(np.argmax(np.abs(answer - right)))
    name = ("what was found of the mirrored", "what is right of the found")[which]
    much = "large" if answer[which] > right[which] else "small"
    raise Wrong(f"Not yet: the share of {name} is too {much}.")
