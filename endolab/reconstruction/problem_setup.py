"""Frame and endoscope in, problem out: the channel, the pixels that take part, the unit of length.

A solver is given the `Problem`; what was done to make it goes along in a `PosedProblem`, for the result.

This is the stage "prepared" of a reconstruction; nothing is solved here.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from endolab.depth.problem import AT_LEAST, EXACT, NONE, Problem
from endolab.depth.provenance import Provenance
from endolab.depth.result import Iterate
from endolab.model.endoscope import Endoscope
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.checks import number, whole
from endolab.numerics.memory import check_memory
from endolab.numerics.resampling import resized
from endolab.numerics.side_by_side import side_by_side
from endolab.preprocessing.frame import BRIGHT, Frame, check_size, noise_level, smooth_light, usable
from endolab.preprocessing.highlights import check_highlights, find_highlights, inpaint

SEPARATED = "separated"  # the channel that is made of all three, indirect light removed
AUTO = "auto"  # the one that the frame's evidence allows
# px of the longer side; what is smooth, as light that has bounced, and long, as contours, need not be fine
COARSE = 240
LEAST_SIDE = 8  # px; derivatives and noise take their neighbours
# At the peak of a whole run of gauss_newton with its recording and its files, of one channel and of three,
# measured at 3 and 9 Mpx.
BYTES, BYTES_PER_PIXEL = 400e6, {1: 920, 3: 1400}


@dataclass(frozen=True)
class Preparation:
    """How a frame becomes a problem; `reconstruct` says what each choice means."""

    channel: str | None = None
    width: int | None = None
    smooth: float | None = None
    highlights: str | None = None
    xi: str = "1/d"
    regulariser: str = "second"
    lam: float = 1.0
    epsilon: float = 1e-3
    threshold: float = 0.05
    discontinuities: BoolArray | None = None

    def __post_init__(self) -> None:
        check_highlights(self.highlights)
        if self.width is not None:
            object.__setattr__(self, "width", whole("width", self.width, 1))
        if self.smooth is not None:
            object.__setattr__(self, "smooth", number("smooth", self.smooth, 0))


@dataclass(frozen=True)
class PosedProblem:
    """A problem and where it comes from."""

    problem: Problem
    provenance: Provenance

    def noted(self, **settings: object) -> Self:
        """Add to what was asked for and done."""
        before = self.provenance
        return replace(self, provenance=replace(before, settings=before.settings | settings))

    def remarked(self, sentence: str) -> Self:
        """Add a sentence about what was done and why."""
        notes = (*self.provenance.notes, sentence)
        return replace(self, provenance=replace(self.provenance, notes=notes)).noted(notes=notes)


def make_problem(frame: Frame, calibration: Endoscope, **choices: Any) -> Problem:
    """Turn one channel of a frame into the problem that solvers take.

    `choices` are those of `Preparation`. With an unknown gain, one is chosen that makes the
    median of d₀ one unit.
    """
    preparation = Preparation(**choices)
    channel = preparation.channel
    if channel in (SEPARATED, AUTO):
        raise ValueError(f"channel={channel!r} is found by solving: use reconstruct() or iterate()")
    (posed,) = make_problems(frame, calibration, preparation, [channel])
    return posed.problem


def make_problems(
    frame: Frame, calibration: Endoscope, preparation: Preparation, channels: Sequence[str | None]
) -> list[PosedProblem]:
    """Return the problem of each of these channels."""
    camera, photometry, size = calibration.camera, calibration.photometry, (frame.width, frame.height)
    check_size(frame.name, size, camera)
    width, smooth = preparation.width, preparation.smooth
    highlights = check_highlights(preparation.highlights)
    if width is not None and width != frame.width:
        height = max(1, round(frame.height * width / frame.width))
        frame, camera = frame.resize(width, height, photometry.gamma), camera.resize(width, height)
    _check_frame(frame.width, frame.height, len(channels))
    if smooth is not None and smooth > frame.width:
        raise ValueError(f"smooth must not exceed the frame's width of {frame.width} px, got {smooth}")
    picture = frame.image
    known = frame.seen() & camera.field.valid
    silent = np.zeros_like(known) if frame.silent is None else frame.silent
    mirrored = silent if highlights == "keep" else silent | find_highlights(picture, known, photometry.gamma)
    treated = frame
    if mirrored.any():
        treated = replace(frame, image=inpaint(picture, mirrored, known))
    silent = mirrored if highlights == "ignore" else silent

    def posed(wanted: str | None) -> PosedProblem:
        name, image = treated.channel(wanted)
        called = frame.name if picture.ndim == 2 else f"{frame.name} in {name}"
        own = photometry.simplified().channel(name)
        clipped = image >= BRIGHT
        # The march follows the darkest of noisy neighbours. 2 px for one grey level of noise
        # loses nothing on the simple scenes that noise has not taken already.
        blur = 2 * float(np.sqrt(255 * noise_level(image, known))) if smooth is None else smooth
        image = smooth_light(image, known, photometry.gamma, blur)
        evidence = np.where(clipped, AT_LEAST, EXACT).astype(np.int8)
        evidence[silent] = NONE
        settings = {"frame": frame.name, "picture_size": size, "channel": name, "width": camera.width}
        settings |= {"height": camera.height, "smooth": blur, "highlights": highlights}
        problem = Problem(
            image=image,
            mask=usable(image, known, camera.field.cos_alpha, called),
            camera=camera,
            photometry=own if own.gain is not None else replace(own, gain=1.0),
            metric=own.gain is not None,
            evidence=evidence if evidence[known].any() else None,
            picture=frame.image,
            xi=preparation.xi,
            regulariser=preparation.regulariser,
            lam=preparation.lam,
            epsilon=preparation.epsilon,
            threshold=preparation.threshold,
            discontinuities=preparation.discontinuities,
        )
        return PosedProblem(in_units(problem), Provenance(settings, picture_size=size, smooth=blur))

    return side_by_side(posed, channels, frame.width * frame.height)


def two_sizes(
    frame: Frame, calibration: Endoscope, preparation: Preparation, channels: Sequence[str | None]
) -> tuple[list[PosedProblem], list[PosedProblem]]:
    """Return what `make_problems` does, in full and on as few pixels as what is smooth needs."""
    fine = make_problems(frame, calibration, preparation, channels)
    camera = fine[0].problem.camera
    less = COARSE / max(camera.width, camera.height)
    if less >= 1 or less * min(camera.width, camera.height) < LEAST_SIDE:
        return fine, fine
    preparation = replace(preparation, width=round(less * camera.width), discontinuities=None)
    return fine, make_problems(frame, calibration, preparation, channels)


def _check_frame(width: int, height: int, channels: int) -> None:
    if min(width, height) < LEAST_SIDE:
        least = f"expected {LEAST_SIDE}x{LEAST_SIDE} px or more"
        raise ValueError(f"a frame of {width}x{height} px is too small to be solved: {least}")
    needed = BYTES + width * height * BYTES_PER_PIXEL[channels]
    check_memory(needed, f"a frame of {width}x{height} px", "; make it smaller with width=")


def in_units(problem: Problem) -> Problem:
    """Choose the gain, if it is not known, that makes the median of d₀ one unit."""
    if problem.metric:
        return problem
    factor = 1 / float(np.median(np.exp(problem.log_facing[problem.mask])))
    gain = (problem.photometry.gain or 1.0) * factor**2
    return replace(problem, photometry=replace(problem.photometry, gain=gain))


# An earlier surface as a start ----------------------------------------------------------


def enlarged(maps: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Resample maps (h, w, ...) to (H, W, ...), linearly."""
    return maps if maps.shape[:2] == shape else resized(maps, shape)


def resampled(surface: Iterate, problem: Problem) -> FloatArray:
    """Log-distance of a surface on a problem's grid, at the scale of its gain; nan where unknown."""
    shape = problem.mask.shape
    share = enlarged(surface.mask.astype(np.float64), shape)
    v = enlarged(np.where(surface.mask, surface.log_distance, 0.0), shape)
    gains = [side.photometry.gain or 1.0 for side in (problem, surface.problem)]
    return np.where(share > 0, v / np.where(share > 0, share, 1) + 0.5 * np.log(gains[0] / gains[1]), np.nan)


def on_grid(surface: Iterate, problem: Problem) -> FloatArray:
    """The same, and log d₀ where only the problem's mask reaches."""
    v = resampled(surface, problem)
    return np.where(np.isnan(v), problem.log_facing, v)
