"""What the tuner looks at, and how: the position of all knobs, and the frame that they call for."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeVar

import cv2
import numpy as np

from endolab.depth.result import Result
from endolab.model.brdf import Lambertian
from endolab.model.photometry import Photometry
from endolab.model.schema import unknown_name
from endolab.numerics.arrays import FloatArray
from endolab.preprocessing.frame import Frame, check_size
from endolab.reconstruction.scale import KnownDiameter, KnownDistance
from endolab.synthetic.rendering import render
from endolab.synthetic.scenes import SCENES, Scene

if TYPE_CHECKING:
    from endolab.model.endoscope import Endoscope

SHRINK = 2  # a coarse grid has this many times fewer columns, and rows
KEPT = 6  # subjects that are remembered
ALWAYS = ("xi", "regulariser", "lam", "epsilon", "solver")  # what `reconstruct` is always told, ...
MAYBE = (  # and if it is said
    *("highlights", "contours", "smooth", "max_iterations"),
    *("median_distance", "known_distance", "known_diameter"),
)

T = TypeVar("T")


@dataclass(frozen=True)
class Settings:
    """One position of all the knobs; those without a word here are as `reconstruct` takes them."""

    scene: str | None = "colon"  # rendered and looked at; None: the frame that the tuner was given
    noise: float = 0.0  # of a rendered frame: standard deviation, grey levels of 255
    width: int = 320  # columns of the frame, px
    channel: str | None = None  # green, or grey of a grey picture: what a slider can wait for
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
    # A length that fixes the scale, its pixels in columns and rows of the whole frame.
    median_distance: float | None = None
    known_distance: KnownDistance | None = None
    known_diameter: KnownDiameter | None = None

    def __post_init__(self) -> None:
        if self.albedo is not None and len(self.albedo) != 3:
            raise ValueError(f"albedo must be three numbers, of red, green and blue, got {self.albedo}")

    def shrunk(self, factor: float) -> Settings:
        """The same for a frame of so many times fewer columns: the pixels of a length move."""

        def moved(pixel: Any) -> Any:
            return tuple((one + 0.5) / factor - 0.5 for one in pixel)

        lengths: dict[str, Any] = {}
        if self.known_distance is not None:
            lengths["known_distance"] = (self.known_distance[0], *moved(self.known_distance[1:]))
        if self.known_diameter is not None:
            lengths["known_diameter"] = (self.known_diameter[0], *map(moved, self.known_diameter[1:]))
        return replace(self, **lengths)

    def keywords(self, grey: bool) -> dict[str, Any]:
        """What `reconstruct` is given, of a grey picture or of one in colour."""
        channel = self.channel or ("grey" if grey else "green")
        always = {name: getattr(self, name) for name in ALWAYS} | {"channel": channel}
        said = {name: getattr(self, name) for name in MAYBE}
        return always | {name: value for name, value in said.items() if value is not None}

    def believed(self, photometry: Photometry) -> Photometry:
        """What the solver takes the light to be."""
        beliefs = self._beliefs(photometry.gain)
        if self.albedo is not None:
            beliefs["brdf"] = Lambertian(self._three())
        return replace(photometry, **beliefs)

    def _three(self) -> tuple[float, float, float]:
        assert self.albedo is not None
        return self.albedo[0], self.albedo[1], self.albedo[2]

    def _beliefs(self, gain: float | None) -> dict[str, Any]:
        beliefs: dict[str, Any] = {"k": self.k, "gamma": self.gamma}
        beliefs["gain"] = None if gain is None or self.gain == 1 else gain * self.gain
        return {name: value for name, value in beliefs.items() if value is not None}

    def code(self, calibration: Endoscope, grey: bool = False) -> str:
        """Three lines of Python that make the same result with the tuner's calibration.

        They need the names `el` (endolab), `replace` (of dataclasses), `calibration` and, if no
        scene is rendered, `frame`, which may be `grey`; they leave `result`.
        """
        if self.scene is not None:
            grey = not isinstance(getattr(calibration.photometry.brdf, "albedo", None), tuple)
        options = self.keywords(grey)
        if self.scene is None:
            source, gain = "calibration", calibration.photometry.gain
            lines = ["known = calibration"]
            options["width"] = min(self.width, calibration.camera.width)
        else:
            source, gain = "view", 1.0
            width, height = _size(calibration, self.width)
            lines = [
                f"view = el.render(el.SCENES[{self.scene!r}], calibration.camera.resize({width}, {height}), "
                f"calibration.photometry, noise={self.noise!r})",
                "known = el.Calibration(view.camera, view.photometry)",
            ]
        beliefs = [f"{name}={value!r}" for name, value in self._beliefs(None).items()]
        if gain is not None and self.gain != 1:
            beliefs.append(f"gain={self.gain!r} * {source}.photometry.gain")
        if self.albedo is not None:
            beliefs.append(f"brdf=el.Lambertian({self.albedo!r})")
        if beliefs:
            light = f"replace({source}.photometry, {', '.join(beliefs)})"
            lines[-1] = f"known = el.Calibration({source}.camera, {light})"
        frame = "frame" if self.scene is None else "el.Frame(view.image, view.mask)"
        given = ", ".join(f"{name}={value!r}" for name, value in options.items())
        return "\n".join([*lines, f"result = el.reconstruct({frame}, known, {given})"])


def _size(calibration: Endoscope, width: int) -> tuple[int, int]:
    return width, max(1, round(calibration.camera.height * width / calibration.camera.width))


@dataclass(frozen=True)
class Subject:
    """A frame as the solver gets it."""

    frame: Frame
    calibration: Endoscope  # of the frame's size, as it is; not as the solver believes
    truth: FloatArray | None = None  # true distance, (H, W), mm; nan where unknown
    width: int | None = None  # columns to solve, if they are fewer than the frame's

    def shrunk(self, width: int, gamma: float) -> Subject:
        """The same with fewer columns, light averaged by this γ."""
        size = _size(self.calibration, width)
        known = replace(self.calibration, camera=self.calibration.camera.resize(*size))
        truth = None if self.truth is None else shrunk_map(self.truth, size)
        return Subject(self.frame.resize(*size, gamma), known, truth)


def shrunk_map(distance: FloatArray, size: tuple[int, ...]) -> FloatArray:
    """Mean of the distances that a pixel of a grid of (width, height) covers, nan if one is unknown."""
    shrunk: FloatArray = cv2.resize(distance, size, interpolation=cv2.INTER_AREA).astype(distance.dtype)
    return shrunk


@dataclass(frozen=True)
class _Seen:
    """A scene whose distances and normals for one camera are known: to render it again costs little."""

    scene: Scene
    known: list[FloatArray] = field(default_factory=list)

    def distance(self, rays: FloatArray) -> FloatArray:
        if not self.known:
            self.known.append(self.scene.distance(rays))
        return self.known[0]

    def normals(self, points: FloatArray) -> FloatArray:
        if len(self.known) < 2:
            self.known.append(self.scene.normals(points))
        return self.known[1]

    def mesh(self, size: int = 400) -> Any:
        return self.scene.mesh(size)


def _keep(memory: OrderedDict[Hashable, Any], key: Hashable, value: Any, most: int) -> None:
    memory[key] = value
    memory.move_to_end(key)
    while len(memory) > most:
        memory.popitem(last=False)


class Source:
    """Where subjects come from, and the last results on each grid; remembers the last few.

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
        self.last: OrderedDict[Hashable, Result] = OrderedDict()  # of coarse grids
        self.settled: tuple[Settings, Result] | None = None  # the last final answer
        self._memory: OrderedDict[Hashable, Any] = OrderedDict()
        self._lock = threading.RLock()

    def keep(self, grid: Hashable, result: Result) -> None:
        """Remember the last result on a coarse grid."""
        _keep(self.last, grid, result, KEPT)

    def _once(self, key: Hashable, make: Callable[[], T]) -> T:
        with self._lock:
            made: T = self._memory[key] if key in self._memory else make()
            _keep(self._memory, key, made, 2 * KEPT)
            return made

    def subject(self, settings: Settings) -> Subject:
        """The frame that the settings call for; ValueError, in one sentence, if there is none."""
        if settings.width < 1:
            raise ValueError(f"width must be at least 1 px, got {settings.width}")
        if settings.scene is None:
            if self.frame is None:
                raise ValueError("there is no frame to look at: drop one here, or choose a scene")
            width = settings.width if settings.width < self.frame.width else None
            return Subject(self.frame, self.calibration, self.truth, width)
        if settings.scene not in SCENES:
            raise unknown_name("scene", settings.scene, SCENES)
        return self._once((settings.scene, settings.width, settings.noise), lambda: self._rendered(settings))

    def coarse(self, settings: Settings) -> Subject:
        """The same at half the size; its light is averaged by the true γ."""
        gamma = self.calibration.photometry.gamma
        key = ("coarse", settings.scene, settings.width, settings.scene and settings.noise)

        def shrunk() -> Subject:
            subject = self.subject(settings)
            width = min(settings.width, subject.frame.width)
            return subject.shrunk(width // SHRINK, gamma)

        return self._once(key, shrunk)

    def _rendered(self, settings: Settings) -> Subject:
        assert settings.scene is not None
        scene = SCENES[settings.scene]
        size = _size(self.calibration, settings.width)
        # The surface is met once for each size; noise costs no more than noise.
        camera = self._once(("camera", size), lambda: self.calibration.camera.resize(*size))
        seen = self._once((settings.scene, size), lambda: _Seen(scene))
        shown = render(seen, camera, self.calibration.photometry, noise=settings.noise)
        known = replace(self.calibration, camera=camera, photometry=shown.photometry)
        return Subject(Frame(shown.image, shown.mask, settings.scene), known, shown.distance)
