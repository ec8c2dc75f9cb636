"""Scale: one length that is known makes millimetres of relative units.

Without a known gain a frame shows a shape, not a size. One length says the rest: the median
distance, the distance to one point, or that between two. The energy is the same in every unit and
distances go with the square root of the gain, so that a result is scaled after it was found.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from endolab.model.ranges import RANGES
from endolab.numerics.arrays import FloatArray, freeze
from endolab.numerics.checks import number, real_array
from endolab.solvers.result import SCALED, Iterate, Result

Pixel = tuple[float, float]
KnownDistance = tuple[float, float, float]  # mm, column, row
KnownDiameter = tuple[float, Pixel, Pixel]  # mm, two of (column, row)

# How each length is written, and the shapes of its parts.
LENGTH_FORMS: dict[str, tuple[str, list[tuple[int, ...]]]] = {
    "median_distance": ("mm", [()]),
    "known_distance": ("(mm, column, row)", [(), (), ()]),
    "known_diameter": ("(mm, (column, row), (column, row))", [(), (2,), (2,)]),
}
NEIGHBOURS = 2  # px to each side whose median is the distance at a pixel
LEAST_APART = 2 * NEIGHBOURS + 1  # px; two points that are nearer share neighbours


def scale_by_length(
    iterate: Iterate,
    median_distance: float | None = None,
    known_distance: KnownDistance | None = None,
    known_diameter: KnownDiameter | None = None,
) -> Iterate:
    """Return the same surface in mm, by the one length that is known; without one, as it is.

    For the lengths see `factor_of_distance` and `factor_of_diameter`.
    """
    length: Any
    if median_distance is not None:
        by, length = "median distance", median_distance
        factor = median_distance / float(np.median(iterate.distance[iterate.mask]))
    elif known_distance is not None:
        by, length = "known distance", known_distance
        factor = factor_of_distance(iterate, *known_distance)
    elif known_diameter is not None:
        by, length = "known diameter", known_diameter
        factor = factor_of_diameter(iterate, *known_diameter)
    else:
        return iterate
    is_second = scale_of(iterate) == "gain" and by != "median distance"
    by_gain = length[0] / factor if is_second else None
    return in_unit(iterate, factor, scale=by, length=length, length_by_gain=by_gain)


def factor_of_distance(
    result: Result | Iterate, mm: float, column: float, row: float
) -> float:
    """What distances must be multiplied by so that the surface at one pixel is this far away, mm.

    The pixel (column, row) is one of the picture that was given to `endolab.reconstruct`, px from the
    centre of the upper left one; the median of a few pixels around decides, so that noise does not.
    """
    return mm / float(np.linalg.norm(_surface_at(result, (column, row))))


def factor_of_diameter(
    result: Result | Iterate, mm: float, start: Pixel, end: Pixel
) -> float:
    """What distances must be multiplied by so that two points of the surface are this far apart, mm.

    The length is straight from point to point: the width of a polyp or of an open forceps, the lumen's
    diameter. The pixels are as for `factor_of_distance`, at least `LEAST_APART` of the result apart.
    """
    apart = float(np.hypot(*(own_pixel(result, start) - own_pixel(result, end))))
    if apart < LEAST_APART:
        raise ValueError(
            f"the pixels {pixel_name(start)} and {pixel_name(end)} are {apart:.2g} px apart "
            f"in the depth map, too near to measure by; at least {LEAST_APART} are needed"
        )
    return mm / float(np.linalg.norm(_surface_at(result, start) - _surface_at(result, end)))


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


def check_scale(**lengths: Any) -> None:
    """Raise a ValueError if what fixes the scale is not one thing, or not a length in mm at pixels."""
    given = {name: value for name, value in lengths.items() if value is not None}
    if len(given) > 1:
        raise ValueError(f"{' and '.join(given)} exclude each other; give one")
    for name, value in given.items():
        form, shapes = LENGTH_FORMS[name]
        try:
            parts = [
                real_array(name, part) for part in ([value] if len(shapes) == 1 else value)
            ]
        except (TypeError, ValueError):
            parts = []
        if [part.shape for part in parts] != shapes:
            raise ValueError(f"{name} must be {form}, got {value}")
        number(f"{name} (mm)", float(parts[0]), *RANGES["length"])


def pixel_name(pixel: Sequence[float]) -> str:
    """Say where a pixel is."""
    return f"column {pixel[0]:g}, row {pixel[1]:g}"


def own_pixel(result: Result | Iterate, pixel: Pixel) -> FloatArray:
    """A pixel of the picture as one of the depth map, which may be smaller: column, row."""
    camera = result.problem.camera
    own = (camera.width, camera.height)
    full = np.array(result.report.picture_size or own)
    place = np.array(pixel, dtype=np.float64) + 0.5
    if not np.all((place >= 0) & (place <= full)):
        raise ValueError(
            f"the pixel at {pixel_name(pixel)} is outside the picture of {full[0]}x{full[1]} px"
        )
    return place * own / full - 0.5


def _surface_at(result: Result | Iterate, pixel: Pixel) -> FloatArray:
    """The surface point at a pixel of the picture, (3,), camera frame."""
    own = own_pixel(result, pixel)
    column, row = (own + 0.5 - 1e-9).astype(int)  # a pixel's edges belong to it
    if not result.mask[row, column]:
        raise ValueError(
            f"the pixel at {pixel_name(pixel)} is outside the mask, where no distance is known"
        )
    around = result.distance[
        max(row - NEIGHBOURS, 0) : row + NEIGHBOURS + 1,
        max(column - NEIGHBOURS, 0) : column + NEIGHBOURS + 1,
    ]
    ray = result.problem.camera.unproject(own)
    if not np.all(np.isfinite(ray)):  # the pixel's centre is seen, this corner of it is not
        ray = result.problem.field.rays[row, column]
    return float(np.nanmedian(around)) * ray
