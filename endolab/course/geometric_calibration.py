"""Checks of notebook 02: how many views an error takes, and what a sheet of a wrong size makes wrong."""

from dataclasses import replace

import numpy as np

from endolab.calibration.geometric.fit import GeometricFit, calibrate_camera
from endolab.calibration.targets import DotGrid
from endolab.course.verdict import Wrong, alike, verdict

WANTED = 0.02  # px, standard error of fx
SHRUNK = 0.97  # of its size, a sheet that was printed


@verdict
def exercise_1(count: float, some: GeometricFit) -> str:
    """Check how many views such as those of a fit it takes until f_x has a standard error of 0.02 px."""
    views, error = len(some.views), some.standard_errors["fx"]
    needed = views * (error / WANTED) ** 2
    if count <= views:
        raise Wrong(f"{views} views leave ± {error:.3f} px; a smaller error takes more of them.")
    if not 0.9 < count / needed < 1.15:
        wrong = {
            "So it would be if twice the views halved the error. Noise averages out more slowly.": (
                views * error / WANTED
            ),
            "The error goes with the root of the number; so the number, with which power of the error?": (
                views * np.sqrt(error / WANTED)
            ),
        }
        much = "few" if count < needed else "many"
        raise Wrong(
            alike(count, wrong, f"Too {much}. What part of an error do four times the views leave?", 0.05)
        )
    return f"If errors are independent, {needed:.0f} views: {error / WANTED:.2f} times as sure, squared."


@verdict
def exercise_2(focal: float, distance: float, gain: float, fit: GeometricFit, sheet: DotGrid) -> str:
    """Check by which factors results are wrong if the printed sheet is 97 % of what one takes it for.

    Of the focal length, the sheet's distance and the light's gain; `fit` is right, with the true `sheet`.
    """
    taken_for = {name: getattr(sheet, name) / SHRUNK for name in ("spacing", "small", "large")}
    size = fit.camera.width, fit.camera.height
    other = calibrate_camera(fit.views, replace(sheet, **taken_for), *size, start=fit.camera)
    of_focal = other.camera.fx / fit.camera.fx
    away = [float(np.linalg.norm(one.poses[0].translation)) for one in (other, fit)]
    of_distance = away[0] / away[1]
    percent = "Answer with factors: 1.5 for half as much again."
    if not np.isclose(focal, of_focal, rtol=0.002):
        otherwise = "The focal length is in pixels, and a picture knows nothing of mm."
        raise Wrong(alike(focal, {percent: 100 * (of_distance - 1)}, otherwise, 0.002))
    if not np.isclose(distance, of_distance, rtol=0.002):
        wrong = {
            "The other way round: a sheet that is taken for larger seems to be where?": SHRUNK,
            percent: 100 * (of_distance - 1),
            "What is taken for larger, and looks as it did: is it as near as before?": 1.0,
        }
        raise Wrong(alike(distance, wrong, "As many times as far as the sheet is taken for larger.", 0.002))
    if not np.isclose(gain, of_distance**2, rtol=0.005):
        wrong = {
            "Light goes with the *square* of the distance.": of_distance,
            "So bright, from so far away? That takes more light, not less.": of_distance**-2,
            "The wall seems farther away, and is as bright as before: what does that say of the light?": 1.0,
        }
        raise Wrong(alike(gain, wrong, "The model has g/d²: what becomes of g if d is wrong?", 0.005))
    return (
        f"The camera stays, all distances are {of_distance - 1:.1%} too large, the gains "
        f"{of_distance**2 - 1:.1%}, and with them the mm of every reconstruction."
    )
