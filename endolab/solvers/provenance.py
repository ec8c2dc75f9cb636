"""Where a surface comes from, in numbers and enums, which no solver needs: people and the next solve do.

Each stage of a reconstruction adds its own. Sentences are made of them in `reconstruction.report`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from endolab.model.endoscope import Calibration


class LightOutcome(Enum):
    """What became of light that bounced from wall to wall."""

    REMOVED = "removed"  # by what the colours say
    # Removed, as the surface and albedos predict it: the colours do not tell how much there is.
    COMPUTED = "computed"
    NONE_BOUNCED = "none bounced"  # the colours show none
    NO_COLOUR = "no colour"  # left in, since the colours tell nothing of it
    GREY = "grey"  # left in, since the picture is


class ContourOutcome(Enum):
    """What became of occluding contours, and what decided that."""

    NOT_ASKED = "not asked"
    GIVEN = "given"
    NONE_CLEAR = "none clear"
    BY_ENERGY = "energy"
    BY_COLOURS = "colour evidence"
    BY_LINES = "steep lines"
    AS_BEFORE = "as before"


@dataclass(frozen=True)
class Report:
    """What was asked for and done on the way from a frame to a surface; empty where nothing was done."""

    # Options by name, of the surface that counts.
    asked: Mapping[str, object] = field(default_factory=dict)
    stage: str = (
        ""  # in which the run was stopped, if it was before light and contours were found
    )

    # The picture
    frame: str = ""  # its name
    picture_size: tuple[int, int] | None = (
        None  # columns, rows of the frame that was given, px
    )
    # Of the field of view: "px", columns and rows of the frame, and "degrees", its widest angle.
    field_seen: Mapping[str, Any] = field(default_factory=dict)
    # Of the endoscope, as it was used.
    calibration: Calibration | None = field(default=None, repr=False)
    width: int = 0  # of the problem, px
    height: int = 0
    # "separated" if it is made of all three colours.
    channel: str | None = None
    smooth: float = (
        0.0  # standard deviation of the Gaussian that averaged the light first, px
    )
    highlights: str = ""  # what was done with them
    # Fraction of the mask that was given which lies beyond what the endoscope shows.
    misplaced: float = 0.0
    shown_share: float = 1.0  # fraction of what the endoscope shows that the mask keeps
    box_share: float = 0.0  # fraction of the picture that is a box of one colour, left out
    without_ray: float = (
        0.0  # fraction of what it shows that the camera's model does not reach
    )
    # Of picture and mask: equal for equal ones.
    fingerprint: tuple[str, str] = field(default=("", ""), repr=False)

    # Light that bounced
    light: LightOutcome | None = None
    reason: str = ""  # why the colours tell nothing, or are not believed
    wall_albedo: tuple[float, ...] = ()  # in red, green and blue, as given or found
    albedo_given: bool = False
    # Medians of indirect over direct light in red, green and blue.
    indirect_percent: tuple[float, ...] = ()
    indirect_factor: float = 0.0  # indirect light over what surface and albedos predict
    lamp: float = 0.0  # fraction of k that is the lamp's, the rest being the lens's

    # Where the surface is cut
    contours: ContourOutcome | None = None
    cut_links: int = 0  # between neighbours
    # Of log d₀ per 1/320 of the longer side; None if nothing is cut.
    min_steepness: float | None = None
    # That of lines that would have been cut had misfits been 3 % other, None for none, and how much farther
    # the far end then is, as a fraction; None if the choice was clear.
    other_cut: tuple[float | None, float] | None = None

    # What fixed the unit of distances, other than the gain of the endoscope: "known distance", "known
    # diameter", "median distance", or "frame before" of a video; and that length as it was given.
    scale: str = ""
    length: Any = None
    length_by_gain: float | None = None  # what the gain says of that length, mm

    @property
    def evidence(self) -> dict[str, Any]:
        """Of the endoscope."""
        return {} if self.calibration is None else self.calibration.evidence

    @property
    def nominal(self) -> list[str]:
        """What of the endoscope nobody measured: "camera", "photometry"."""
        parts = ("camera", "photometry")
        return [
            part for part in parts if self.evidence.get(part, {}).get("nominal") is True
        ]

    @property
    def lamps(self) -> tuple[tuple[float, float, float], ...]:
        """x, y, z of the lamps, mm, if they do not stand at the optical centre."""
        return () if self.calibration is None else self.calibration.photometry.lamps_aside

    @property
    def albedo(self) -> tuple[float, ...] | None:
        """Of the wall, with which indirect light was removed; None if none was."""
        removed = self.light in (LightOutcome.REMOVED, LightOutcome.COMPUTED)
        return self.wall_albedo if removed else None

    @property
    def settings(self) -> dict[str, object]:
        """What was asked for and done, by name, as files list it."""
        done: dict[str, object] = {}
        if self.picture_size is not None:
            names = "frame picture_size width height smooth highlights misplaced"
            done = {name: getattr(self, name) for name in names.split()}
        if self.stage:
            done["stage"] = self.stage
        if self.contours is not None:
            done["contours"] = self.cut_links > 0
        if self.lamps:
            done["lamps"] = [list(place) for place in self.lamps]
        if self.albedo is not None:
            done["albedo"] = list(self.albedo)
        if self.scale and self.length is None:
            done["scale"] = self.scale
        elif self.scale:
            done[self.scale.replace(" ", "_")] = self.length
        if self.length_by_gain is not None:
            done["by_gain"] = self.length_by_gain
        return {**self.asked, **done, "channel": self.channel}
