"""Where the lamps are: as few of them as explain frames that were not fitted to.

A lamp beside the lens shows where the sheet is near: 1 mm of it moves the light there, d away and α off the
axis, by 4 sin α / d or so. One lamp is sought from the lens; two about the one, in the direction that what it
leaves tells: from elsewhere they would end in a minimum that is hardly more than a mirror image.
"""

from typing import Literal

import numpy as np

from endolab.calibration.least_squares import Fit, fit, hold_out, is_better
from endolab.calibration.photometric.identifiability import left_of_light, regress
from endolab.calibration.photometric.model import LightModel
from endolab.numerics.arrays import FloatArray

Lamps = Literal["auto", "centre", "one", "two"]
LAMPS = ("centre", "one", "two")  # by their number
WAYS = 3.0 * np.array([[1, 0], [0, 1], [1, 1]])  # mm, of pairs that try how two lamps lie


def choose_lamps(
    model: LightModel, centred: Fit, wanted: Lamps
) -> tuple[LightModel, Fit, dict[str, float]]:
    """Fit as many lamps as are wanted, from the fit of one at the lens.

    Returns their model and fit, and the root mean square residual, grey levels, of frames held out by each
    number that auto tried.
    """
    models = [model.with_lamps(lamps) for lamps in range(len(LAMPS))]
    fits = [centred]
    if wanted != "centre":
        begin = np.insert(centred.common, 2, [0.0, 0.0])
        fits.append(fit(models[1], begin, centred.own))
        apart = _halves(models[1], models[2], fits[1])
        # Nearer to each other, mm, they pass for one; to try them takes long.
        if wanted == "two" or (wanted == "auto" and np.linalg.norm(apart) > 1.5):
            fits.append(fit(models[2], _pair(fits[1].common, apart), fits[1].own))
    _, frame = np.unique(model.samples.frame, return_inverse=True)
    best = len(fits) - 1
    rms = {}
    if wanted == "auto":
        best = 0
        held = []
        for lamps, fitted in enumerate(fits):
            squares, off = hold_out(models[lamps], fitted, frame, centred.sigma)
            held.append(squares)
            rms[LAMPS[lamps]] = off
            if is_better(squares, than=held[best]):
                best = lamps
    return models[best], fits[best], rms


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
    pairs = [two.shine(_pair(fitted.common, way), fitted.own)[0] - light for way in WAYS]
    left, weight = left_of_light(one, fitted)
    known = np.column_stack([*pairs, columns[:, one.sd > 0]])
    shares = regress(one, left, known, weight)[0][: len(WAYS)]
    lengths, axes = np.linalg.eigh(np.einsum("i,ia,ib->ab", shares, WAYS, WAYS))
    return np.sqrt(max(lengths[-1], 1.0)) * axes[:, -1]
