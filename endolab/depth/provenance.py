"""Where a problem comes from: no solver needs it, what is made and said of a result does."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

from endolab.numerics.arrays import FloatArray


@dataclass(frozen=True)
class Scale:
    """What fixed the unit of distances, other than the gain of the endoscope."""

    by: str  # "known distance", "known diameter", "median distance", or "frame before" of a video
    length: Any = None  # as it was given: mm, (mm, column, row) or (mm, (column, row), (column, row))
    by_gain: float | None = None  # what the gain says of that length, mm


class Searched(NamedTuple):
    """The picture in which contours were looked for: the frame without light that bounced, as then known."""

    indirect_ratio: FloatArray  # ι, (h, w, 3)
    albedo: FloatArray  # (3,)
    share: float = 1.0  # of a bar, over which its lines are as steep as those that the bar is told for


@dataclass(frozen=True)
class Provenance:
    """What was asked for and done on the way from a frame to a problem, and to the unit of its answer."""

    settings: dict[str, object] = field(default_factory=dict)  # asked for and done, as reports list it
    notes: tuple[str, ...] = ()  # sentences about what was done on the way
    picture_size: tuple[int, int] | None = None  # columns and rows of the frame that was given
    smooth: float = 0.0  # standard deviation of the Gaussian that the light was averaged with first, px
    albedo: tuple[float, ...] | None = None  # of the wall, with which indirect light was removed
    given_albedo: tuple[float, ...] | None = None  # the same, as the calibration told it
    searched: Searched | None = field(default=None, compare=False, repr=False)
    bar: float | None = None  # steepness of log d₀ over which lines of the picture are torn, if any is
    scale: Scale | None = None
