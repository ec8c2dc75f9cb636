"""Answers to notebook 02: the right ones pass, each mistake that is known gets its own sentence."""

import numpy as np
import pytest

import endolab as el
from endolab.calibration.geometric import projection, reprojection
from endolab.calibration.simulation.trajectory import trajectory
from endolab.course import geometric_calibration as check

SHEET = el.TARGETS["vicalib_small"]


@pytest.fixture(scope="module")
def fit():
    """A camera from eight views, predicted."""
    truth = el.load_calibration("paper", width=640).camera
    views, noise = [], np.random.default_rng(0)
    for number, (pose,) in enumerate(trajectory(SHEET, truth, 8, tilt=np.deg2rad(40))):
        pixels = projection.predict_view(truth, pose, SHEET.points, SHEET.radii)
        pixels += noise.normal(0, 0.05, pixels.shape)
        inside = np.flatnonzero(((pixels > 3) & (pixels < [636, 476])).all(axis=1))
        views.append(reprojection.View(f"{number}", 0, inside, pixels[inside]))
    return el.calibrate_camera(views, SHEET, 640, 480, start=truth)


def test_as_many_views_as_are_needed_pass(fit):
    needed = 8 * (fit.standard_errors["fx"] / 0.02) ** 2
    assert check.exercise_1(needed, fit)
    assert check.exercise_1(round(1.05 * needed), fit)


@pytest.mark.parametrize(
    ("count", "said"),
    [
        (lambda share: 8 * share, "averages out more slowly"),
        (lambda share: 8 * share**0.5, "with which power"),
        (lambda share: 8, "more of them"),
        (lambda share: 30, "Too few"),
        (lambda share: 200, "Too many"),
    ],
)
def test_a_wrong_number_of_views_hears_what_is_wrong(fit, count, said):
    verdict = check.exercise_1(round(count(fit.standard_errors["fx"] / 0.02)), fit)
    assert verdict.right is False
    assert said in verdict.said


def test_the_factors_of_a_sheet_that_is_too_small_pass(fit):
    assert check.exercise_2(1, 1 / 0.97, 0.97**-2, fit, SHEET)
    assert check.exercise_2(1, 1.03, 1.06, fit, SHEET)
    assert check.exercise_2(..., ..., ..., fit, SHEET).right is None
    assert check.exercise_1(..., fit).right is None


@pytest.mark.parametrize(
    ("factors", "said"),
    [
        ((0.97, 1.03, 1.06), "knows nothing of mm"),
        ((3.09, 3, 6), "Answer with factors"),
        ((1, 0.97, 1.06), "other way round"),
        ((1, 1, 1), "as near as before"),
        ((1, 3.09, 6), "Answer with factors"),
        ((1, 1.1, 1.2), "As many times"),
        ((1, 1.03, 1.03), "*square*"),
        ((1, 1.03, 0.94), "more light, not less"),
        ((1, 1.03, 1), "as bright as before"),
        ((1, 1.03, 1.5), "g/d²"),
    ],
)
def test_wrong_factors_hear_what_is_wrong(fit, factors, said):
    verdict = check.exercise_2(*factors, fit, SHEET)
    assert verdict.right is False
    assert said in verdict.said
