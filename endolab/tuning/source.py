"""What is tuned: the position of all knobs, and the frame or the scene that they call for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from endolab.io.settings import SolvingSettings
from endolab.model.brdf import Lambertian
from endolab.model.photometry import Photometry
from endolab.model.schema import unknown_name
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import whole
from endolab.preprocessing.frame import Frame, check_size
from endolab.synthetic.rendering import render
from endolab.synthetic.scenes import SCENES

if TYPE_CHECKING:
    from endolab.model.endoscope import Endoscope

ALWAYS = ("xi", "regulariser", "lam", "epsilon", "solver")  # what `reconstruct` is always told, ...
MAYBE = ("highlights", "contours", "smooth", "max_iterations")  # and if it is said
KEPT = 6  # rendered frames that are remembered


@dataclass(frozen=True)
class Settings:
    """One position of all the knobs; those without a word here are as `reconstruct` takes them."""

    scene: str | None = "colon"  # rendered and looked at; None: the frame that the tuner was given
    noise: float = 0.0  # of a rendered frame: standard deviation, grey levels of 255
    width: int = 320  # columns of the frame, px
    channel: str | None = None  # None: green, or grey of a grey picture
    highlights: str | None = None
    contours: bool | None = None
    smooth: float | None = None  # px
    # What the solver believes of light spread and response; None: as calibrated. A frame is
    # rendered by the calibration, whatever the solver believes.
    k: float | None = None
    gamma: float | None = None
    gain: float = 1.0  # that the solver believes in, over the true one
    albedo: tuple[float, ...] | None = None  # of the wall, red, green, blue, that it believes in
    xi: str = "1/d"
    regulariser: str = "auto"
    lam: float = 1.0
    epsilon: float = 1e-3
    solver: str = "gauss_newton"
    max_iterations: int | None = None

    def __post_init__(self) -> None:
        if self.albedo is not None and len(self.albedo) != 3:
            raise ValueError(f"albedo must be three numbers, of red, green and blue, got {self.albedo}")
        if self.max_iterations is not None:
            whole("max_iterations", self.max_iterations)

    def keywords(self, grey: bool) -> dict[str, Any]:
        """What `reconstruct` is given, of a grey picture or of one in colour."""
        said = {name: getattr(self, name) for name in (*ALWAYS, *MAYBE)}
        said["channel"] = self.channel or ("grey" if grey else "green")
        return {name: value for name, value in said.items() if value is not None}

    def believed(self, photometry: Photometry) -> Photometry:
        """What the solver takes the light to be."""
        beliefs = self._beliefs()
        if photometry.gain is not None:
            beliefs["gain"] = photometry.gain * self.gain
        if self.albedo is not None:
            red, green, blue = self.albedo
            beliefs["brdf"] = Lambertian((red, green, blue))
        return replace(photometry, **beliefs)

    def _beliefs(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in ("k", "gamma") if getattr(self, name) is not None}

    def saved(self, calibration: Endoscope, grey: bool = False) -> SolvingSettings:
        """Say the same as settings that ``endolab reconstruct --settings`` takes.

        They are for a frame, which may be `grey`, and its calibration; of the light they hold what the
        solver believes otherwise than the calibration.
        """
        keywords = self.keywords(grey) | {"width": min(self.width, calibration.camera.width)}
        known = calibration.photometry
        light = self._beliefs()
        if known.gain is not None and self.gain != 1:
            light["gain"] = known.gain * self.gain
        if self.albedo is not None:
            light["albedo"] = self.albedo
        return SolvingSettings(keywords, light)

    def code(self, calibration: Endoscope, grey: bool = False) -> str:
        """Three lines of Python that make the same result with the tuner's calibration.

        They need the names `el` (endolab), `replace` (of dataclasses), `calibration` and, if no
        scene is rendered, `frame`, which may be `grey`; they leave `result`.
        """
        beliefs = [f"{name}={value!r}" for name, value in self._beliefs().items()]
        if self.scene is None:
            source, frame, lines = "calibration", "frame", []
            options = self.keywords(grey) | {"width": min(self.width, calibration.camera.width)}
            has_gain = calibration.photometry.gain is not None
        else:
            width, height = _size(calibration, self.width)
            camera = f"calibration.camera.resize({width}, {height})"
            light = f"calibration.photometry, noise={self.noise!r}"
            lines = [f"view = el.render(el.SCENES[{self.scene!r}], {camera}, {light})"]
            source, frame, has_gain = "view", "el.Frame(view.image, view.mask)", True
            options = self.keywords(not isinstance(_albedo(calibration), tuple))
        if has_gain and self.gain != 1:
            beliefs.append(f"gain={source}.photometry.gain * {self.gain!r}")
        if self.albedo is not None:
            beliefs.append(f"brdf=el.Lambertian({self.albedo!r})")
        photometry = (
            f"replace({source}.photometry, {', '.join(beliefs)})" if beliefs else f"{source}.photometry"
        )
        lines.append(f"known = el.Calibration({source}.camera, {photometry})")
        given = ", ".join(f"{name}={value!r}" for name, value in options.items())
        return "\n".join([*lines, f"result = el.reconstruct({frame}, known, {given})"])


def _albedo(calibration: Endoscope) -> Any:
    return getattr(calibration.photometry.brdf, "albedo", None)


def _size(calibration: Endoscope, width: int) -> tuple[int, int]:
    return width, max(1, round(calibration.camera.height * width / calibration.camera.width))


@dataclass(frozen=True)
class Subject:
    """A frame as the solver gets it."""

    frame: Frame
    calibration: Endoscope  # of the frame's size, as it is; not as the solver believes
    truth: FloatArray | None = None  # true distance, (H, W), mm; nan where unknown
    width: int | None = None  # columns to solve, if they are fewer than the frame's

    @property
    def grey(self) -> bool:
        """Whether the frame has one channel."""
        return self.frame.image.ndim == 2

    def shrunk(self, width: int) -> Subject:
        """The same with fewer columns."""
        size = _size(self.calibration, width)
        known = replace(self.calibration, camera=self.calibration.camera.resize(*size))
        truth = None if self.truth is None else shrunk_map(self.truth, size)
        return Subject(self.frame.resize(*size, self.calibration.photometry.gamma), known, truth)


def shrunk_map(distance: FloatArray, size: tuple[int, ...]) -> FloatArray:
    """Mean of the distances that a pixel of a grid of (width, height) covers, nan if one is unknown."""
    shrunk: FloatArray = cv2.resize(distance, size, interpolation=cv2.INTER_AREA).astype(distance.dtype)
    return shrunk


class Source:
    """Where subjects come from; remembers the last few.

    Scenes are rendered by the calibration; `truth`, (H, W), mm, is of the frame. Raises ValueError
    if they are not of one size.
    """

    def __init__(
        self, calibration: Endoscope, frame: Frame | None = None, truth: FloatArray | None = None
    ) -> None:
        if frame is not None:
            check_size(frame.name, (frame.width, frame.height), calibration.camera)
        if truth is not None and (frame is None or truth.shape != frame.mask.shape):
            size = "and there is no frame" if frame is None else f"the frame {frame.mask.shape}"
            raise ValueError(f"truth has shape {truth.shape}, {size}")
        if truth is not None and (
            truth.dtype.kind not in "fiu" or (truth <= 0).any() or np.isinf(truth).any()
        ):
            raise ValueError("truth must be positive and finite, or nan where it is unknown")
        self.calibration, self.frame, self.truth = calibration, frame, truth
        self._rendered = lru_cache(KEPT)(self._render)
        self._shrunk = lru_cache(KEPT)(self._shrink)

    def subject(self, settings: Settings) -> Subject:
        """The frame that the settings call for; ValueError, in one sentence, if there is none."""
        if settings.scene is not None:
            return self._rendered(settings.scene, settings.width, settings.noise)
        if self.frame is None:
            raise ValueError("there is no frame to look at: choose a scene")
        width = settings.width if settings.width < self.frame.width else None
        return Subject(self.frame, self.calibration, self.truth, width)

    def coarse(self, settings: Settings) -> Subject:
        """The same at half the size."""
        return self._shrunk(settings.scene, settings.width, settings.noise if settings.scene else 0.0)

    def _shrink(self, scene: str | None, width: int, noise: float) -> Subject:
        subject = self.subject(Settings(scene, noise, width))
        return subject.shrunk(min(width, subject.frame.width) // 2)

    def _render(self, scene: str, width: int, noise: float) -> Subject:
        if scene not in SCENES:
            raise unknown_name("scene", scene, SCENES)
        camera = self.calibration.camera.resize(*_size(self.calibration, width))
        shown = render(SCENES[scene], camera, self.calibration.photometry, noise=noise)
        known = replace(self.calibration, camera=camera, photometry=shown.photometry)
        return Subject(Frame(shown.image, shown.mask, scene), known, shown.distance)
