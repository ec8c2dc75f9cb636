"""A frame and an endoscope become a problem: its channel or colours, which pixels count, the unit.

Nothing is solved. Bounced light and contours are looked for on few pixels first: what is smooth, as light
that has bounced, and long, as contours, need not be fine.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from functools import partial
from typing import Any

import cv2
import numpy as np

from endolab.frames.frame import (
    SATURATED,
    Frame,
    smooth_light,
    usable_pixels,
)
from endolab.frames.highlights import find_highlights, inpaint
from endolab.model.cameras import Camera
from endolab.model.endoscope import Calibration
from endolab.model.photometry import CHANNELS
from endolab.numerics.arrays import BoolArray
from endolab.numerics.memory import check_memory
from endolab.numerics.noise import noise_level
from endolab.numerics.side_by_side import side_by_side
from endolab.reconstruction.settings import AUTO, SEPARATED, Settings
from endolab.solvers.problem import EXACT, LOWER_BOUND, NONE, Problem
from endolab.solvers.provenance import LightOutcome, Report

LEAST_SIDE = 8  # px; derivatives and noise take their neighbours


def problem_of_frame(frame: Frame, calibration: Calibration, settings: Settings) -> Problem:
    """Make the problem that the settings ask for: of one channel, or of green with its two `colours`.

    With an unknown gain, one is chosen that makes the median of d₀ one unit.
    """
    width, height = _size_of_problem(frame, settings)
    picture_size = (frame.width, frame.height)
    fingerprint = fingerprint_of(frame)
    whole = frame
    photometry = calibration.photometry
    if width != frame.width:
        frame = frame.resize(width, height, photometry.gamma)
    camera = calibration.camera.resize(frame.width, frame.height)
    highlights = settings.used_highlights
    seen = frame.selection.pixels
    known = seen & camera.field.valid
    # On the frame's own pixels, if all have a ray.
    shown = known if (seen & ~known).any() else whole.selection.pixels
    field = measure_field(shown, camera, picture_size) if known.any() else {}
    mirrored = silent = np.zeros_like(known) if frame.silent is None else frame.silent
    if highlights != "keep":
        mirrored = silent | find_highlights(frame.image, known, photometry.gamma)
    if highlights == "ignore":
        silent = mirrored
    treated = replace(frame, image=inpaint(frame.image, mirrored, known))

    def make(wanted: str | None) -> Problem:
        name, image = treated.channel(wanted)
        own = photometry.simplify().channel(name)
        evidence = np.where(image >= SATURATED, LOWER_BOUND, EXACT).astype(np.int8)
        evidence[silent] = NONE
        # The march follows the darkest of noisy neighbours. 2 px for one grey level of noise
        # loses nothing on the simple scenes that noise has not taken already.
        blur = settings.smooth
        if blur is None:
            blur = 2 * float(np.sqrt(255 * noise_level(image, known)))
        image = smooth_light(image, known, photometry.gamma, blur)
        called = frame.name if frame.image.ndim == 2 else f"{frame.name} in {name}"
        report = Report(
            frame=frame.name,
            picture_size=picture_size,
            field_seen=field,
            calibration=calibration,
            width=camera.width,
            height=camera.height,
            channel=name,
            smooth=blur,
            highlights=highlights,
            misplaced=frame.selection.misplaced,
            shown_share=frame.selection.shown_share,
            box_share=frame.selection.box_share,
            without_ray=1 - float(known.sum() / seen.sum()),
            fingerprint=fingerprint,
        )
        problem = Problem(
            image=image,
            mask=usable_pixels(image, known, camera.field.cos_alpha, called),
            camera=camera,
            photometry=own if own.gain is not None else replace(own, gain=1.0),
            metric=own.gain is not None,
            evidence=evidence if evidence[known].any() else None,
            picture=frame.image,
            seen=seen,
            **settings.energy,
            cuts=settings.cuts,
            report=report,
        )
        return problem.in_units()

    if not settings.uses_colours:
        return make(settings.used_channel)
    if frame.image.ndim == 2:
        problem = make(None)
        return replace(problem, report=replace(problem.report, light=LightOutcome.GREY))
    red, green, blue = side_by_side(make, CHANNELS, frame.width * frame.height)
    return replace(green, colours=(red, green, blue))


def measure_field(
    shown: BoolArray, camera: Camera, size: tuple[int, int]
) -> dict[str, Any]:
    """Return how wide and high the field of view is, px of a frame's size, and its widest angle, degrees.

    `shown` (h, w) is True there, on any grid. The angle is of the ray farthest off the axis with any other;
    twice its own, if that is more than 90°.
    """
    hull = cv2.convexHull(cv2.findNonZero(shown.astype(np.uint8)))[:, 0]
    rays = camera.resize(*shown.shape[::-1]).unproject(hull)
    aside = rays[np.nanargmin(rays[:, 2])]
    angle = np.arccos(np.clip([aside[2], np.nanmin(rays @ aside)], -1, 1))
    px = np.divide(size, shown.shape[::-1]) * (np.ptp(hull, axis=0) + 1)
    return {
        "px": np.rint(px).astype(int).tolist(),
        "degrees": float(np.rad2deg(2 * angle[0] if aside[2] < 0 else angle[1])),
    }


def make_problem(frame: Frame, calibration: Calibration, **options: object) -> Problem:
    """Turn one channel of a frame, green by default, into the problem that solvers take.

    `options` are those of `Settings`.
    """
    settings = Settings.of(options)
    if settings.channel in (SEPARATED, AUTO):
        raise ValueError(
            f"channel={settings.channel!r} is found by solving: use reconstruct() or iterate()"
        )
    if settings.channel is None:
        settings = replace(settings, channel="green")
    check_frame(frame, calibration, settings)
    return problem_of_frame(frame, calibration, settings)


def problems_of_frame(
    frame: Frame, calibration: Calibration, settings: Settings, has_lamps: bool = False
) -> tuple[Problem, Problem]:
    """Make the problem on few pixels, on which light and contours are looked for first, and that on all.

    These have 240 px along the longer side.
    They are one if nothing is looked for, or if the frame is that small.
    """
    width, height = _size_of_problem(frame, settings)
    fraction = 240 / max(width, height)
    is_asked = settings.searches_contours or _asks_colours(frame, settings) or has_lamps
    if not is_asked or fraction >= 1 or fraction * min(width, height) < LEAST_SIDE:
        full = problem_of_frame(frame, calibration, settings)
        return full, full
    few = replace(settings, width=round(fraction * width), cuts=None)
    small, full = side_by_side(
        partial(problem_of_frame, frame, calibration), (few, settings), width * height
    )
    return small, full


def check_frame(frame: Frame, calibration: Calibration, settings: Settings) -> None:
    """Raise a ValueError or a MemoryError if a frame cannot be solved by these settings."""
    calibration.fit(frame.name, frame.width, frame.height)
    if settings.used_channel == SEPARATED and frame.image.ndim == 2:
        raise ValueError(
            f"{frame.name} is grey, and channel='separated' needs its three colours"
        )
    width, height = _size_of_problem(frame, settings)
    size = f"a frame of {width}x{height} px"
    if min(width, height) < LEAST_SIDE:
        raise ValueError(
            f"{size} is too small to be solved: expected {LEAST_SIDE}x{LEAST_SIDE} px or more"
        )
    # At the peak of a whole run of gauss_newton with its recording and its files, measured at 3 and 9 Mpx.
    per_pixel = 1400 if _asks_colours(frame, settings) else 920
    needed = 400e6 + width * height * per_pixel
    check_memory(needed, size, "; make it smaller with width=")
    if (settings.smooth or 0.0) > width:
        most = f"the frame's width of {width} px"
        raise ValueError(f"smooth must not exceed {most}, got {settings.smooth}")


def _size_of_problem(frame: Frame, settings: Settings) -> tuple[int, int]:
    width = min(settings.width or frame.width, frame.width)
    return width, max(1, round(frame.height * width / frame.width))


def _asks_colours(frame: Frame, settings: Settings) -> bool:
    return settings.uses_colours and frame.image.ndim == 3


def fingerprint_of(frame: Frame) -> tuple[str, str]:
    """Return digits of a picture and of its mask that are equal for equal ones."""
    silent = np.empty(0) if frame.silent is None else frame.silent
    digits = []
    for arrays in ((frame.image,), (frame.mask, silent)):
        total = hashlib.blake2b(digest_size=16)
        for array in arrays:
            total.update(np.ascontiguousarray(array).data)
        digits.append(total.hexdigest())
    return digits[0], digits[1]
