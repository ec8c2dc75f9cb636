"""Checks of notebook 09: what a recording tells of a run, and what it does not."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from endolab.course.verdict import Wrong, verdict
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.recording.reader import Recording

SETTLED = 0.01  # share of where it ends, within which a pixel has arrived
CURVES = ("energy", "data", "change")
CLOSE = 1e-3  # what is the same number
AS_NEAR = 1.01  # errors of two iterations that are as good as equal


def _same(one: float, other: float) -> bool:
    return bool(np.isclose(one, other, rtol=CLOSE, atol=1e-12))


def _away(run: Recording, k: int) -> BoolArray:
    """Pixels that at an iteration are not yet where they end."""
    return np.abs(run.depth(k) / run.depth() - 1) > SETTLED


@verdict
def exercise_1(last: BoolArray, moved: float, run: Recording) -> str:
    """Look at which pixels are said to arrive last, and how far they are said to move in the last step.

    Parameters
    ----------
    last : (H, W) bool array
        Pixels that arrive with the last step.
    moved : float
        Median of the sizes of their last step, mm.
    run : Recording
        One run, with a picture of its last two iterations.

    Returns
    -------
    Verdict
    """
    step = np.abs(run.depth() - run.depth(run.pictured[-2]))
    right = _away(run, run.pictured[-2])
    found = np.asarray(last)
    if found.shape != right.shape:
        raise Wrong(f"`last` should be a map of {right.shape} pixels; its shape is {found.shape}.")
    if found.dtype != bool:
        raise Wrong("`last` should say yes or no of each pixel: compare the map with the last iteration.")
    slips = {
        "Those are the others, which had already arrived, with what lies beyond the mask.": ~right,
        "Those are the others, which had already arrived.": run.mask & ~right,
        "There is no wall beyond the mask: nan is unlike all numbers.": right | ~run.mask,
        "Those are all that are on their way after the *first* step: look at the last.": (
            _away(run, run.pictured[1]) if len(run.pictured) > 3 else right
        ),
        "One per cent of the distance, not a hundredth of a millimetre.": step > SETTLED,
        "Those arrive with the last step but one.": (
            _away(run, run.pictured[-3]) & ~right if len(run.pictured) > 2 else right
        ),
    }
    if not np.array_equal(found, right):
        for said, wrong in slips.items():
            if np.array_equal(found, wrong):
                raise Wrong(said)
        raise Wrong(
            f"Not yet: {found.sum()} pixels, of which {(found & right).sum()} are right, and "
            f"{(right & ~found).sum()} are missing. `arrived` has the iteration of each."
        )
    _judge_step(float(moved), step, right, run.depth())
    rows, columns = np.nonzero(right)
    return (
        f"{right.sum()} pixels, {right.sum() / run.mask.sum():.1%} of the wall, in rows {rows.min()} to "
        f"{rows.max()} and columns {columns.min()} to {columns.max()}: by {moved:.2f} mm, where half of the "
        f"wall moves by less than {np.nanmedian(step):.3f} mm."
    )


def _judge_step(moved: float, step: FloatArray, last: BoolArray, distance: FloatArray) -> None:
    """Raise what is wrong with the median of the last step, of the pixels that arrive with it."""
    of = step[last]
    right = float(np.median(of))
    slips = {
        "That is its negative: the wall comes nearer, but the size is asked for.": -right,
        "That is the mean; the median is asked for.": float(np.mean(of)),
        "That is the largest step; the median is asked for.": float(np.max(of)),
        "That is the median of the whole wall: take those pixels only.": float(np.nanmedian(step)),
        "That is a share of the distance; millimetres are asked for.": float(np.median(of / distance[last])),
        "Those are metres.": right / 1000,
    }
    if _same(moved, right):
        return
    for said, wrong in slips.items():
        if _same(moved, wrong):
            raise Wrong(said)
    raise Wrong(
        f"The pixels are right. Their last step is not {moved:.3g} mm: which two maps do you compare?"
    )


@verdict
def exercise_2(nearest: int, tellers: Iterable[str], run: Recording, true: FloatArray) -> str:
    """Look at which iteration is said to be nearest to the truth, and which curves are said to mark it.

    Parameters
    ----------
    nearest : int
        The iteration, of those with pictures.
    tellers : names
        Those of energy, data and change that have a turn there; none, if none has.
    run : Recording
        One run.
    true : (H, W) float array
        True distances, mm.

    Returns
    -------
    Verdict
    """
    error = _judge_nearest(nearest, run, true)
    named = [tellers] if isinstance(tellers, str) else list(tellers)
    if unknown := set(named) - set(CURVES):
        raise Wrong(f"There is no {unknown.pop()!r} among {', '.join(CURVES)}.")
    table, k = run.table(), int(nearest)
    turns = [name for name in CURVES if not _falls(table[name][k // 2 : 2 * k + 1])]
    if false := [name for name in named if name not in turns]:
        before, at, after = (table[false[0]][i] for i in (k // 2, k, 2 * k))
        raise Wrong(
            f"Iteration {k} it is, but look at {false[0]}: {before:.2g}, {at:.2g}, {after:.2g} at iterations "
            f"{k // 2}, {k} and {2 * k}. It falls on and on: what would you have seen there?"
        )
    if missed := [name for name in turns if name not in named]:
        raise Wrong(f"Iteration {k} it is, but {missed[0]} does have a turn between {k // 2} and {2 * k}.")
    told = f"Iteration {k}, {100 * error.min():.1f} % off; at the end it is {100 * error[-1]:.1f} %. "
    return told + (f"Marked by {', '.join(turns)}." if turns else "No curve that the solver has marks it.")


def _judge_nearest(nearest: int, run: Recording, true: FloatArray) -> FloatArray:
    """Give the mean error of each iteration that has a picture; raise what is wrong with the least."""
    pictured, table = np.array(run.pictured), run.table()
    shares = np.stack([np.abs(run.depth(k) / true - 1) for k in run.pictured])
    error = np.asarray(np.nanmean(shares, axis=(1, 2)), dtype=np.float64)
    best = int(error.argmin())
    if nearest in pictured[error <= AS_NEAR * error[best]]:
        return error
    slips = {
        "That is its place among those with pictures: `pictured` has the iteration itself.": best,
        "That is where the energy is least. The error is meant, of which the solver knows nothing.": (
            table["iteration"][table["energy"].argmin()]
        ),
        "That is the iteration farthest from the truth.": pictured[error.argmax()],
        "That is where the largest error is least; the mean of all pixels is meant.": (
            pictured[np.nanmax(shares, axis=(1, 2)).argmin()]
        ),
    }
    for said, wrong in slips.items():
        if nearest == wrong:
            raise Wrong(said)
    if nearest not in pictured:
        raise Wrong(f"Iteration {nearest} has no picture, so nobody knows its error.")
    raise Wrong(
        f"Not yet: the mean error of iteration {nearest} is {100 * error[pictured == nearest][0]:.1f} %, "
        f"and there is one of {100 * error[best]:.1f} %."
    )


def _falls(curve: FloatArray) -> bool:
    return bool(np.all(np.diff(curve) < 0))
