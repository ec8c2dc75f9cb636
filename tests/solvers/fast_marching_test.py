"""Fast marching against exact scenes, and in its invariances."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import endolab as el
from endolab.solvers.solvers import fast_marching
from tests.tools.cuts import between
from tests.tools.problems import SHEET, border, errors_of, percent_off, problem_of


def march_distances(problem, **options):
    """Distances."""
    return el.run(fast_marching(problem, **options)).distance


@pytest.mark.parametrize("scene", ["plane", "curved"])
def test_smooth_scenes_are_exact_to_second_order(scene):
    percent = []
    for width in (80, 160, 320):
        problem, seen = problem_of(scene, width)
        errors = errors_of(el.run(fast_marching(problem)), seen)
        percent.append(errors.mean_percent)
    assert errors.mean_percent < 0.002
    assert errors.mean_degrees < 0.01
    assert np.diff(np.log2(percent)).max() < -1.7


def test_the_tube_needs_its_border():
    """The border of the tube is inflow: wrong without its values (as the paper is), right with them."""
    problem, seen = problem_of("tube", 320)
    inflow = border(seen, 2)
    without = march_distances(problem)
    given = march_distances(problem, inflow=inflow)
    assert percent_off(without, seen) < 9
    assert percent_off(given, seen) < 0.3
    assert_allclose(np.log(given)[:2], inflow[:2], rtol=1e-12)


@pytest.mark.parametrize("brdf", [None, SHEET], ids=["lambertian", "tabulated"])
def test_the_frame_is_explained(brdf):
    """The model of the marched surface is the frame, whatever the BRDF: below a tenth of a grey level."""
    problem, seen = problem_of("curved", 160, brdf=brdf)
    result = el.run(fast_marching(problem))
    assert 255 * np.sqrt(2 * result.iterate.terms["data"]) < 0.1
    assert percent_off(result, seen) < 0.05


def test_what_lies_outside_the_mask_is_not_read():
    problem, _ = problem_of("curved", 80)
    mask = problem.mask & (np.indices(problem.mask.shape).sum(axis=0) % 7 > 0)
    images = (problem.image, np.where(mask, problem.image, np.nan))
    clean, spoilt = (
        march_distances(replace(problem, mask=mask, image=image)) for image in images
    )
    assert_array_equal(spoilt, clean)


def test_the_front_advances_and_ends_where_one_pass_ends():
    problem, _ = problem_of("colon", 120, camera="paper")
    steps = []
    result = el.run(fast_marching(problem, snapshots=7), [steps.append])
    arrived = [step.maps["arrived"] for step in steps]
    assert not arrived[0].any()
    assert np.array_equal(arrived[-1], problem.mask)
    assert all(np.all(late | ~early) for early, late in pairwise(arrived))
    assert all(np.all(np.isfinite(step.log_distance[problem.mask])) for step in steps)
    assert_array_equal(
        steps[-1].log_distance, el.run(fast_marching(problem)).iterate.log_distance
    )
    assert [step.k for step in steps] == list(range(8))
    assert result.status is el.Status.CONVERGED


def test_contours_that_meet_at_corners_and_holes_do_not_leak(rng):
    """A random patchwork: each patch, whatever its neighbours show, is the same."""
    problem, _ = problem_of("curved", 80)
    labels = rng.integers(0, 3, (30, 40)).repeat(2, axis=0).repeat(2, axis=1)
    labels[::7, ::3] += 1
    mask = problem.mask & (rng.random(labels.shape) > 0.1)
    cut_problem = replace(problem, mask=mask, cuts=between(labels))
    expected = march_distances(cut_problem)
    for label in range(4):
        patch = mask & (labels == label)
        image = np.where(patch, cut_problem.image, rng.uniform(0.1, 1, labels.shape))
        assert_array_equal(
            march_distances(replace(cut_problem, image=image))[patch], expected[patch]
        )
