"""Scale: one length that is known makes millimetres of relative units.

Without a known gain a frame shows a shape, not a size. One length says the rest: the median
distance, the distance to one point, or that between two. The energy is the same in every unit and
distances go with the square root of the gain, so that a result is scaled after it was found.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from endolab.numerics.arrays import FloatArray, freeze
from endolab.reconstruction.settings import Pixel, Settings
from endolab.solvers.result import SCALED, Iterate, Result

NEIGHBOURS = 2  # px to each side whose median is the distance at a pixel


def to_scale(iterate: Iterate, settings: Settings) -> Iterate:
    """Return the same surface in mm, by the one length that is known; without one, as it is.

    Pixels are as for `factor_of_distance`, the two of a diameter so far apart that they share no neighbours.
    It is straight from point to point: the width of a polyp or of an open forceps.
    """
    length: Any
    if settings.median_distance is not None:
        length = settings.median_distance
        factor = length / float(np.median(iterate.distance[iterate.mask]))
        return in_unit(iterate, factor, scale="median distance", length=length)
    if settings.known_distance is not None:
        by, length = "known distance", settings.known_distance
        factor = factor_of_distance(iterate, *length)
    elif settings.known_diameter is not None:
        by, length = "known diameter", settings.known_diameter
        mm, start, end = length
        apart = np.linalg.norm(own_pixel(iterate, start)[0] - own_pixel(iterate, end)[0])
        least = 2 * NEIGHBOURS + 1
        if apart < least:
            raise ValueError(
                f"the pixels {pixel_name(start)} and {pixel_name(end)} are {apart:.2g} px apart "
                f"in the depth map, too near to measure by; at least {least} are needed"
            )
        across = _surface_at(iterate, start) - _surface_at(iterate, end)
        factor = mm / float(np.linalg.norm(across))
    else:
        return iterate
    by_gain = length[0] / factor if scale_of(iterate) == "gain" else None
    return in_unit(iterate, factor, scale=by, length=length, length_by_gain=by_gain)


def factor_of_distance(
    result: Result | Iterate, mm: float, column: float, row: float
) -> float:
    """What distances must be multiplied by so that the surface at one pixel is this far away, mm.

    The pixel (column, row) is one of the picture that was given to `endolab.reconstruct`, px from the
    centre of the upper left one; the median of a few pixels around decides, so that noise does not.
    """
    return mm / float(np.linalg.norm(_surface_at(result, (column, row))))


def in_unit(iterate: Iterate, factor: float, metric: bool = True, **scale: Any) -> Iterate:
    """Return the same surface in another unit, mm if it is `metric`; `scale` goes into its report.

    Distances are multiplied by the factor; the gain goes with its square, the energy stays.
    """
    problem = iterate.problem
    photometry = problem.photometry
    photometry = replace(photometry, gain=(photometry.gain or 1.0) * factor**2)
    report = replace(problem.report, **scale)
    return replace(
        iterate,
        problem=replace(problem, photometry=photometry, metric=metric, report=report),
        log_distance=freeze(iterate.log_distance + np.log(factor)),
        stage=SCALED,
    )


def scale_of(result: Result | Iterate) -> str:
    """How the scale was fixed: "gain", "none" (relative units), or what `Report.scale` says."""
    if result.report.scale:
        return result.report.scale
    return "gain" if result.problem.metric else "none"


def pixel_name(pixel: Sequence[float]) -> str:
    """Say where a pixel is."""
    return f"column {pixel[0]:g}, row {pixel[1]:g}"


def own_pixel(result: Result | Iterate, pixel: Pixel) -> tuple[FloatArray, tuple[int, int]]:
    """A pixel of the picture in the depth map, which may be smaller.

    Returns its place, column and row, and the row and column of the pixel that it lies in.
    """
    camera = result.problem.camera
    own = np.array([camera.width, camera.height])
    full = np.array(result.report.picture_size or own)
    place = (np.array(pixel) + 0.5) * own / full
    if not np.all((place >= 0) & (place <= own)):
        raise ValueError(
            f"the pixel at {pixel_name(pixel)} is outside the picture of {full[0]}x{full[1]} px"
        )
    column, row = (place - 1e-9).astype(int)  # a pixel's edges belong to it
    return place - 0.5, (row, column)


def _surface_at(result: Result | Iterate, pixel: Pixel) -> FloatArray:
    """The surface point at a pixel of the picture, (3,), camera frame."""
    own, (row, column) = own_pixel(result, pixel)
    if not result.mask[row, column]:
        raise ValueError(
            f"the pixel at {pixel_name(pixel)} is outside the mask, where no distance is known"
        )
    rows, columns = (
        slice(max(i - NEIGHBOURS, 0), i + NEIGHBOURS + 1) for i in (row, column)
    )
    ray = result.problem.camera.unproject(own)
    if not np.all(np.isfinite(ray)):  # the pixel's centre is seen, this corner of it is not
        ray = result.problem.field.rays[row, column]
    return float(np.nanmedian(result.distance[rows, columns])) * ray
