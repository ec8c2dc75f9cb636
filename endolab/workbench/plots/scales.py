"""Scales that figures share with recordings and the tuner, of NumPy alone: of colours and of lengths."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from endolab.numerics.arrays import FloatArray

Colour = tuple[int, int, int]  # R, G, B of 255


@dataclass(frozen=True)
class Palette:
    """Colours that colour-blind readers can tell apart: Okabe and Ito's, "Color universal design", 2008."""

    black: Colour = (0, 0, 0)
    orange: Colour = (230, 159, 0)
    sky: Colour = (86, 180, 233)
    green: Colour = (0, 158, 115)
    yellow: Colour = (240, 228, 66)
    blue: Colour = (0, 114, 178)
    vermilion: Colour = (213, 94, 0)
    purple: Colour = (204, 121, 167)


OKABE_ITO = Palette()
# What determined a pixel, as `endolab.reconstruction.uncertainty` numbers it from 1, and its colour.
SOURCE_COLOURS = {
    "data": OKABE_ITO.blue,
    "border or contour": OKABE_ITO.orange,
    "prior": OKABE_ITO.purple,
}
# Of 255: grey levels of model - frame at which a recording's colours end.
LARGEST_RESIDUAL = 10.0


def blue_white_red(values: FloatArray) -> NDArray[np.uint8]:
    """Map -1…1 to blue, white, red: (...) to (..., 3); what lies beyond is as dark as the ends."""
    colours = [[0, 68, 136], [110, 170, 220], [255, 255, 255], [250, 150, 90], [153, 26, 0]]
    nodes = np.linspace(-1, 1, len(colours))
    channels = [np.interp(values, nodes, channel) for channel in np.array(colours, float).T]
    return np.round(np.stack(channels, axis=-1)).astype(np.uint8)


def _known_values(maps: Iterable[FloatArray]) -> FloatArray:
    return np.concatenate([np.empty(0), *(values[np.isfinite(values)] for values in maps)])


def common_limits(maps: Iterable[FloatArray]) -> tuple[float, float]:
    """Limits that suit several maps: 1st and 99th percentile of all their values, 0 and 1 of none.

    Parameters
    ----------
    maps : iterable of arrays of one unit; nan where unknown
    """
    seen = _known_values(maps)
    return (
        (float(np.percentile(seen, 1)), float(np.percentile(seen, 99)))
        if seen.size
        else (0.0, 1.0)
    )


def common_limit(errors: Iterable[FloatArray]) -> float:
    """Limit that suits several maps of signed errors: 98th percentile of all their sizes, 1 if that is 0.

    Parameters
    ----------
    errors : iterable of arrays of one unit; nan where unknown
    """
    seen = np.abs(_known_values(errors))
    limit = float(np.percentile(seen, 98)) if seen.size else 1.0
    return limit if limit > 0 else 1.0


def in_colour(picture: FloatArray) -> FloatArray:
    """Give a picture, (h, w) or (h, w, 3), three channels."""
    return np.repeat(picture[..., None], 3, axis=-1) if picture.ndim == 2 else picture


def round_length(length: float) -> float:
    """Round down to 1, 2 or 5 times a power of ten."""
    power = 10 ** np.floor(np.log10(length))
    return float(
        max(power * factor for factor in (1, 2, 5) if power * factor <= length * (1 + 1e-9))
    )


def tallness(shape: tuple[int, ...]) -> float:
    """Height of a picture's panel over its width: the picture's own, but at most 2, that a page stays one."""
    return min(shape[0] / shape[1], 2.0)


def brighten(picture: FloatArray) -> FloatArray:
    """Brighten a frame, in [0, 1], that is seen from the side: the far end of a lumen is dark in any."""
    return np.asarray(
        (picture / max(float(np.percentile(picture, 99)), 1e-6)).clip(0, 1) ** 0.6
    )
