"""Occluding contours: found where the truth has them, and nowhere else."""

import cv2
import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy import ndimage

from endolab.metrics.depth_errors import depth_cuts
from endolab.reconstruction import constants
from endolab.reconstruction.lines import find_contours
from endolab.reconstruction.problem_of_frame import make_problem
from tests.tools.cases import drawn


def seen(scene, width=320, **options):
    """A rendered frame, and the problem it poses."""
    case = drawn(scene, "simple", width, bits=8, **options)
    return case, make_problem(case.frame, case.calibration, channel="green")


def steep(problem):
    """The steep lines of its picture, (2, H, W)."""
    return find_contours(problem.log_d0, problem.mask) > constants.MIN_STEEPNESS[0]


def within(lines, others, pixels):
    """Share of the pixels of one drawing that have one of the other's nearby."""
    disc = cv2.getStructuringElement(
        cv2.MORPH_ELLIPSE, (2 * pixels + 1, 2 * pixels + 1)
    )
    return float(
        (lines & (cv2.dilate(others.astype(np.uint8), disc) > 0)).sum() / lines.sum()
    )


@pytest.mark.parametrize("width", [240, 480])
def test_folds_are_found_where_the_distance_jumps(width):
    """Precision and recall, of steep lines: measured 0.80 and 0.61 at 240 px, 0.63 and 0.76 at 480."""
    rendered, problem = seen("colon", width)
    edges = steep(problem).any(axis=0)
    true = depth_cuts(rendered.distance).any(axis=0)
    near = round(2 * width / 320)
    assert within(edges, true, near) > 0.6
    assert within(true, edges, near) > 0.55


@pytest.mark.parametrize("scene", ["plane", "curved"])
def test_smooth_walls_have_none(scene):
    assert not steep(seen(scene, noise=1, texture=0.1)[1]).any()


def test_a_tube_is_not_cut_along_its_wall():
    """Lines that ran up the dark wall before its end cut pieces off it, 87 % too far."""
    tube = drawn("tube", "simple", 160, noise=1, bits=8)
    result = tube.solve()
    assert np.abs(result.distance / tube.distance - 1)[result.mask].max() < 0.3


def test_a_step_is_one_closed_line_one_step_thin():
    """A disc that is farther: its rim is cut, all around, and nothing else."""
    rows, columns = np.indices((120, 160))
    inside = np.hypot(rows - 60, columns - 75) < 30
    steepness = find_contours(
        np.where(inside, 1.0, 0.5) + 0.001 * columns, np.ones(inside.shape, bool)
    )
    cuts = steepness > constants.MIN_STEEPNESS[0]
    # Grown to a grid of twice the size, with a wall at each cut: the disc is closed off from all else.
    fine = np.ones((240, 320), bool)
    fine[1::2, 1::2] = False
    fine[::2, 1::2] = ~cuts[0]
    fine[1::2, ::2] = ~cuts[1]
    region = ndimage.label(fine)[0][::2, ::2]
    assert np.abs((region == region[60, 75]) ^ inside).sum() < 30
    assert region[60, 75] == region[60, 60] != region[0, 0]


@pytest.mark.parametrize(("in_tissue", "place"), [(False, 99), (True, 95)])
def test_a_dark_strip_is_a_limb_but_in_tissue(in_tissue, place):
    """Near wall, dark strip, far wall: from left to right, and from right to left.

    A limb is cut on its far side; in tissue a strip is what a fold leaves in the dark behind it.
    """
    log_d0 = np.full((120, 320), 0.5)
    log_d0[:, 100:] = 1.0
    log_d0[:, 96:100] = 1.6
    for flip in (False, True):
        picture = log_d0[:, ::-1].copy() if flip else log_d0
        mask = np.ones(picture.shape, bool)
        steepness = find_contours(picture, mask, in_tissue)[0].mean(axis=0)
        cut = [int(np.argmax(steepness))]
        assert in_tissue or np.count_nonzero(steepness > 0.05) == 1
        at = 319 - cut[0] - 1 if flip else cut[0]
        assert abs(at - place) <= 1


def test_what_is_outside_the_mask_does_not_matter():
    problem = seen("colon", 240)[1]
    mask = problem.mask.copy()
    mask[:40] = False
    spoilt = np.where(mask, problem.log_d0, np.nan)
    steepness = find_contours(problem.log_d0, mask)
    assert_array_equal(find_contours(spoilt, mask), steepness)
    assert not steepness[:, :40].any()


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (2, 3)])
def test_tiny_pictures_and_empty_masks(shape):
    for mask in (np.ones(shape, bool), np.zeros(shape, bool)):
        assert find_contours(
            np.arange(mask.size, dtype=float).reshape(shape), mask
        ).shape == (2, *shape)
