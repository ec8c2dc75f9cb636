"""Frame and calibration in, problem out: the channel, the pixels that take part, the unit of length."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import psutil

from endolab.depth.problem import AT_LEAST, EXACT, NONE, Problem
from endolab.depth.result import Result
from endolab.model.photometry import CHANNELS
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.preprocessing.contours import find_contours
from endolab.preprocessing.frame import BRIGHT, QUIET, Frame, field_of_view, noise_level, smooth_light, usable
from endolab.preprocessing.highlights import find_highlights, inpaint
from endolab.reconstruction.separation import ALIKE, NoColour, Separation, continued, merged, separate

if TYPE_CHECKING:
    from endolab.model.endoscope import Endoscope

HIGHLIGHTS = ("keep", "ignore", "inpaint")
SEPARATION_WIDTH = 320  # px; light that has bounced is smooth, and its surface need not be fine
BYTES_PER_PIXEL = 900  # at the peak of the solver that needs most, the frame's own arrays included


def _check_memory(width: int, height: int) -> None:
    needed, free = width * height * BYTES_PER_PIXEL, psutil.virtual_memory().available
    if needed > free:
        raise MemoryError(
            f"a frame of {width}x{height} px needs about {needed / 1e9:.1f} GB of memory, "
            f"{free / 1e9:.1f} GB are free; make it smaller with width="
        )


def pose(
    frame: Frame,
    calibration: Endoscope,
    *,
    channel: str | None = None,
    width: int | None = None,
    smooth: float | None = None,
    highlights: str | None = None,
    contours: bool | None = None,
    xi: str = "1/d",
    regulariser: str = "second",
    lam: float = 1.0,
    epsilon: float = 1e-3,
    threshold: float = 0.05,
    cuts: BoolArray | None = None,
) -> Problem:
    """Turn a frame and a calibration into the problem that solvers take.

    See `reconstruct` for the parameters. With an unknown gain, one is chosen that makes the
    median of d₀ one unit.
    """
    return posed(
        frame,
        calibration,
        channel=channel,
        width=width,
        smooth=smooth,
        highlights=highlights,
        contours=contours,
        xi=xi,
        regulariser=regulariser,
        lam=lam,
        epsilon=epsilon,
        threshold=threshold,
        cuts=cuts,
    )[0]


def posed(
    frame: Frame,
    calibration: Endoscope,
    *,
    channel: str | None = None,
    width: int | None = None,
    smooth: float | None = None,
    highlights: str | None = None,
    contours: bool | None = None,
    before: Result | None = None,
    **options: Any,
) -> tuple[Problem, FloatArray | None]:
    """Return the problem, and a start for its solver if finding the problem has found one.

    `before` is an earlier result of the same or of the last frame; `options` are those of `Problem`.
    """
    if (frame.width, frame.height) != (calibration.camera.width, calibration.camera.height):
        raise ValueError(
            f"{frame.name} is {frame.width}x{frame.height} px, "
            f"but the calibration is for {calibration.camera.width}x{calibration.camera.height} px"
        )
    separated = channel == "separated"
    if highlights is None:
        highlights = "ignore" if separated else "keep"
    if highlights not in HIGHLIGHTS:
        raise ValueError(f"unknown way with highlights {highlights!r}; choose {', '.join(HIGHLIGHTS)}")

    def colours(names: Sequence[str | None], width: int | None, **other: Any) -> list[Problem]:
        return _channels(frame, calibration, names, width, smooth, highlights, options | other)

    if not separated:
        problem = colours([channel], width)[0]
        if contours:
            edges, torn = find_contours(problem.log_facing, problem.mask)
            problem = replace(problem, cuts=torn if edges.any() else problem.cuts)
        settings = problem.settings | {"contours": problem.cuts is not None}
        return replace(problem, settings=settings), None
    if frame.image.ndim == 2:
        raise ValueError(f"{frame.name} is grey, and channel='separated' needs its three colours")
    albedo = _albedos(calibration)
    if options.get("cuts") is not None:
        contours = False  # they are known
    fine = colours(CHANNELS, width)
    coarse = (
        fine if fine[0].camera.width <= SEPARATION_WIDTH else colours(CHANNELS, SEPARATION_WIDTH, cuts=None)
    )
    try:
        if before is None:
            found = separate(coarse, albedo, contours)
        else:
            tear = contours is not False and before.problem.cuts is not None
            found = continued(coarse, albedo, tear, _resampled(before, coarse[1]))
    except NoColour as error:
        best = max((fine[index] for index in (1, 2, 0)), key=_signal)  # of equals, not red
        name = best.settings["channel"]
        notes = (f"The colours tell nothing of bounced light ({error}), so {name} is taken as it is.",)
        return replace(best, settings=best.settings | {"notes": notes, "contours": False}), None
    problem = _of_direct_light(fine, found, albedo is not None)
    return problem, _on_grid_of(problem, found.surface)


def _of_direct_light(fine: list[Problem], found: Separation, given: bool) -> Problem:
    """Return the problem of the light that has not bounced, at full size."""
    shape = fine[1].mask.shape
    problem = merged(fine, _enlarged(found.inflation, shape), found.albedo)
    if found.cuts is not None:
        same = found.cuts.shape[1:] == shape
        problem = replace(
            problem, cuts=found.cuts if same else find_contours(problem.log_facing, problem.mask)[1]
        )
    red, green, blue = (100 * np.median(s[s > 0]) if (s > 0).any() else 0.0 for s in found.inflation.T)
    note = (
        f"Bounced light was taken out: {red:.0f} % of the direct light in red, {green:.0f} % in green, "
        f"{blue:.0f} % in blue (medians), for {'given' if given else 'estimated'} albedos of "
        f"{', '.join(f'{one:.2f}' for one in found.albedo)}."
    )
    settings: dict[str, object] = {"channel": "separated", "contours": problem.cuts is not None}
    settings |= {"albedo": [float(one) for one in found.albedo], "notes": (note,)}
    return _in_units(replace(problem, settings=problem.settings | settings))


def _albedos(calibration: Endoscope) -> FloatArray | None:
    """Return the wall's albedos in red, green and blue, if the calibration tells them."""
    albedo = np.asarray(getattr(calibration.photometry.brdf, "albedo", 0.0), dtype=np.float64)
    if albedo.shape != (3,):
        return None
    if np.any(albedo <= 0) or np.any(albedo >= 1):
        raise ValueError(f"channel='separated' needs albedos between 0 and 1, got {tuple(albedo.tolist())}")
    if np.ptp(albedo) < ALIKE * albedo.max():
        raise ValueError(
            f"channel='separated' needs albedos that differ between colours, got {tuple(albedo.tolist())}"
        )
    return albedo


def _signal(problem: Problem) -> float:
    """Median grey level over noise; less where much is saturated."""
    image = problem.image[problem.mask]
    noise = max(noise_level(problem.image, problem.mask), QUIET)
    return float(np.median(image) * np.mean(image < BRIGHT)) / noise


def _enlarged(maps: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    if maps.shape[:2] == shape:
        return maps
    return np.asarray(cv2.resize(maps, shape[::-1], interpolation=cv2.INTER_LINEAR), dtype=np.float64)


def _channels(
    frame: Frame,
    calibration: Endoscope,
    names: Sequence[str | None],
    width: int | None,
    smooth: float | None,
    highlights: str,
    options: Mapping[str, Any],
) -> list[Problem]:
    """Return the problem of each channel."""
    camera, photometry, size = calibration.camera, calibration.photometry, (frame.width, frame.height)
    if width is not None and width != frame.width:
        height = max(1, round(frame.height * width / frame.width))
        frame, camera = frame.resize(width, height, photometry.gamma), camera.resize(width, height)
    _check_memory(frame.width, frame.height)
    picture, holes = frame.image, None
    if highlights != "keep":
        seen = frame.mask & camera.field.valid
        found = find_highlights(picture, seen, photometry.gamma)
        if found.any():
            picture, holes = inpaint(picture, found, seen), found
    if smooth is not None and not (np.isfinite(smooth) and smooth >= 0):
        raise ValueError(f"smooth must be finite and at least 0 (px), got {smooth}")
    if smooth is not None and smooth > frame.width:
        raise ValueError(f"smooth must not exceed the frame's width of {frame.width} px, got {smooth}")
    problems = []
    for wanted in names:
        name, image = replace(frame, image=picture).channel(wanted)
        one = photometry.simplified().channel(name)
        seen = frame.mask & camera.field.valid
        if frame.mask.all():
            seen &= field_of_view(image)
        clipped = image >= BRIGHT
        # The march follows the darkest of noisy neighbours. 2 px for one grey level of noise
        # loses nothing on the simple scenes that noise has not taken already.
        blur = 2 * float(np.sqrt(255 * noise_level(image, seen))) if smooth is None else smooth
        image = smooth_light(image, seen, photometry.gamma, blur)
        evidence = np.where(clipped, AT_LEAST, EXACT).astype(np.int8)
        if holes is not None and highlights == "ignore":
            evidence[holes] = NONE
        settings = {
            "frame": frame.name,
            "picture_size": size,
            "channel": name,
            "width": camera.width,
            "height": camera.height,
            "smooth": blur,
            "highlights": highlights,
        }
        problem = Problem(
            image=image,
            mask=usable(image, seen, camera.field.cos_alpha, frame.name),
            camera=camera,
            photometry=one if one.gain is not None else replace(one, gain=1.0),
            metric=one.gain is not None,
            evidence=evidence if evidence[seen].any() else None,
            picture=frame.image,
            settings=settings,
            **options,
        )
        problems.append(_in_units(problem))
    return problems


def enlarged(problem: Problem, factor: float) -> Problem:
    """Return the problem, in mm, whose solution is larger by a factor."""
    return replace(_scaled(problem, factor), metric=True)


def _scaled(problem: Problem, factor: float) -> Problem:
    gain = problem.photometry.gain
    assert gain is not None  # a problem's gain is always chosen
    return replace(problem, photometry=replace(problem.photometry, gain=gain * factor**2))


def _in_units(problem: Problem) -> Problem:
    """Choose the gain, if it is not known, that makes the median of d₀ one unit."""
    if problem.metric:
        return problem
    return _scaled(problem, 1 / float(np.median(np.exp(problem.log_facing[problem.mask]))))


def started(problem: Problem, start: Result) -> FloatArray:
    """Log-distance of an earlier result, at the scale that this problem's gain gives it."""
    if start.mask.shape != problem.mask.shape:
        raise ValueError(f"start has shape {start.mask.shape}, the frame {problem.mask.shape}")
    return _on_grid_of(problem, start)


def _on_grid_of(problem: Problem, start: Result) -> FloatArray:
    v = _resampled(start, problem)
    return np.where(np.isnan(v), problem.log_facing, v)  # where only the new mask reaches


def _resampled(start: Result, problem: Problem) -> FloatArray:
    """Log-distance of an earlier result on the grid of another problem, at its scale; nan where unknown."""
    shape = problem.mask.shape
    share = _enlarged(start.mask.astype(np.float64), shape)
    v = _enlarged(np.where(start.mask, start.iterate.log_distance, 0.0), shape)
    gains = [one.photometry.gain or 1.0 for one in (problem, start.problem)]
    return np.where(share > 0, v / np.where(share > 0, share, 1) + 0.5 * np.log(gains[0] / gains[1]), np.nan)
