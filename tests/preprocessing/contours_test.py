"""Occluding contours: found where the truth has them, and nowhere else."""

import cv2
import numpy as np
import pytest
from numpy.testing import assert_array_equal

import endolab as el
from endolab import datasets
from endolab.metrics.depth_errors import occlusion_cuts
from endolab.preprocessing.contours import find_contours
from endolab.reconstruction.problem_setup import make_problem
from tests.tools.problems import percent_off


def seen(scene, width=320, **options):
    """A rendered frame, its calibration, and the problem it poses."""
    known = datasets.load_calibration("simple", width)
    rendered = el.render(el.SCENES[scene], known.camera, known.photometry, bits=8, **options)
    known = el.Calibration(rendered.camera, rendered.photometry)
    frame = el.Frame(rendered.image, rendered.mask)
    return rendered, frame, known, make_problem(frame, known, channel="green")


def within(lines, others, pixels):
    """Share of the pixels of one drawing that have one of the other's nearby."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * pixels + 1, 2 * pixels + 1))
    return float((lines & (cv2.dilate(others.astype(np.uint8), disc) > 0)).sum() / lines.sum())


@pytest.mark.parametrize("width", [240, 480])
def test_folds_are_found_where_the_distance_jumps(width):
    rendered, _, _, problem = seen("colon", width, noise=1)
    edges, cuts = find_contours(problem.log_facing, problem.mask)
    true, near = occlusion_cuts(rendered.distance).any(axis=0), round(4 * width / 320)
    assert within(edges, true, near) > 0.65
    assert within(true, edges, near) > 0.8
    assert cuts.shape == (2, *edges.shape)


@pytest.mark.parametrize("scene", ["plane", "curved"])
def test_smooth_walls_have_none(scene):
    problem = seen(scene, noise=1, texture=0.1)[3]
    edges, cuts = find_contours(problem.log_facing, problem.mask)
    assert edges.mean() < 0.001
    assert cuts.mean() < 0.002


def test_a_vessel_is_no_contour():
    problem = seen("curved")[3]
    log_facing, line = problem.log_facing.copy(), np.array([[20, 60], [150, 130], [300, 90]])
    cv2.polylines(log_facing, [line], False, float(np.median(log_facing)) + 0.2, 2)
    assert not find_contours(log_facing, problem.mask)[0].any()


def test_the_cuts_help_the_march():
    rendered, frame, known, problem = seen("colon", noise=1)
    cuts = find_contours(problem.log_facing, problem.mask)[1]
    whole, torn = (el.reconstruct(frame, known, solver="fast_marching", cuts=each) for each in (None, cuts))
    assert percent_off(torn, rendered) < 0.9 * percent_off(whole, rendered)


def test_what_is_outside_the_mask_does_not_matter():
    problem = seen("colon", 240)[3]
    mask = problem.mask.copy()
    mask[:40] = False
    spoilt = np.where(mask, problem.log_facing, np.nan)
    for one, other in zip(find_contours(problem.log_facing, mask), find_contours(spoilt, mask), strict=True):
        assert_array_equal(one, other)
        assert not one[..., :39, :].any()
