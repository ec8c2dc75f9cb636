"""What figures, recordings and the tuner share: colours, each map's words, palette and limits, lengths."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from endolab.numerics.arrays import FloatArray
from endolab.solvers.result import Iterate, Result

Colour = tuple[int, int, int]  # R, G, B of 255


# Colours that colour-blind readers can tell apart: Okabe and Ito's, "Color universal design", 2008.
COLOURS = {
    "black": "#000000",
    "orange": "#E69F00",
    "sky": "#56B4E9",
    "green": "#009E73",
    "yellow": "#F0E442",
    "blue": "#0072B2",
    "vermilion": "#D55E00",
    "purple": "#CC79A7",
}
# The same as R, G, B of 255.
OKABE_ITO: Any = SimpleNamespace(
    **{name: tuple(bytes.fromhex(code[1:])) for name, code in COLOURS.items()}
)
# What determined a pixel, as `endolab.reconstruction.uncertainty` numbers it from 1, and its colour.
SOURCE_COLOURS: dict[str, Colour] = {
    "data": OKABE_ITO.blue,
    "border or contour": OKABE_ITO.orange,
    "prior": OKABE_ITO.purple,
}


@dataclass(frozen=True)
class Scale:
    """How a map of numbers is shown, whoever draws it.

    `unit` is None if it is that of distances; `palette` is Matplotlib's name; `kind` says how colours follow
    values and where they end, see `limits`.
    """

    title: str
    unit: str | None
    palette: str
    kind: Literal["log", "linear", "from 0", "signed"]


MAPS = {
    "distance": Scale("Distance", None, "viridis", "log"),
    "model - frame": Scale("Model - frame", "grey levels of 255", "RdBu_r", "signed"),
    "error": Scale("Error", "%", "RdBu_r", "signed"),
    "spread over λ": Scale("Spread over λ", "%", "magma", "from 0"),
    "bounced light": Scale("Bounced light", "%", "magma", "from 0"),
    "σ": Scale("σ of the distance", "%", "magma", "from 0"),
    "σ of rays": Scale("σ of rays, a common turn apart", "mrad", "viridis", "from 0"),
    "σ of μ′": Scale("σ of the fall-off μ′", "%", "viridis", "from 0"),
    "any": Scale("", "1", "viridis", "linear"),
}


def limits(name: str, *maps: FloatArray) -> tuple[float, float]:
    """Where the colours of one of `MAPS` end, such that they suit several maps, nan where unknown.

    Of a scale through or from 0 where 98 % of the values' sizes lie within, of others at the 1st and 99th
    percentile; of nothing at 1.
    """
    seen = np.concatenate([values[np.isfinite(values)] for values in maps])
    seen = seen if seen.size else np.ones(1)
    kind = MAPS[name].kind
    if kind in ("signed", "from 0"):
        end = float(np.percentile(np.abs(seen), 98)) or 1.0
        return (-end if kind == "signed" else 0.0), end
    low, high = np.percentile(seen, [1, 99]).tolist()
    if kind == "log":
        low = max(low, 1e-3 * high)
    return low, max(high, low + 0.01 * abs(low))


def truth_for(surface: Iterate | Result, truth: FloatArray) -> FloatArray:
    """The truth on a surface's grid, in its unit; nan where either is unknown."""
    from endolab.metrics.depth_errors import resample_truth  # takes half a second

    same = resample_truth(truth, surface.mask.shape)
    same[~surface.mask | (same <= 0)] = np.nan
    metric = surface.problem.metric
    return same if metric else same * np.nanmedian(surface.distance / same)


def palette(name: str) -> NDArray[np.uint8]:
    """Colours of one of `MAPS`, from its lower limit to its upper one: (256, 4), R, G, B, A."""
    from matplotlib import colormaps

    return colormaps[MAPS[name].palette](np.arange(256), bytes=True)


def in_colour(picture: FloatArray) -> FloatArray:
    """Give a picture, (h, w) or (h, w, 3), three channels."""
    return np.repeat(picture[..., None], 3, axis=-1) if picture.ndim == 2 else picture


def three_digits(value: float) -> str:
    """Write three digits, 1000 rather than 1e+03."""
    return f"{float(f'{value:.3g}'):g}"


def brighten(picture: FloatArray) -> FloatArray:
    """Brighten a frame, in [0, 1], that is seen from the side: the far end of a lumen is dark in any."""
    most = max(float(np.percentile(picture, 99)), 1e-6)
    return np.asarray((picture / most).clip(0, 1) ** 0.6)
