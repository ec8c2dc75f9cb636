"""What is tuned: the position of all knobs, and the frame or the scene that they call for."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from endolab.frames.frame import Frame
from endolab.frames.nominal import nominal_calibration
from endolab.io.images import read_frame
from endolab.io.settings import SolvingSettings
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import FloatArray
from endolab.reconstruction.settings import LENGTHS, Settings
from endolab.synthetic.rendering import render
from endolab.synthetic.scenes import SCENES

# Knobs of energy, light's law and unit: light that bounced and contours stay while these are turned.
FOLLOWED = (
    *LENGTHS,
    "lam",
    "regulariser",
    "xi",
    "epsilon",
    "threshold",
    "k",
    "gamma",
    "gain",
    "lamp_x",
    "lamp_y",
    "fov",
    "solver",
    "max_iterations",
)

# Options beside the defaults, by what the page calls them.
PRESETS: dict[str, dict[str, Any]] = {
    "default": {},
    "paper": {
        "channel": "green",
        "solver": "primal_dual",
        "regulariser": "second",
        "contours": False,
        "highlights": "keep",
    },
    "fastest": {"channel": "green", "solver": "fast_marching"},
}


@dataclass(frozen=True)
class Knobs(Settings):
    """One position of all the knobs: the options of a reconstruction, and what is looked at."""

    width: int = 320  # columns of the frame, px
    # Rendered and looked at; or the number of a picture, 0 for the frame that the tuner was given.
    scene: str | int = "colon"
    noise: float = 0.0  # of a rendered frame: standard deviation, grey levels of 255
    # What the solver believes of light spread and response; None: as calibrated. A frame is
    # rendered by the calibration, whatever the solver believes.
    k: float | None = None
    gamma: float | None = None
    gain: float = 1.0  # that the solver believes in, over the true one
    lamp_x: float | None = None  # mm, of one lamp in place of those that are listed
    lamp_y: float | None = None
    fov: float | None = (
        None  # of a nominal camera, degrees across what it shows; None: as it is
    )
    # Of the wall, red, green, blue, that it believes in.
    albedo: Sequence[float] | None = None
    # Rectangles that are no wall: left, top, right, bottom, in widths and heights of the frame.
    left_out: Sequence[Sequence[float]] = field(default_factory=list)  # as JSON has them

    def __post_init__(self) -> None:
        """Options are checked when they are solved with: what is wrong is said as all else that is."""

    def follows(self, other: Knobs) -> bool:
        """Whether what the machine found of light and contours stays, from the other position to this."""
        followed = {name: getattr(self, name) for name in FOLLOWED}
        return replace(other, **followed) == self

    def endoscope(self, known: Calibration) -> Calibration:
        """Return a calibration with the field of view that is believed in."""
        if self.fov is None:
            return known
        camera: Any = known.camera
        wider = self.fov / known.evidence["camera"]["fov"]
        camera = replace(camera, fx=camera.fx / wider, fy=camera.fy / wider)
        stated = {"camera": {"nominal": True, "fov": self.fov}}
        return replace(known, camera=camera, evidence=known.evidence | stated)

    def calibration_of(self, subject: Subject) -> Calibration:
        """Return camera and light of a subject's endoscope as the solver believes in them."""
        known = self.endoscope(subject.calibration)
        return self.solving_settings(subject).apply(known)

    def solving_settings(self, subject: Subject) -> SolvingSettings:
        """Say the same as settings that ``endolab reconstruct --settings`` takes.

        They are for a frame of the subject's size; of the light they hold what the solver believes otherwise
        than the calibration.
        """
        known = subject.calibration
        chosen = Settings(**self.as_dict()).as_dict()  # checked now
        grey = subject.frame.image.ndim == 2
        chosen["channel"] = self.channel or ("grey" if grey else "green")
        chosen["width"] = min(self.width, known.camera.width)
        light: dict[str, Any] = {
            "k": self.k,
            "gamma": self.gamma,
            "albedo": self.albedo,
        }
        if (self.lamp_x, self.lamp_y) != (None, None):
            light["lamps"] = [[self.lamp_x or 0.0, self.lamp_y or 0.0]]
        if known.photometry.gain is not None and self.gain != 1:
            light["gain"] = known.photometry.gain * self.gain
        return SolvingSettings(_without_none(chosen), _without_none(light))


def _without_none(values: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}


@dataclass(frozen=True, eq=False)
class Subject:
    """A frame as the solver gets it."""

    frame: Frame
    calibration: Calibration  # of the frame's size, as it is; not as the solver believes
    truth: FloatArray | None = None  # true distance, (H, W), mm; nan where unknown
    path: Path | None = None  # of the picture that it was read from


class Source:
    """Where subjects come from; remembers the last few.

    Scenes are rendered by the calibration; `pictures` are frames to choose among, of which `frame` is the
    first, and `truth`, (H, W), mm, is of it. Raises ValueError if they are not of one size.
    """

    def __init__(
        self,
        calibration: Calibration,
        frame: Frame | None = None,
        truth: FloatArray | None = None,
        pictures: Sequence[Path] = (),
    ) -> None:
        self.calibration = calibration
        self.pictures = list(pictures)
        if truth is not None:
            shape = None if frame is None else frame.mask.shape
            if truth.shape != shape:
                raise ValueError(f"truth has shape {truth.shape}, the frame {shape}")
            # Comparisons with nan, where it is unknown, are false.
            if not np.any(truth > 0) or np.any(truth <= 0) or np.any(np.isinf(truth)):
                raise ValueError("truth must be positive, or nan where it is unknown")
        self._given: Subject | None = None
        if frame is not None:
            known = calibration.fit(frame.name, frame.width, frame.height)
            self._given = Subject(frame, known, truth, next(iter(pictures), None))
        self._making = threading.Lock()
        self._made = lru_cache(3)(self._make)

    def subject(self, knobs: Knobs) -> Subject:
        """The frame that the knobs call for; OSError or ValueError, in one sentence, if there is none."""
        scene = knobs.scene
        rendered = (knobs.width, knobs.noise) if isinstance(scene, str) else ()
        with self._making:  # two threads that ask at once get the same subject
            return self._made(scene, rendered, tuple(map(tuple, knobs.left_out)))

    def _make(self, scene: str | int, rendered: Any, left_out: Any) -> Subject:
        if isinstance(scene, str):
            subject = self._render(scene, *rendered)
        elif self._given is None:
            raise ValueError("there is no frame to look at: choose a scene")
        else:
            subject = self._open(scene) if scene else self._given
        if not left_out:
            return subject
        frame = subject.frame
        mask = frame.selection.pixels.copy()
        row, column = np.ogrid[: frame.height, : frame.width]
        x, y = (column + 0.5) / frame.width, (row + 0.5) / frame.height
        for left, top, right, bottom in left_out:
            mask &= (x < left) | (x > right) | (y < top) | (y > bottom)
        if not mask.any():
            raise ValueError(
                "the rectangles leave nothing of the frame; press U to undo the last"
            )
        return replace(subject, frame=replace(frame, mask=mask))

    def _open(self, number: int) -> Subject:
        path = self.pictures[number]
        known = self.calibration
        stated = known.evidence.get("camera", {})
        if stated.get("nominal"):  # each size has a camera: its own, if no other is known
            own = nominal_calibration(read_frame(path), stated["fov"]).camera
            known = replace(known, others=(own, *known.others, known.camera))
        frame = read_frame(path, known)
        known = known.fit(frame.name, frame.width, frame.height)
        return Subject(frame, known, path=path)

    def _render(self, scene: str, width: int, noise: float) -> Subject:
        whole = self.calibration.camera
        height = max(1, round(whole.height * width / whole.width))
        camera = whole.resize(width, height)
        # As a picture file holds it, so that an export is what is shown.
        light = self.calibration.photometry
        shown = render(SCENES[scene], camera, light, noise=noise, bits=16)
        known = replace(self.calibration, camera=camera, photometry=shown.photometry)
        return Subject(Frame(shown.image, shown.mask, scene), known, shown.distance)
