"""Why samples do not count in a fit of the light, and why places of the sheet were not read."""

from collections.abc import Mapping, Sequence

import numpy as np

from endolab.calibration.geometric.pose import Pose
from endolab.calibration.least_squares import CUT
from endolab.calibration.photometric.model import GREY, LEVELS
from endolab.calibration.photometric.samples import (
    FATES,
    MOST,
    READ,
    find_places,
    sample_places,
    window_side,
)
from endolab.calibration.targets import Target
from endolab.model.cameras import Camera
from endolab.numerics.arrays import BoolArray, FloatArray, IntArray

COUNTS, BY_HAND, SATURATED, DARK, BRIGHTER, DARKER = range(6)


def reasons(levels: tuple[float, float] = LEVELS) -> tuple[str, ...]:
    """Say what each number of `why_left_out` stands for."""
    low, high = (f"{GREY * level:.0f}" for level in levels)
    return (
        "count",
        "its frame was left out",
        f"saturated: above {high} grey levels expected",
        f"too dark: below {low} grey levels expected",
        f"brighter than expected: by more than {CUT:g} σ; a glint, or not the sheet",
        f"darker than expected: by more than {CUT:g} σ; ink, dust, a shadow",
    )


def why_left_out(
    measured: FloatArray,
    expected: FloatArray,
    used: BoolArray,
    sigma: float,
    levels: tuple[float, float] = LEVELS,
    by_hand: BoolArray | None = None,
) -> IntArray:
    """Give each sample one number of `reasons`, (n,): 0 if it counted in the fit.

    Parameters
    ----------
    measured, expected : (n,) float array
        Stored values; as of `PhotometricFit.predict`, nan of a frame that the fit was not shown.
    used : (n,) bool array
        Those that counted.
    sigma : float
        Of the residuals, grey levels.
    levels : (low, high)
        As the fit was given them.
    by_hand : (n,) bool array, optional
        Samples of frames that the fit was not shown, though a level is expected of them.

    Notes
    -----
    The fit chooses at the beginning of its last round. A sample that has crossed a border since goes by the
    border that it is nearest to.
    """
    low, high = levels
    noise = max(sigma, 1e-6) / GREY
    with np.errstate(invalid="ignore"):
        off = np.stack([expected - high, low - expected, measured - expected, expected - measured]) / noise
        off[2:] -= CUT  # how far beyond each border, in standard deviations
        why = np.array([SATURATED, DARK, BRIGHTER, DARKER])[np.argmax(off, axis=0)]
        # What should be out of range is not asked whether it is.
        why = np.where(off[0] >= 0, SATURATED, np.where(off[1] >= 0, DARK, why))
    away = ~np.isfinite(expected) if by_hand is None else by_hand | ~np.isfinite(expected)
    return np.where(away, BY_HAND, np.where(used, COUNTS, why))


def places_by_fate(
    target: Target,
    poses: Mapping[str, Sequence[Pose | None]],
    camera: Camera,
    size: tuple[int, int],
    most: int = MOST,
) -> dict[str, int]:
    """Count what became of all places of the sheet in all frames that have poses, in words.

    The counts add up to places times frames. `size` is the frames' width and height, px, `most` as for
    `sample_sheet`.
    """
    spots, _ = sample_places(target)
    counts, spare = np.zeros(len(FATES), int), 0
    for panels in poses.values():
        fate = find_places(spots, target, panels, camera, size, window_side(size[0])).fate
        counts += np.bincount(fate, minlength=len(FATES))
        spare += max(0, int(np.sum(fate == READ)) - most)
    counts[READ] -= spare
    told = {what: int(count) for what, count in zip(FATES, counts, strict=True)}
    return told | {f"one too many: {most} of a frame are enough": spare}
