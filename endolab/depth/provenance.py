"""Where a problem comes from: no solver needs it, what is made and said of a result does."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Scale:
    """What fixed the unit of distances, other than the gain of the endoscope."""

    by: str  # "known distance", "known diameter", "median distance", or "frame before" of a video
    length: Any = None  # as it was given: mm, (mm, column, row) or (mm, (column, row), (column, row))
    by_gain: float | None = None  # what the gain says of that length, mm


@dataclass(frozen=True)
class Provenance:
    """What was asked for and done on the way from a frame to a problem, and to the unit of its answer."""

    settings: dict[str, object] = field(default_factory=dict)  # asked for and done, as reports list it
    notes: tuple[str, ...] = ()  # sentences about what was done on the way
    picture_size: tuple[int, int] | None = None  # columns and rows of the frame that was given
    smooth: float = 0.0  # standard deviation of the Gaussian that the light was averaged with first, px
    albedo: tuple[float, ...] | None = None  # of the wall, with which indirect light was removed
    # Bounced light's share ι (h, w, 3) and albedos (3,) of the picture in which contours were looked for.
    searched: tuple[FloatArray, FloatArray] | None = None
    bar: float | None = None  # steepness of log d₀ over which lines of the picture are torn, if any is
    scale: Scale | None = None
