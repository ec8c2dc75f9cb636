"""Where the lamps are: as few of them as explain frames that were not fitted to.

A lamp beside the lens shows where the sheet is near: 1 mm of it moves the light there, d away and α off the
axis, by 4 sin α / d or so. One lamp is sought from the lens; two, of which a pair and its mirror image leave
about as much, from several pairs about the one.
"""

from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np

from endolab.calibration import least_squares
from endolab.calibration.least_squares import OUTLIER, Fit
from endolab.calibration.photometric.model import LightModel
from endolab.numerics.arrays import BoolArray, FloatArray

Lamps = Literal["auto", "centre", "one", "two"]
LAMPS = ("centre", "one", "two")  # by their number
PLACE_SD = 10.0  # mm; what is believed of a lamp's place beforehand
APART = 3.0  # mm, from the one lamp to each of a pair, to begin with
PAIRS = 4  # directions of that
# Samples by which the number of lamps is chosen; of them, one in so many tells which pair to begin with.
FEW = 12000
ONE_IN = 4
FIXED = 1e-9  # standard deviation of what is not to move
# Of a standard error: where a sample's half angle passes a node of the BRDF the cost has a kink, and a finer
# step need never come.
FINEST_STEP = 0.01
PARTS = 2  # of the frames, of which each is held out once
LEAST_FALL = 2.0  # of its own ±, by which more lamps explain frames held out better


fit = partial(least_squares.fit, finest=FINEST_STEP)


def with_lamps(model: LightModel, lamps: int) -> LightModel:
    """Add the places of so many lamps to the unknowns of a model that has its lamp at the lens."""
    names = [f"lamp {number} {axis}" for number in range(1, lamps + 1) for axis in "xy"]
    return replace(
        model,
        mean=np.insert(model.mean, 2, np.zeros(2 * lamps)),
        sd=np.insert(model.sd, 2, np.full(2 * lamps, PLACE_SD)),
        names=[*model.names[:2], *names, *model.names[2:]],
        lamps=lamps,
    )


def choose_lamps(
    model: LightModel, centred: Fit, wanted: Lamps
) -> tuple[LightModel, Fit, dict[str, float]]:
    """Fit as many lamps as are wanted, from the fit of one at the lens.

    Returns their model and fit, and, where they were chosen by frames held out, the root mean square residual
    of these, grey levels, of each that was tried.
    """
    count = len(model.samples)
    few, own = _part(model, centred, np.arange(count) % -(-count // FEW) == 0)
    models = [with_lamps(few, lamps) for lamps in range(len(LAMPS))]
    fits = [fit(few, centred.common, own)]
    for each in models[1:]:
        fits.append(_fit_lamps(each, fits[-1]))
    held_out = {}
    if wanted == "auto":
        limit = (OUTLIER * centred.sigma) ** 2
        squares = np.minimum(list(map(_hold_out, models, fits)), limit)
        held_out = dict(
            zip(LAMPS, np.sqrt(np.nanmean(squares, axis=1)).tolist(), strict=True)
        )
        _, frame = np.unique(few.samples.frame, return_inverse=True)
        best = 0
        for lamps in range(1, len(LAMPS)):
            falls = np.bincount(frame, np.nan_to_num(squares[best] - squares[lamps]))
            if falls.sum() > LEAST_FALL * falls.std() * np.sqrt(len(falls)):
                best = lamps
    else:
        best = LAMPS.index(wanted)
    if best == 0:
        return model, centred, held_out
    model = with_lamps(model, best)
    return model, fit(model, fits[best].common, centred.own), held_out


def _fit_lamps(model: LightModel, before: Fit) -> Fit:
    """Fit lamps, from the fit of one fewer."""
    fewer = before.common[2 : model.of_lamps.stop - 2]
    angles = np.pi / PAIRS * np.arange(PAIRS)
    apart = APART * np.column_stack([np.cos(angles), np.sin(angles)])
    starts = np.hstack([fewer + apart, fewer - apart]) if fewer.size else np.zeros((1, 2))
    rest = before.common[model.of_lamps.stop - 2 :]
    vectors = [np.concatenate([before.common[:2], start, rest]) for start in starts]
    if len(vectors) > 1:
        few, own = _part(model, before, np.arange(len(model.group)) % ONE_IN == 0)
        fits = [fit(few, vector, own, finest=1.0) for vector in vectors]
        vectors = [min(fits, key=lambda each: each.sigma).common]
    return fit(model, vectors[0], before.own)


def _part(
    model: LightModel, fitted: Fit, which: BoolArray
) -> tuple[LightModel, FloatArray]:
    """Return the model of some samples, and the own unknowns of their groups."""
    groups, group = np.unique(model.group[which], return_inverse=True)
    return replace(model, samples=model.samples[which], group=group), fitted.own[groups]


def _hold_out(model: LightModel, fitted: Fit) -> FloatArray:
    """Return the squared residuals, (n,), of frames as the others predict them, but for their gains.

    nan out of the sensor's range.
    """
    _, frame = np.unique(model.samples.frame, return_inverse=True)
    squares = np.full(len(frame), np.nan)
    for part in range(PARTS):
        held = frame % PARTS == part
        known, own = _part(model, fitted, ~held)
        common = fit(known, fitted.common, own).common
        others, own = _part(model, fitted, held)
        fixed = replace(others, mean=common, sd=np.full(len(common), FIXED))
        found = fit(fixed, common, own)
        good = fixed.usable(found.common, found.own)
        squares[held] = np.where(good, found.residual[:, 0] ** 2, np.nan)
    return squares
