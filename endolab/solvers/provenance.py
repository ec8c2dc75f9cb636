"""Where a surface comes from: facts that no solver needs, and that reports and the next solve do.

Each stage of a reconstruction adds its own. Sentences are made of them in `reconstruction.sentences`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from enum import Enum
from typing import Any

from endolab.numerics.arrays import FloatArray


@dataclass(frozen=True)
class PreparationReport:
    """How one channel of a frame became a problem."""

    frame: str  # its name
    picture_size: tuple[int, int]  # columns and rows of the frame that was given, px
    channel: str
    width: int  # of the problem, px
    height: int
    smooth: float  # standard deviation of the Gaussian that averaged the light first, px
    highlights: str  # what was done with them
    # Share of the mask that was given which lies beyond what the endoscope shows.
    misplaced: float = 0.0
    # Of picture, mask and endoscope: equal for equal ones.
    fingerprint: str = field(default="", repr=False)


class LightOutcome(Enum):
    """What became of light that bounced from wall to wall."""

    REMOVED = "removed, by what the colours say"
    COMPUTED = "removed, as the surface and albedos predict it; the colours do not tell how much there is"
    NONE_BOUNCED = "the colours show none"
    NO_COLOUR = "left in, since the colours tell nothing of it"
    GREY = "left in, since the picture is grey"


@dataclass(frozen=True)
class LightReport:
    """What was found of indirect light."""

    outcome: LightOutcome
    reason: str = ""  # why the colours tell nothing, or are not believed
    albedo: tuple[float, ...] = ()  # of the wall in red, green and blue
    given: bool = False  # whether the calibration told these albedos
    percent: tuple[
        float, ...
    ] = ()  # medians of indirect over direct light in red, green and blue
    factor: float = 0.0  # indirect light over what surface and albedos predict
    lamp: float = 0.0  # share of k that is the lamp's, the rest being the lens's


class ContourOutcome(Enum):
    """What became of occluding contours, and what decided that."""

    NOT_ASKED = "not looked for"
    GIVEN = "as given"
    NONE_CLEAR = "none is clear"
    BY_ENERGY = "energy"
    BY_COLOURS = "colour evidence"
    AS_BEFORE = "as before"


@dataclass(frozen=True)
class SearchedPicture:
    """The picture in which contours were looked for: the frame without indirect light, as then known."""

    indirect_ratio: FloatArray  # ι, (h, w, 3)
    albedo: FloatArray  # (3,)
    share: float = 1.0  # of `min_steepness`: its contours are so much less steep


@dataclass(frozen=True)
class ContourReport:
    """Where the surface is cut."""

    outcome: ContourOutcome
    steps: int = 0  # between neighbours that are cut
    # Of log d₀ per 1/320 of the longer side; None if nothing is cut.
    min_steepness: float | None = None
    searched: SearchedPicture | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True)
class Scale:
    """What fixed the unit of distances, other than the gain of the endoscope."""

    by: str  # "known distance", "known diameter", "median distance", or "frame before" of a video
    # As it was given: mm, (mm, column, row) or (mm, (column, row), (column, row)).
    length: Any = None
    by_gain: float | None = None  # what the gain says of that length, mm


@dataclass(frozen=True)
class Provenance:
    """What was asked for and done on the way from a frame to a surface; None of what was not done."""

    # Options by name, of the surface that counts.
    asked: Mapping[str, object] = field(default_factory=dict)
    preparation: PreparationReport | None = None
    light: LightReport | None = None
    contours: ContourReport | None = None
    scale: Scale | None = None

    @property
    def albedo(self) -> tuple[float, ...] | None:
        """Of the wall, with which indirect light was removed; None if none was."""
        removed = (LightOutcome.REMOVED, LightOutcome.COMPUTED)
        return (
            self.light.albedo
            if self.light is not None and self.light.outcome in removed
            else None
        )

    @property
    def channel(self) -> str | None:
        """The channel that was solved: "separated" if it is made of all three colours."""
        of_three = (LightOutcome.REMOVED, LightOutcome.COMPUTED, LightOutcome.NONE_BOUNCED)
        if self.light is not None and self.light.outcome in of_three:
            return "separated"  # made of all three, indirect light removed
        return None if self.preparation is None else self.preparation.channel

    @property
    def settings(self) -> dict[str, object]:
        """What was asked for and done, by name, as reports list it."""
        done: dict[str, object] = {}
        if self.preparation is not None:
            done = asdict(self.preparation)
            del done["fingerprint"]
        if self.contours is not None:
            done["contours"] = self.contours.steps > 0
        if self.albedo is not None:
            done["albedo"] = list(self.albedo)
        if self.scale is not None and self.scale.length is None:
            done["scale"] = self.scale.by
        elif self.scale is not None:
            done[self.scale.by.replace(" ", "_")] = self.scale.length
        if self.scale is not None and self.scale.by_gain is not None:
            done["by_gain"] = self.scale.by_gain
        return {**self.asked, **done, "channel": self.channel}
