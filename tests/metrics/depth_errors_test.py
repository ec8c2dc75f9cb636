"""Errors computed by hand."""

from dataclasses import asdict

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import endolab as el
from endolab.metrics.depth_errors import (
    angle_between,
    compare,
    depth_cuts,
    resample_truth,
)

TRUTH = np.array([[10.0, 20.0, 40.0], [50.0, np.nan, 80.0]])
ESTIMATE = np.array([[11.0, 18.0, 40.0], [54.0, 7.0, np.nan]])
COSINE = np.array([[1.0, 0.5, 0.8], [0.5, 1.0, 1.0]])
DEGREES = np.array([[0.0, 1.0, 2.0], [9.0, np.nan, np.nan]])


def leaning(degrees):
    """Unit normals that lean from the axis."""
    turn = np.deg2rad(degrees)
    return np.stack([np.sin(turn), 0 * turn, -np.cos(turn)], axis=-1)


def test_errors_by_hand():
    """Errors are 1, 2, 0 and 4 mm, or 10, 10, 0 and 8 %; the other two pixels are half known."""
    normals, true_normals = leaning(0 * DEGREES), leaning(DEGREES)
    how = {"normals": normals, "true_normals": true_normals}
    assert asdict(compare(ESTIMATE, TRUTH, COSINE, **how)) == pytest.approx(
        {
            "pixels": 4,
            "scale": 1.0,
            "shift": 0.0,
            "mean_mm": 7 / 4,
            "median_mm": 1.5,
            "rmse_mm": np.sqrt(21 / 4),
            "mean_percent": 7.0,
            "median_percent": 9.0,
            "rmse_z_mm": np.sqrt((1 + 1 + 0 + 4) / 4),
            "mean_degrees": 3.0,
            "median_degrees": 1.5,
            "within_125": 100.0,
            "within_125_squared": 100.0,
            "within_125_cubed": 100.0,
        }
    )
    assert np.isnan(compare(ESTIMATE, TRUTH, COSINE).mean_degrees)


def test_median_scale_undoes_a_factor_and_tolerates_outliers():
    estimate = TRUTH / 7
    estimate[0, 0] *= 5
    errors = compare(estimate, TRUTH, COSINE, align="scale")
    assert errors.scale == pytest.approx(7)
    assert errors.median_mm == pytest.approx(0, abs=1e-12)
    assert errors.mean_percent == pytest.approx(400 / 5)


def test_no_affine_estimate_is_nearer_than_all_of_the_truth():
    """The line through the middle ones leaves the first at -60 mm."""
    truth = np.array([[5.0, *np.linspace(10, 20, 500)]])
    estimate = truth.copy()
    estimate[0, 0] = 1e-3
    estimate[0, 1:] += 100
    errors = compare(estimate, truth, np.ones(truth.shape), align="affine")
    assert errors.within_125_cubed == 100


@pytest.mark.parametrize("unknown", [0.0, -3.0, np.inf, -np.inf, np.nan])
@pytest.mark.parametrize("which", [0, 1])
def test_what_is_no_distance_does_not_count(unknown, which):
    maps = [np.full((3, 4), 10.0), np.full((3, 4), 11.0)]
    maps[which][0, 0] = unknown
    found = compare(*maps, np.ones((3, 4)), align="scale")
    assert (found.pixels, found.mean_mm) == (11, pytest.approx(0.0))


@pytest.mark.parametrize("degrees", [0.0, 1e-9, 1e-5, 1.0, 90.0, 179.0, 180.0])
def test_angles_are_exact_however_small(degrees):
    found = angle_between(leaning(0.0), leaning(degrees))
    assert found == pytest.approx(degrees, rel=1e-9, abs=0)


def test_jumps_of_the_distance_are_cuts_to_the_right_and_downwards():
    """Steps of 0.05, 0.1 and 1 in the logarithm, to the right, back to the left, and downwards."""
    log_distance = np.array([[0.0, 0.05, 0.15, 0.05], [0.0, 0.05, 1.15, 0.05]])
    right = [[0, 1, 1, 0], [0, 1, 1, 0]]
    lower = [[0, 0, 1, 0], [0, 0, 0, 0]]
    for scale in (1e-3, 1.0, 40.0):
        assert_array_equal(depth_cuts(scale * np.exp(log_distance)), [right, lower])
    unknown = np.array([[1.0, np.nan, 2.0], [1.0, 4.0, 2.0]])
    assert_array_equal(depth_cuts(unknown), [[[0, 0, 0], [1, 1, 0]], np.zeros((2, 3))])


@pytest.mark.parametrize(
    ("width", "off", "degrees"),
    [(160, 5e-4, 0.1), (100, 5e-4, 0.1), (320, 5e-4, 0.1), (480, 5e-3, 0.5)],
)
@pytest.mark.parametrize("scene", ["plane", "curved"])
def test_truth_on_another_grid_is_the_scenes_own(scene, width, off, degrees):
    """Distance and normals are those at the centres of the other grid's pixels."""
    whole, other = (
        el.render(el.SCENES[scene], known.camera, known.photometry)
        for known in (el.load_calibration("simple", width=w) for w in (320, width))
    )
    found = resample_truth(whole.distance, other.mask.shape)
    assert_allclose(found, other.distance, rtol=off)
    normals = resample_truth(whole.normals, other.mask.shape)
    assert angle_between(normals, other.normals).max() < degrees


def test_truth_on_another_grid_is_unknown_where_most_of_it_was():
    truth = np.full((4, 6), 8.0)
    truth[:2, 0] = truth[:2, 2:4] = truth[2, 4] = np.nan
    assert_array_equal(resample_truth(truth, (2, 3)), [[8, np.nan, 8], [8, 8, 8]])
    assert_array_equal(resample_truth(truth, (4, 6)), truth)
