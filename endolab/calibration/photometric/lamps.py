"""Where the lamps are: as few of them as explain frames that were not fitted to.

A lamp beside the lens shows where the sheet is near: 1 mm of it moves the light there, d away and α off the
axis, by 4 sin α / d or so. One lamp is sought from the lens; two about the one, in the direction that what it
leaves tells: from elsewhere they would end in a minimum that is hardly more than a mirror image.
"""

from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np

from endolab.calibration import least_squares
from endolab.calibration.least_squares import OUTLIER, Fit
from endolab.calibration.photometric.identifiability import left_of_light, regress
from endolab.calibration.photometric.model import LightModel
from endolab.numerics.arrays import BoolArray, FloatArray

Lamps = Literal["auto", "centre", "one", "two"]
LAMPS = ("centre", "one", "two")  # by their number
PLACE_SD = 10.0  # mm; what is believed of a lamp's place beforehand
APART = 3.0  # mm, of pairs that try in which direction two lamps lie
LEAST_APART = 1.5  # mm from their middle, below which two lamps pass for one
FIXED = 1e-9  # standard deviation of what is not to move
# Of a standard error: where a sample's half angle passes a node of the BRDF the cost has a kink, and a finer
# step need never come.
FINEST_STEP = 0.03
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
    models = [with_lamps(model, lamps) for lamps in range(len(LAMPS))]
    begin = np.insert(centred.common, 2, [0.0, 0.0])
    fits = [centred, fit(models[1], begin, centred.own)]
    apart = _halves(models[1], models[2], fits[1])
    if wanted == "two" or np.linalg.norm(apart) > LEAST_APART:
        fits.append(fit(models[2], _pair(fits[1].common, apart), fits[1].own))
    if wanted != "auto":
        best = LAMPS.index(wanted)
        return models[best], fits[best], {}
    limit = (OUTLIER * centred.sigma) ** 2
    tried = zip(models, fits, strict=False)
    squares = [np.minimum(_hold_out(*each), limit) for each in tried]
    _, frame = np.unique(model.samples.frame, return_inverse=True)
    best = 0
    for lamps in range(1, len(fits)):
        falls = np.bincount(frame, np.nan_to_num(squares[best] - squares[lamps]))
        if falls.sum() > LEAST_FALL * falls.std() * np.sqrt(len(falls)):
            best = lamps
    rms = np.sqrt(np.nanmean(squares, axis=1)).tolist()
    return models[best], fits[best], dict(zip(LAMPS, rms, strict=False))


def _pair(common: FloatArray, apart: FloatArray) -> FloatArray:
    """Return the vector of two lamps, at ± `apart` about the one of a vector."""
    place = common[2:4]
    return np.concatenate([common[:2], place + apart, place - apart, common[4:]])


def _halves(one: LightModel, two: LightModel, fitted: Fit) -> FloatArray:
    """Tell from what one lamp leaves how far to both sides of it two would stand, (x, y), mm, 1 mm at least.

    Two at ± δ change its light by δᵀ H δ. That of three pairs is regressed on what is left; of the matrix δδᵀ
    that comes out δ is the longest axis.
    """
    light, columns = one.shine(fitted.common, fitted.own)
    ways = APART * np.array([[1, 0], [0, 1], [1, 1]])
    pairs = [two.shine(_pair(fitted.common, way), fitted.own)[0] - light for way in ways]
    left, weight = left_of_light(one, fitted)
    known = np.column_stack([*pairs, columns[:, one.sd > 0]])
    shares = regress(one, left, known, weight)[0][: len(ways)]
    lengths, axes = np.linalg.eigh(np.einsum("i,ia,ib->ab", shares, ways, ways))
    return np.sqrt(max(lengths[-1], 1.0)) * axes[:, -1]


def _part(
    model: LightModel, fitted: Fit, which: BoolArray
) -> tuple[LightModel, FloatArray]:
    """Return the model of some samples, and the own unknowns of their groups."""
    groups, group = np.unique(model.group[which], return_inverse=True)
    return replace(model, samples=model.samples[which], group=group), fitted.own[groups]


def _hold_out(model: LightModel, fitted: Fit) -> FloatArray:
    """Return the squared residuals, (n,), of frames as the others predict them, but for their gains.

    nan out of the sensor's range; all are inf if the others cannot predict them.
    """
    _, frame = np.unique(model.samples.frame, return_inverse=True)
    squares = np.full(len(frame), np.nan)
    for part in range(PARTS):
        held = frame % PARTS == part
        known, own = _part(model, fitted, ~held)
        others, held_own = _part(model, fitted, held)
        try:
            common = fit(known, fitted.common, own).common
            fixed = replace(others, mean=common, sd=np.full(len(common), FIXED))
            found = fit(fixed, common, held_own)
        except (ValueError, ArithmeticError):
            return np.full(len(frame), np.inf)
        good = fixed.usable(found.common, found.own)
        squares[held] = np.where(good, found.residual[:, 0] ** 2, np.nan)
    return squares
