"""A frame and an endoscope become problems: one a channel, on all pixels and on few.

This is the stage *prepare*: the channel, the pixels that take part, the unit of length. Nothing is solved.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from endolab.frames.frame import (
    SATURATED,
    Frame,
    check_size,
    smooth_light,
    usable_pixels,
)
from endolab.frames.highlights import find_highlights, inpaint
from endolab.model.endoscope import Calibration
from endolab.model.photometry import CHANNELS
from endolab.numerics.arrays import FloatArray
from endolab.numerics.memory import check_memory
from endolab.numerics.noise import noise_level
from endolab.numerics.resampling import resample
from endolab.numerics.side_by_side import in_background, side_by_side
from endolab.reconstruction.settings import AUTO, SEPARATED, Settings
from endolab.solvers.problem import EXACT, LOWER_BOUND, NONE, Problem
from endolab.solvers.provenance import (
    LightOutcome,
    LightReport,
    PreparationReport,
    Provenance,
)
from endolab.solvers.result import Iterate


@dataclass(frozen=True)
class ProblemSizes:
    """How large problems are. Memory is that at the peak of a whole run of gauss_newton.

    It was measured with its recording and its files, at 3 and 9 Mpx.
    """

    # px of the longer side; what is smooth, as light that has bounced, and long, as
    # contours, need not be fine.
    small: int = 240
    least_side: int = 8  # px; derivatives and noise take their neighbours
    run_bytes: float = 400e6  # of any run
    bytes_per_pixel: int = 920  # of one channel
    bytes_per_colour_pixel: int = 1400  # of three


SIZES = ProblemSizes()


@dataclass(frozen=True)
class Channel:
    """One channel of a frame as a problem, and how it became one."""

    problem: Problem
    report: PreparationReport


@dataclass(frozen=True)
class Channels:
    """A frame that is prepared: one channel, or red, green and blue."""

    small: Sequence[Channel]  # on as few as bounced light and contours need
    give_full: Callable[[], Sequence[Channel]]  # waits for them, if they are being prepared
    light: LightReport | None = None  # what is known already of indirect light

    @cached_property
    def full(self) -> Sequence[Channel]:
        """The same on all pixels."""
        return self.give_full()

    @property
    def are_colours(self) -> bool:
        """Whether there are three of them, in which indirect light is to be looked for."""
        return len(self.small) == len(CHANNELS)

    @property
    def middle(self) -> Channel:
        """Green, or the only one, on all pixels."""
        return self.full[len(self.full) // 2]


@dataclass(frozen=True)
class Task:
    """What one stage hands to the next: a problem to solve, and what was done for it."""

    problem: Problem
    small: Problem  # the same on few pixels
    provenance: Provenance
    start: FloatArray | None = None  # log d to begin with, (H, W)


def prepare_channels(frame: Frame, endoscope: Calibration, settings: Settings) -> Channels:
    """Prepare what the settings ask for: three colours, or one channel."""
    grey = frame.image.ndim == 2
    if settings.used_channel == SEPARATED and grey:
        raise ValueError(
            f"{frame.name} is grey, and channel='separated' needs its three colours"
        )
    names: Sequence[str | None] = [settings.used_channel]
    light = None
    if settings.uses_colours:
        settings = replace(settings, highlights=settings.highlights or "ignore")
        names = [None] if grey else CHANNELS
        light = LightReport(LightOutcome.GREY) if grey else None
    make_full = partial(make_channels, frame, endoscope, settings, names)
    if len(names) > 1 or settings.searches_contours:
        width = settings.width or frame.width
        height = frame.height * width / frame.width
        share = SIZES.small / max(width, height)
        if share < 1 and share * min(width, height) >= SIZES.least_side:
            less = replace(settings, width=round(share * width), cuts=None)
            check_size(frame.name, (frame.width, frame.height), endoscope.camera)
            _check_frame(width, round(height), len(names), settings.smooth)
            give_full = in_background(make_full)  # long before it is needed
            return Channels(make_channels(frame, endoscope, less, names), give_full, light)
    full = make_full()
    return Channels(full, lambda: full, light)


def make_problem(frame: Frame, endoscope: Calibration, **options: object) -> Problem:
    """Turn one channel of a frame, green by default, into the problem that solvers take.

    `options` are those of `Settings`. With an unknown gain, one is chosen that makes the median of d₀ one
    unit.
    """
    settings = Settings.of(options)
    if settings.channel in (SEPARATED, AUTO):
        raise ValueError(
            f"channel={settings.channel!r} is found by solving: use reconstruct() or iterate()"
        )
    (made,) = make_channels(frame, endoscope, settings, [settings.channel])
    return made.problem


def make_channels(
    frame: Frame, endoscope: Calibration, settings: Settings, names: Sequence[str | None]
) -> list[Channel]:
    """Make the problem of each of these channels; None is green, or grey of a grey picture."""
    camera = endoscope.camera
    photometry = endoscope.photometry
    picture_size = (frame.width, frame.height)
    check_size(frame.name, picture_size, camera)
    width = settings.width
    if width is not None and width != frame.width:
        height = max(1, round(frame.height * width / frame.width))
        frame = frame.resize(width, height, photometry.gamma)
        camera = camera.resize(width, height)
    _check_frame(frame.width, frame.height, len(names), settings.smooth)
    known = frame.pixels_to_use() & camera.field.valid
    no_evidence = np.zeros_like(known) if frame.silent is None else frame.silent
    mirrored = no_evidence
    highlights = settings.highlights or "keep"
    if highlights != "keep":
        mirrored = no_evidence | find_highlights(frame.image, known, photometry.gamma)
    if highlights == "ignore":
        no_evidence = mirrored
    treated = frame
    if mirrored.any():
        treated = replace(frame, image=inpaint(frame.image, mirrored, known))
    fingerprint = _fingerprint(frame, endoscope)

    def make(wanted: str | None) -> Channel:
        name, image = treated.channel(wanted)
        called = frame.name if frame.image.ndim == 2 else f"{frame.name} in {name}"
        own = photometry.simplify().channel(name)
        saturated = image >= SATURATED
        # The march follows the darkest of noisy neighbours. 2 px for one grey level of noise
        # loses nothing on the simple scenes that noise has not taken already.
        blur = settings.smooth
        if blur is None:
            blur = 2 * float(np.sqrt(255 * noise_level(image, known)))
        image = smooth_light(image, known, photometry.gamma, blur)
        evidence = np.where(saturated, LOWER_BOUND, EXACT).astype(np.int8)
        evidence[no_evidence] = NONE
        problem = Problem(
            image=image,
            mask=usable_pixels(image, known, camera.field.cos_alpha, called),
            camera=camera,
            photometry=own if own.gain is not None else replace(own, gain=1.0),
            metric=own.gain is not None,
            evidence=evidence if evidence[known].any() else None,
            picture=frame.image,
            xi=settings.xi,
            regulariser=settings.used_regulariser,
            lam=settings.lam,
            epsilon=settings.epsilon,
            threshold=settings.threshold,
            cuts=settings.cuts,
        )
        report = PreparationReport(
            frame=frame.name,
            picture_size=picture_size,
            channel=name,
            width=camera.width,
            height=camera.height,
            smooth=blur,
            highlights=highlights,
            misplaced=frame.misplaced,
            fingerprint=fingerprint,
        )
        return Channel(in_units(problem), report)

    return side_by_side(make, names, frame.width * frame.height)


def _fingerprint(frame: Frame, endoscope: Calibration) -> str:
    """Digits that are equal for the same picture of the same endoscope, whatever its gain."""
    total = hashlib.blake2b(digest_size=16)
    known = replace(endoscope.photometry, gain=None)
    silent = np.empty(0) if frame.silent is None else frame.silent
    for part in (frame.image, frame.mask, silent):
        total.update(np.ascontiguousarray(part).data)
    total.update(repr((frame.image.shape, endoscope.camera, known)).encode())
    return total.hexdigest()


def _check_frame(width: int, height: int, channels: int, smooth: float | None) -> None:
    if min(width, height) < SIZES.least_side:
        least = f"expected {SIZES.least_side}x{SIZES.least_side} px or more"
        raise ValueError(
            f"a frame of {width}x{height} px is too small to be solved: {least}"
        )
    per_pixel = SIZES.bytes_per_pixel if channels == 1 else SIZES.bytes_per_colour_pixel
    needed = SIZES.run_bytes + width * height * per_pixel
    check_memory(needed, f"a frame of {width}x{height} px", "; make it smaller with width=")
    if smooth is not None and smooth > width:
        most = f"the frame's width of {width} px"
        raise ValueError(f"smooth must not exceed {most}, got {smooth}")


def in_units(problem: Problem) -> Problem:
    """Choose the gain, if it is not known, that makes the median of d₀ one unit."""
    if problem.metric:
        return problem
    factor = 1 / float(np.median(np.exp(problem.log_d0[problem.mask])))
    gain = (problem.photometry.gain or 1.0) * factor**2
    return replace(problem, photometry=replace(problem.photometry, gain=gain))


# An earlier surface as a start ----------------------------------------------------------


def resample_surface(surface: Iterate, problem: Problem) -> FloatArray:
    """Return log d of a surface on a problem's grid, at the scale of its gain; nan where unknown."""
    shape = problem.mask.shape
    share = resample(surface.mask.astype(np.float64), shape)
    v = resample(np.where(surface.mask, surface.log_distance, 0.0), shape)
    gain = problem.photometry.gain or 1.0
    gain_before = surface.problem.photometry.gain or 1.0
    moved = v / np.where(share > 0, share, 1) + 0.5 * np.log(gain / gain_before)
    return np.where(share > 0, moved, np.nan)


def start_from(surface: Iterate, problem: Problem) -> FloatArray:
    """Return log d of a surface on a problem's grid, (H, W), and log d₀ where it does not reach."""
    v = resample_surface(surface, problem)
    return np.where(np.isnan(v), problem.log_d0, v)
