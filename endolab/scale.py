"""What the numbers of a result mean: how its scale was fixed, and what would change it.

Shading gives the shape and, through the gain, the size. Where the gain is unknown, one length that
is known fixes the scale: the distance to one point, or the distance between two. The energy is the
same in every unit, so that a result can be scaled after it was found.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import cast

import numpy as np

from endolab.depth.energy import AT_LEAST, NONE
from endolab.iteration import Iterate, Result
from endolab.operators import FloatArray

Pixel = tuple[float, float]
KnownDistance = tuple[float, float, float]  # mm, column, row
KnownDiameter = tuple[float, Pixel, Pixel]  # mm, two of (column, row)

NEIGHBOURS = 2  # px to each side whose median is the distance at a pixel
APART = 2 * NEIGHBOURS + 1  # px; two points that are nearer share neighbours
GAMMA_STEP = 0.1  # error of γ whose effect is told
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
            f"the pixels {_named(one)} and {_named(other)} are {apart:.2g} px apart in the depth map, "
            f"too near to measure by; at least {APART} are needed"
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


def _named(pixel: Pixel) -> str:
    return f"column {pixel[0]:g}, row {pixel[1]:g}"


def _own_pixel(result: Result, pixel: Pixel, size: tuple[int, int] | None) -> FloatArray:
    """A pixel of the picture as one of the depth map, which may be smaller: column, row."""
    camera = result.problem.camera
    own = (camera.width, camera.height)
    said = result.problem.settings.get("picture_size")
    full = np.array(size or (own if said is None else cast("tuple[int, int]", said)))
    place = np.array(pixel, dtype=np.float64)
    if not (np.all(place >= -0.5) and np.all(place <= full - 0.5)):
        raise ValueError(f"the pixel at {_named(pixel)} is outside the picture of {full[0]}x{full[1]} px")
    return (place + 0.5) * own / full - 0.5


def _surface_at(result: Result, pixel: Pixel, size: tuple[int, int] | None) -> FloatArray:
    """The surface point at a pixel of the picture, (3,), camera frame."""
    own = _own_pixel(result, pixel, size)
    mask = result.mask
    column, row = np.clip(np.round(own).astype(int), 0, [mask.shape[1] - 1, mask.shape[0] - 1])
    if not mask[row, column]:
        raise ValueError(f"the pixel at {_named(pixel)} is outside the mask, where no distance is known")
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


def meaning(result: Result | Iterate) -> tuple[str, ...]:
    """Say what the numbers of a result mean and what they rest on.

    Parameters
    ----------
    result : Result or Iterate

    Returns
    -------
    tuple of str
        A sentence each: the unit and what fixes it; the wall's albedo; light that bounced; γ; pixels
        that are saturated or say nothing; the notes of the settings.
    """
    return (
        *_of_scale(result),
        *_of_albedo(result),
        _of_bounces(result),
        _of_gamma(result),
        *_of_evidence(result),
        *notes(result),
    )


def notes(result: Result | Iterate) -> tuple[str, ...]:
    """Return what was noted on the way: sentences of the setting "notes"."""
    return tuple(cast("tuple[str, ...]", result.problem.settings.get("notes") or ()))


def _of_scale(result: Result | Iterate) -> Iterator[str]:
    settings, how = result.problem.settings, scale_of(result)
    if how == "gain":
        yield "Distances are in mm, because the gain of the endoscope is known."
    elif how == "median distance":
        mm = cast("float", settings["median_distance"])
        yield f"Distances are in mm, because their median was said to be {mm:g} mm."
    elif how == "known distance":
        mm, *pixel = cast("KnownDistance", settings["known_distance"])
        where = _named((pixel[0], pixel[1]))
        yield f"Distances are in mm, because the surface at {where} was said to be {mm:g} mm away."
    elif how == "known diameter":
        mm, one, other = cast("KnownDiameter", settings["known_diameter"])
        where = f"{_named(one)} and {_named(other)}"
        yield f"Distances are in mm, because the points at {where} were said to be {mm:g} mm apart."
    elif result.problem.metric:
        yield "Distances are in mm, and the scale is carried over from the frame before."
    elif how == "none":
        yield "The gain is unknown: distances show the shape, and their unit is arbitrary."
    else:
        yield "The gain is unknown: distances have an arbitrary unit, nearly that of the frame before."
    if settings.get("by_gain") is not None:
        mm = cast("float", settings["by_gain"])
        yield f"By the gain of the calibration that length would be {mm:.3g} mm."


def _of_albedo(result: Result | Iterate) -> Iterator[str]:
    brdf = result.problem.photometry.brdf
    albedo = getattr(brdf, "albedo", None)
    at_zero = float(np.pi * brdf.value(np.ones(1), np.ones(1))[0]) if albedo is None else albedo
    name = "albedo" if albedo is not None else "reflectance (π times the BRDF, facing)"
    by_gain = scale_of(result) == "gain"  # else the value cancels
    yield (
        f"The wall is taken to have one {name}{f', {at_zero:.2g}' if by_gain else ''}; "
        "a patch that reflects 10 % more comes out 5 % too near."
    )
    if by_gain:
        yield (
            "Distances go with the square root of albedo times gain: "
            "if that product is 10 % higher than taken, every distance is 5 % too short."
        )


def _of_bounces(result: Result | Iterate) -> str:
    settings = result.problem.settings
    if settings.get("channel") != "separated":
        return (
            "Light that bounced from wall to wall counts as direct; in simulated colons it adds about "
            "120 % to red, 30 % to green and 20 % to blue."
        )
    albedo = cast("tuple[float, ...] | None", settings.get("albedo"))
    values = ", ".join(f"{one:.2g}" for one in albedo or ())
    told = f", with albedos of {values} (R, G, B)," if values else ""
    return f"Light that bounced from wall to wall was estimated{told} and taken out."


def _of_gamma(result: Result | Iterate) -> str:
    """Tell what an error of γ does: d goes with I^(-γ/2), and the scale keeps the median."""
    problem = result.problem
    said = problem.mask if problem.evidence is None else problem.mask & (problem.evidence != NONE)
    image = problem.image[said & (problem.image > 0)]
    low, middle, high = np.percentile(image, [5, 50, 95]) if image.size else np.ones(3)
    dark, bright = (abs(GAMMA_STEP / 2 * np.log(one / middle)) for one in (low, high))
    gamma = problem.photometry.gamma
    return (
        f"If γ were {gamma + GAMMA_STEP:.4g} and not {gamma:.4g}, the brightest twentieth of the pixels "
        f"would come out {-100 * np.expm1(-bright):.2g} % or more nearer and the darkest "
        f"{100 * np.expm1(dark):.2g} % or more farther, the median held."
    )


def _of_evidence(result: Result | Iterate) -> Iterator[str]:
    problem = result.problem
    total = int(problem.mask.sum())

    def share(count: int) -> str:
        return f"{count} of {total} pixels ({100 * count / max(total, 1):.2g} %)"

    if problem.evidence is None:
        return
    saturated, silent = (int((problem.evidence[problem.mask] == what).sum()) for what in (AT_LEAST, NONE))
    if saturated:
        yield f"The sensor is saturated in {share(saturated)}, which only say 'at least this bright'."
    if silent:
        yield (
            f"Highlights and overlays hide {share(silent)}, "
            "where the surface is what its neighbours make of it."
        )
