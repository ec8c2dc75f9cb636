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


def test_errors_by_hand():
    """Errors are 1, 2, 0 and 4 mm, or 10, 10, 0 and 8 %; the other two pixels are half known."""
    errors = asdict(compare(ESTIMATE, TRUTH, COSINE))
    assert np.isnan(errors.pop("mean_degrees"))
    assert np.isnan(errors.pop("median_degrees"))
    expected = {"pixels": 4, "scale": 1.0, "mean_percent": 7.0, "median_percent": 9.0}
    expected |= {"mean_mm": 7 / 4, "median_mm": 1.5, "rmse_mm": np.sqrt(21 / 4)}
    expected |= dict.fromkeys(
        ("within_125", "within_125_squared", "within_125_cubed"), 100.0
    )
    assert errors == pytest.approx(
        expected | {"rmse_z_mm": np.sqrt((1 + 1 + 0 + 4) / 4)}
    )


def test_median_scale_undoes_a_factor_and_tolerates_outliers():
    estimate = TRUTH / 7
    estimate[0, 0] *= 5
    errors = compare(estimate, TRUTH, COSINE, scale="median")
    assert errors.scale == pytest.approx(7)
    assert errors.median_mm == pytest.approx(0, abs=1e-12)
    assert errors.mean_percent == pytest.approx(400 / 5)


def test_shares_within_125_and_the_ratio_of_medians():
    """Ratios of 1.2, 1/1.2, 1.5, 1/1.6 and 2."""
    truth = np.full((1, 5), 30.0)
    estimate = truth * [1.2, 1 / 1.2, 1.5, 1 / 1.6, 2.0]
    errors = compare(estimate, truth, np.ones((1, 5)))
    shares = errors.within_125, errors.within_125_squared, errors.within_125_cubed
    assert shares == pytest.approx((40, 60, 80))
    cosine = np.array([[1.0, 0.5, 0.8, 0.9, 0.6]])
    errors = compare(estimate, truth, cosine, scale="medians")
    assert errors.scale == pytest.approx(1 / 1.2)


@pytest.mark.parametrize("unknown", [0.0, -3.0, np.inf, -np.inf, np.nan])
@pytest.mark.parametrize("which", [0, 1])
def test_what_is_no_distance_does_not_count(unknown, which):
    maps = [np.full((3, 4), 10.0), np.full((3, 4), 11.0)]
    maps[which][0, 0] = unknown
    found = compare(*maps, np.ones((3, 4)), scale="median")
    assert (found.pixels, found.mean_mm) == (11, pytest.approx(0.0))


def test_normals_count_where_both_distances_are_known():
    normals = np.full((2, 3, 3), np.nan)
    true_normals = np.full((2, 3, 3), np.nan)
    angles = np.deg2rad([0.0, 1.0, 2.0, 9.0])
    known = np.isfinite(TRUTH) & np.isfinite(ESTIMATE)
    normals[known] = [0.0, 0.0, -1.0]
    true_normals[known] = np.stack(
        [np.sin(angles), 0 * angles, -np.cos(angles)], axis=-1
    )
    errors = compare(
        ESTIMATE, TRUTH, COSINE, normals=normals, true_normals=true_normals
    )
    assert (errors.mean_degrees, errors.median_degrees) == pytest.approx((3.0, 1.5))


@pytest.mark.parametrize("degrees", [0.0, 1e-9, 1e-5, 1.0, 90.0, 179.0, 180.0])
def test_angles_are_exact_however_small(degrees):
    turn = np.deg2rad(degrees)
    a = np.array([1.0, 0.0, 0.0])
    b = np.array([np.cos(turn), 0.0, np.sin(turn)])
    assert angle_between(a, b) == pytest.approx(degrees, rel=1e-9, abs=0)


def test_jumps_of_the_distance_are_cuts_to_the_right_and_downwards():
    """Steps of 0.05, 0.1 and 1 in the logarithm, to the right, back to the left, and downwards."""
    log_distance = np.array([[0.0, 0.05, 0.15, 0.05], [0.0, 0.05, 1.15, 0.05]])
    right = np.array([[False, True, True, False], [False, True, True, False]])
    lower = np.array([[False, False, True, False], [False, False, False, False]])
    for scale in (1e-3, 1.0, 40.0):
        cuts = depth_cuts(scale * np.exp(log_distance))
        assert cuts.dtype == bool
        assert_array_equal(cuts, [right, lower])
    unknown = np.array([[1.0, np.nan, 2.0], [1.0, 4.0, 2.0]])
    assert_array_equal(depth_cuts(unknown), [[[0, 0, 0], [1, 1, 0]], np.zeros((2, 3))])


@pytest.mark.parametrize("width", [160, 100, 320, 480])
@pytest.mark.parametrize("scene", ["plane", "curved"])
def test_truth_on_another_grid_is_the_scenes_own(scene, width):
    """Distance and normals are those at the centres of the other grid's pixels; to 0.05 %, 0.1°."""
    whole = el.load_calibration("simple").camera
    other = el.load_calibration("simple", width=width).camera
    surface = el.SCENES[scene]
    shape = (other.height, other.width)
    (points, there) = (
        surface.distance(c.field.rays)[..., None] * c.field.rays for c in (whole, other)
    )
    found = resample_truth(np.linalg.norm(points, axis=-1), shape)
    assert_allclose(
        found, np.linalg.norm(there, axis=-1), rtol=5e-4 if width <= 320 else 5e-3
    )
    normals = resample_truth(surface.normals(points), shape)
    assert angle_between(normals, surface.normals(there)).max() < (
        0.1 if width <= 320 else 0.5
    )


def test_truth_on_another_grid_is_unknown_where_most_of_it_was():
    truth = np.full((4, 6), 8.0)
    truth[:2, 0] = truth[:2, 2:4] = truth[2, 4] = np.nan
    assert_array_equal(resample_truth(truth, (2, 3)), [[8, np.nan, 8], [8, 8, 8]])
    assert_array_equal(resample_truth(truth, (4, 6)), truth)
