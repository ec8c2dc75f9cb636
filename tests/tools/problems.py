"""Problems to solve, made of the library's scenes, each with its truth, and how far a result is from it."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import endolab as el
from endolab.metrics.depth_errors import compare
from endolab.solvers.problem import Problem

ORDERS = ("first", "second")
every_variant = pytest.mark.parametrize(
    ("xi", "regulariser"), list(product(("1/z", "d", "1/d"), ORDERS))
)
every_regulariser = pytest.mark.parametrize("regulariser", ORDERS)
# A sheet with a sheen, half as bright again where it faces the light: its BRDF has kinks, and a cusp at 0.
SHEET = el.TabulatedBRDF(
    tuple(np.linspace(0, 1.5, 15)),
    tuple(0.2 + 0.1 * np.exp(-16 * np.linspace(0, 1.5, 15) ** 2)),
)
TISSUE = el.Photometry(brdf=el.Lambertian((0.75, 0.38, 0.30)))


def problem_of(
    scene,
    width=160,
    *,
    camera="simple",
    brdf=None,
    gain=1.0,
    noise=0.0,
    bits=None,
    mask=True,
    **options,
):
    """A rendered scene as a problem of these options, and its truth; nearly black pixels are left out.

    The camera is one of the library's at this width, or any; the gain in units of what fills the range.
    """
    if isinstance(camera, str):
        camera = el.load_calibration(camera, width).camera
    how = {"noise": noise, "bits": bits}
    seen = el.render(
        el.SCENES[scene], camera, el.Photometry(brdf=brdf or el.Lambertian(0.5)), **how
    )
    if gain != 1:
        photometry = replace(seen.photometry, gain=gain * seen.photometry.gain)
        seen = el.render(el.SCENES[scene], camera, photometry, **how)
    return Problem(
        seen.image,
        seen.mask & (seen.image > 0.02) & mask,
        camera,
        seen.photometry,
        **options,
    ), seen


def coloured_colon(camera, **options):
    """The colon in colour as a problem of its green channel, with its picture, and its truth."""
    seen = el.render(el.SCENES["colon"], camera, TISSUE)
    green = seen.image[..., 1]
    photometry = seen.photometry.channel("green")
    mask = seen.mask & (green > 1.5 / 255)
    return Problem(green, mask, camera, photometry, picture=seen.image, **options), seen


def at_truth(scene, width=160, **options):
    """A rendered scene as a problem, and its true log-distance."""
    problem, seen = problem_of(scene, width, **options)
    return problem, np.log(seen.distance)


def errors_of(result, seen, **options):
    """Errors of distance and normals of a result or an iterate."""
    return compare(
        result.distance,
        seen.distance,
        result.problem.field.cos_alpha,
        normals=result.normals,
        true_normals=seen.normals,
        **options,
    )


def percent_off(found, seen, where=None):
    """Mean error of distances, of a result or in a map, %: where they are known, or where said."""
    found, true = (getattr(one, "distance", one) for one in (found, seen))
    off = 100 * np.abs(found / true - 1)
    return np.mean(off[np.isfinite(off) if where is None else where])


def energies(result):
    """Of each iterate."""
    return np.array([entry["energy"] for entry in result.history])


def check_it_falls(result):
    """The energy falls with every iterate, and a distance is found for every pixel of the mask."""
    assert np.all(np.diff(energies(result)) < 0)
    assert np.all(np.isfinite(result.distance[result.mask]))


def border(seen, width):
    """True log-distances in the picture's border, (H, W), nan elsewhere: what comes in over it."""
    inflow = np.log(seen.distance)
    inflow[width:-width, width:-width] = np.nan
    return inflow


def relit(calibration, **changes):
    """The calibration with another light."""
    return replace(calibration, photometry=replace(calibration.photometry, **changes))
