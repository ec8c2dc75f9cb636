"""What the numbers of a result mean: how its scale was fixed, and what would change it.

Shading gives the shape and, through the gain, the size. Where the gain is unknown, one length that
is known fixes the scale: the distance to one point, or the distance between two. The energy is the
same in every unit, so that a result can be scaled after it was found.
"""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np

from endolab.depth.result import Iterate, Result
from endolab.numerics.arrays import FloatArray

Pixel = tuple[float, float]
KnownDistance = tuple[float, float, float]  # mm, column, row
KnownDiameter = tuple[float, Pixel, Pixel]  # mm, two of (column, row)

NEIGHBOURS = 2  # px to each side whose median is the distance at a pixel
APART = 2 * NEIGHBOURS + 1  # px; two points that are nearer share neighbours
SCALES = ("known distance", "known diameter", "median distance")  # as settings name them, but for the _


def factor_of_distance(
    result: Result, mm: float, column: float, row: float, *, size: tuple[int, int] | None = None
) -> float:
    """What distances must be multiplied by so that the surface at one pixel is this far away.

    Parameters
    ----------
    result : Result
    mm : float
        Euclidean distance from the optical centre, mm.
    column, row : float
        Of the pixel in the picture that was given to `endolab.reconstruct`, px from the centre of
        the upper left one.
    size : two ints, optional
        Width and height of that picture, px. By default what the setting "picture_size" says, and
        else the result's own.

    Returns
    -------
    float
        The median of a few pixels around decides, so that noise does not.

    Raises
    ------
    ValueError
        In one sentence, if the length is not one or the pixel is outside the picture or the mask.
    """
    check_scale(known_distance=(mm, column, row))
    return mm / float(np.linalg.norm(_surface_at(result, (column, row), size)))


def factor_of_diameter(
    result: Result, mm: float, one: Pixel, other: Pixel, *, size: tuple[int, int] | None = None
) -> float:
    """What distances must be multiplied by so that two points of the surface are this far apart.

    Parameters
    ----------
    result : Result
    mm : float
        Straight from point to point, mm: the width of a polyp or of an open forceps, the lumen's diameter.
    one, other : (column, row)
        Pixels of the picture, as for `factor_of_distance`.
    size : two ints, optional
        See there.

    Returns
    -------
    float

    Raises
    ------
    ValueError
        In one sentence, if the length is not one, if a pixel is outside the picture or the mask, or
        if the two are less than `APART` pixels of the result from each other.
    """
    check_scale(known_diameter=(mm, one, other))
    apart = float(np.hypot(*(_own_pixel(result, one, size) - _own_pixel(result, other, size))))
    if apart < APART:
        raise ValueError(
            f"the pixels {pixel_name(one)} and {pixel_name(other)} are {apart:.2g} px apart "
            f"in the depth map, too near to measure by; at least {APART} are needed"
        )
    between = _surface_at(result, one, size) - _surface_at(result, other, size)
    return mm / float(np.linalg.norm(between))


def scaled(result: Result, factor: float, **settings: object) -> Result:
    """Return the same surface in mm.

    Parameters
    ----------
    result : Result
    factor : float
        What distances are multiplied by, positive.
    **settings
        Why, for `scale_of` and `meaning`: such as ``known_distance=(mm, column, row)``.

    Returns
    -------
    Result
    """
    return rescaled(result, factor, True, **settings)


def rescaled(result: Result, factor: float, metric: bool, **settings: object) -> Result:
    """Return the same surface in another unit.

    Parameters
    ----------
    result : Result
    factor : float
        What distances are multiplied by; the gain goes with its square, the energy stays.
    metric : bool
        Whether the new unit is the millimetre.
    **settings
        Entries of the problem's settings that are new.

    Returns
    -------
    Result

    Raises
    ------
    ValueError
        If the factor is not positive and finite.
    """
    if not (np.isfinite(factor) and factor > 0):
        raise ValueError(f"factor must be positive and finite, got {factor}")
    old = result.problem
    photometry = replace(old.photometry, gain=(old.photometry.gain or 1.0) * factor**2)
    problem = replace(old, photometry=photometry, metric=metric, settings=old.settings | settings)
    moved = result.iterate.log_distance + np.log(factor)
    moved.flags.writeable = False
    return replace(result, iterate=replace(result.iterate, problem=problem, log_distance=moved))


def with_known_length(
    result: Result,
    known_distance: KnownDistance | None = None,
    known_diameter: KnownDiameter | None = None,
    size: tuple[int, int] | None = None,
) -> Result:
    """Scale a result by the one length that is known; without one, return it as it is.

    Parameters
    ----------
    result : Result
    known_distance : (mm, column, row), optional
        See `factor_of_distance`.
    known_diameter : (mm, (column, row), (column, row)), optional
        See `factor_of_diameter`.
    size : two ints, optional
        Of the picture, see there.

    Returns
    -------
    Result
        In mm. If it was so before by its gain, the setting "by_gain" keeps what length that said, mm.

    Raises
    ------
    ValueError
        In one sentence, if both are given or the length cannot be used.
    """
    check_scale(known_distance=known_distance, known_diameter=known_diameter)
    if known_distance is not None:
        factor, mm = factor_of_distance(result, *known_distance, size=size), known_distance[0]
        settings: dict[str, object] = {"known_distance": known_distance}
    elif known_diameter is not None:
        factor, mm = factor_of_diameter(result, *known_diameter, size=size), known_diameter[0]
        settings = {"known_diameter": known_diameter}
    else:
        return result
    if scale_of(result) == "gain":
        settings["by_gain"] = mm / factor
    return scaled(result, factor, **settings)


def check_scale(
    median_distance: float | None = None,
    known_distance: KnownDistance | None = None,
    known_diameter: KnownDiameter | None = None,
) -> None:
    """Raise a ValueError if what fixes the scale is not one thing, or not a length in mm at pixels."""
    given = {
        "median_distance": (median_distance, "mm", 1),
        "known_distance": (known_distance, "(mm, column, row)", 3),
        "known_diameter": (known_diameter, "(mm, (column, row), (column, row))", 5),
    }
    there = [name for name, (value, _, _) in given.items() if value is not None]
    if len(there) > 1:
        raise ValueError(f"{' and '.join(there)} exclude each other; give one")
    for name in there:
        value, form, count = given[name]
        try:
            outer = np.atleast_1d(np.asarray(value, dtype=object))
            numbers = np.hstack([np.ravel(part) for part in outer]).astype(np.float64)
        except (TypeError, ValueError):
            outer = numbers = np.empty(0)
        if outer.shape != (min(count, 3),) or numbers.size != count:
            raise ValueError(f"{name} must be {form}, got {value}")
        if not (np.all(np.isfinite(numbers)) and numbers[0] > 0):
            raise ValueError(f"{name} must be positive and finite (mm), got {value}")


def pixel_name(pixel: Pixel) -> str:
    """Say where a pixel is."""
    return f"column {pixel[0]:g}, row {pixel[1]:g}"


def _own_pixel(result: Result, pixel: Pixel, size: tuple[int, int] | None) -> FloatArray:
    """A pixel of the picture as one of the depth map, which may be smaller: column, row."""
    camera = result.problem.camera
    own = (camera.width, camera.height)
    said = result.problem.settings.get("picture_size")
    full = np.array(size or (own if said is None else cast("tuple[int, int]", said)))
    place = np.array(pixel, dtype=np.float64)
    if not (np.all(place >= -0.5) and np.all(place <= full - 0.5)):
        raise ValueError(f"the pixel at {pixel_name(pixel)} is outside the picture of {full[0]}x{full[1]} px")
    return (place + 0.5) * own / full - 0.5


def _surface_at(result: Result, pixel: Pixel, size: tuple[int, int] | None) -> FloatArray:
    """The surface point at a pixel of the picture, (3,), camera frame."""
    own = _own_pixel(result, pixel, size)
    mask = result.mask
    column, row = np.clip(np.round(own).astype(int), 0, [mask.shape[1] - 1, mask.shape[0] - 1])
    if not mask[row, column]:
        raise ValueError(f"the pixel at {pixel_name(pixel)} is outside the mask, where no distance is known")
    low = max(row - NEIGHBOURS, 0), max(column - NEIGHBOURS, 0)
    around = result.distance[low[0] : row + NEIGHBOURS + 1, low[1] : column + NEIGHBOURS + 1]
    ray = result.problem.camera.unproject(own)
    if not np.all(np.isfinite(ray)):  # the pixel's centre is seen, this corner of it is not
        ray = result.problem.field.rays[row, column]
    return float(np.nanmedian(around)) * ray


# Words ----------------------------------------------------------------------------------
def scale_of(result: Result | Iterate) -> str:
    """How the scale was fixed.

    Returns
    -------
    str
        "gain", "known distance", "known diameter", "median distance", "frame before" (of a video)
        or "none", and then distances are in relative units.
    """
    settings = result.problem.settings
    if settings.get("scale") is not None:
        return str(settings["scale"])
    for name in SCALES:
        if settings.get(name.replace(" ", "_")) is not None:
            return name
    return "gain" if result.problem.metric else "none"
