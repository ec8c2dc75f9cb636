"""What is tuned: the position of all knobs, and the frame or the scene that they call for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from endolab.frames.frame import Frame, check_size
from endolab.io.settings import SolvingSettings
from endolab.model.endoscope import Calibration
from endolab.model.schema import unknown_name
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import check_int
from endolab.reconstruction.settings import Settings
from endolab.synthetic.rendering import render
from endolab.synthetic.scenes import SCENES


@dataclass(frozen=True)
class Knobs(Settings):
    """One position of all the knobs: the options of a reconstruction, and what is looked at."""

    width: int = 320  # columns of the frame, px
    # Rendered and looked at; None: the frame that the tuner was given.
    scene: str | None = "colon"
    noise: float = 0.0  # of a rendered frame: standard deviation, grey levels of 255
    # What the solver believes of light spread and response; None: as calibrated. A frame is
    # rendered by the calibration, whatever the solver believes.
    k: float | None = None
    gamma: float | None = None
    gain: float = 1.0  # that the solver believes in, over the true one
    # Of the wall, red, green, blue, that it believes in.
    albedo: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        # Options are checked when they are solved with, and what is wrong then is shown as all else that is.
        if self.max_iterations is not None:
            check_int("max_iterations", self.max_iterations)
        if self.albedo is not None and np.shape(self.albedo) != (3,):
            raise ValueError(
                f"albedo must be three numbers, of red, green and blue, got {self.albedo}"
            )

    @property
    def explained_picture(self) -> tuple[object, ...]:
        """What tells the picture that is explained: data terms of the same can be compared."""
        return (
            self.scene,
            self.noise,
            self.width,
            self.channel,
            self.smooth,
            self.highlights,
        )

    def size(self, known: Calibration) -> tuple[int, int]:
        """Columns and rows of a scene that is rendered by a calibration, px."""
        return self.width, max(
            1, round(known.camera.height * self.width / known.camera.width)
        )

    def solving_settings(self, known: Calibration, grey: bool) -> SolvingSettings:
        """Say the same as settings that ``endolab reconstruct --settings`` takes.

        They are for a frame, which may be `grey`, and its calibration; of the light they hold what the
        solver believes otherwise than the calibration.
        """
        chosen = self.as_dict()
        chosen["channel"] = self.channel or ("grey" if grey else "green")
        chosen["width"] = min(self.width, known.camera.width)
        light = {"k": self.k, "gamma": self.gamma, "albedo": self.albedo}
        if known.photometry.gain is not None and self.gain != 1:
            light["gain"] = known.photometry.gain * self.gain
        given = (
            {name: value for name, value in some.items() if value is not None}
            for some in (chosen, light)
        )
        return SolvingSettings(*given)

    def code(self, calibration: Calibration, grey: bool) -> str:
        """Three lines of Python that make the same result with the tuner's calibration.

        They need the names `el` (endolab), `replace` (of dataclasses), `calibration` and, if no
        scene is rendered, `frame`, which may be `grey`; they leave `result`.
        """
        saved = self.solving_settings(calibration, grey)
        source = "calibration"
        frame = "frame"
        lines = []
        if self.scene is not None:
            camera = "calibration.camera.resize({}, {})".format(*self.size(calibration))
            lit = f"calibration.photometry, noise={self.noise!r}"
            lines = [f"view = el.render(el.SCENES[{self.scene!r}], {camera}, {lit})"]
            source = "view"
            frame = "el.Frame(view.image, view.mask)"
        light = [
            f"{name}={saved.photometry[name]!r}"
            for name in ("k", "gamma")
            if name in saved.photometry
        ]
        if self.gain != 1 and (self.scene is not None or "gain" in saved.photometry):
            light.append(f"gain={source}.photometry.gain * {self.gain!r}")
        if self.albedo is not None:
            light.append(f"brdf=el.Lambertian({self.albedo!r})")
        photometry = (
            f"replace({source}.photometry, {', '.join(light)})"
            if light
            else f"{source}.photometry"
        )
        lines.append(f"known = el.Calibration({source}.camera, {photometry})")
        given = ", ".join(f"{name}={value!r}" for name, value in saved.keywords.items())
        return "\n".join([*lines, f"result = el.reconstruct({frame}, known, {given})"])


@dataclass(frozen=True)
class Subject:
    """A frame as the solver gets it."""

    frame: Frame
    calibration: Calibration  # of the frame's size, as it is; not as the solver believes
    truth: FloatArray | None = None  # true distance, (H, W), mm; nan where unknown

    @property
    def grey(self) -> bool:
        """Whether the frame has one channel."""
        return self.frame.image.ndim == 2


class Source:
    """Where subjects come from; remembers the last few.

    Scenes are rendered by the calibration; `truth`, (H, W), mm, is of the frame. Raises ValueError
    if they are not of one size.
    """

    def __init__(
        self,
        calibration: Calibration,
        frame: Frame | None = None,
        truth: FloatArray | None = None,
    ) -> None:
        if frame is not None:
            check_size(frame.name, (frame.width, frame.height), calibration.camera)
        if truth is not None:
            if frame is None or truth.shape != frame.mask.shape:
                size = (
                    "and there is no frame"
                    if frame is None
                    else f"the frame {frame.mask.shape}"
                )
                raise ValueError(f"truth has shape {truth.shape}, {size}")
            if truth.dtype.kind not in "fiu" or (truth <= 0).any() or np.isinf(truth).any():
                raise ValueError(
                    "truth must be positive and finite, or nan where it is unknown"
                )
        self.calibration = calibration
        self.frame = frame
        self.truth = truth
        self._rendered = lru_cache(6)(self._render)  # the last six scenes

    def subject(self, settings: Knobs) -> Subject:
        """The frame that the settings call for; ValueError, in one sentence, if there is none."""
        if settings.scene is not None:
            return self._rendered(
                settings.scene, settings.size(self.calibration), settings.noise
            )
        if self.frame is None:
            raise ValueError("there is no frame to look at: choose a scene")
        return Subject(self.frame, self.calibration, self.truth)

    def _render(self, scene: str, size: tuple[int, int], noise: float) -> Subject:
        if scene not in SCENES:
            raise unknown_name("scene", scene, SCENES)
        camera = self.calibration.camera.resize(*size)
        shown = render(SCENES[scene], camera, self.calibration.photometry, noise=noise)
        known = replace(self.calibration, camera=camera, photometry=shown.photometry)
        return Subject(Frame(shown.image, shown.mask, scene), known, shown.distance)
