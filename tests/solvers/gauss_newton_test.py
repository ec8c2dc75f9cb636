"""Gauss-Newton: its energies, its accuracy, its starts and ends, and frames that show hardly anything."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import endolab as el
from endolab.metrics.depth_errors import depth_cuts
from endolab.numerics.threads import limit_threads
from endolab.solvers.energy import energy_terms
from endolab.solvers.gauss_newton import Look, gauss_newton
from endolab.solvers.grid import CEILING
from endolab.solvers.problem import Problem
from tests.tools.cuts import between
from tests.tools.problems import (
    border,
    check_it_falls,
    energies,
    errors_of,
    every_regulariser,
    every_variant,
    percent_off,
    problem_of,
)

ENDED = (el.Status.CONVERGED, el.Status.STALLED)


def solve(problem, **options):
    return el.run(gauss_newton(problem, **options))


@pytest.fixture(scope="module")
def tube():
    """A small tube: problem, truth, result."""
    problem, seen = problem_of("tube", 160)
    return problem, seen, solve(problem)


@pytest.mark.parametrize("camera", ["simple", "paper"])
@pytest.mark.parametrize("scene", ["tube", "colon"])
@every_variant
def test_the_energy_falls_with_every_iterate(camera, scene, regulariser, xi):
    problem, _ = problem_of(scene, 96, camera=camera, xi=xi, regulariser=regulariser)
    result = solve(problem)
    assert result.iterations >= 2
    check_it_falls(result)
    assert result.energy < energies(result)[0] / 2
    expected = energy_terms(problem, result.iterate.log_distance)
    assert dict(result.iterate.terms) == pytest.approx(expected, rel=1e-10)


FISHEYE = {"width": 160, "camera": "paper"}


@pytest.mark.parametrize(
    ("scene", "how", "limit", "degrees"),
    [
        ("plane", {}, 0.01, 0.05),
        ("curved", {}, 0.01, 0.05),
        ("tube", {}, 2.0, 4.0),
        ("plane", {"noise": 3.0, "bits": 8}, 0.15, 3),
        ("curved", {"noise": 3.0, "bits": 8}, 0.15, 3),
        ("tube", {"noise": 3.0, "bits": 8}, 4.0, 9),
        ("curved", FISHEYE, 0.3, 3),
        ("tube", FISHEYE, 0.4, 3),
    ],
)
def test_frames_exact_with_three_grey_levels_of_noise_and_of_a_fisheye(
    scene, how, limit, degrees
):
    """Measured 0.003 %, 0.013°; 0.002 %, 0.020°; 1.12 %, 2.2°; 0.05, 0.05 %; 2.7 %. All with one λ.

    The fisheye's border looks at walls that are near: 0.15 and 0.16 %.
    """
    problem, seen = problem_of(scene, **{"width": 320, **how})
    result = solve(problem)
    found = errors_of(result, seen)
    assert found.pixels > 0.97 * problem.mask.sum()
    assert found.mean_percent < limit
    assert found.mean_degrees < degrees
    assert result.status is el.Status.CONVERGED
    assert result.iterations <= 12


@pytest.mark.parametrize("width", [96, 160])
def test_the_colon_without_its_contours_and_with_them(width):
    """Measured 7.6 % and 2.2 % at 96 px, 7.3 % and 2.6 % at 160."""
    problem, seen = problem_of("colon", width)
    cut_problem = replace(problem, cuts=depth_cuts(seen.distance))
    results = [solve(each) for each in (problem, cut_problem)]
    assert {result.status for result in results} == {el.Status.CONVERGED}
    uncut, cut = (percent_off(result, seen) for result in results)
    assert uncut < 9
    assert cut < min(3.5, uncut)


@pytest.mark.parametrize("share", [0.02, 0.3])
@every_variant
def test_cuts_all_over_leave_islands_that_stay_where_they_can_be_seen(
    rng, xi, regulariser, share
):
    problem, _ = problem_of("colon", 96, xi=xi, regulariser=regulariser)
    problem = replace(problem, cuts=rng.random((2, *problem.mask.shape)) < share)
    for start in (None, problem.log_d0):
        result = solve(problem, start=start)
        check_it_falls(result)
        above = result.iterate.log_distance - problem.log_d0
        assert np.nanmax(above) <= CEILING + 1e-12


def test_islands_share_the_number_of_steps_and_nothing_else(rng):
    """Measured 1e-4 beside noise, whose steps are shorter, in the worst pixel."""
    problem, _ = problem_of("curved", 96)
    columns = np.indices(problem.mask.shape)[1]
    mask = problem.mask & (abs(columns - 40.5) > 1)
    noise = np.where(columns > 41, rng.uniform(0.05, 1.0, mask.shape), problem.image)
    both = replace(problem, mask=mask)
    beside = replace(both, image=noise)
    beside.__dict__["xi_median"] = both.xi_median  # of the whole frame, so shared
    left = mask & (columns < 40)
    found, expected = (solve(each).distance[left] for each in (beside, both))
    assert_allclose(found, expected, rtol=1e-3)


def test_an_island_that_is_drawn_to_the_ceiling_holds_up_no_step():
    """Too dark to be explained: it would go ever farther. From a surface in which it was no island."""
    problem, _ = problem_of("curved", 96)
    inside = np.zeros(problem.mask.shape, bool)
    inside[30:33, 40:43] = True
    dark = np.where(inside, 0.02, 1.0) * problem.image
    cut_problem = replace(problem, image=dark, cuts=between(inside))
    cold = solve(cut_problem)
    warm = solve(cut_problem, start=solve(problem).iterate.log_distance)
    assert cold.status is warm.status is el.Status.CONVERGED
    assert warm.energy < 1.05 * cold.energy


def test_the_tube_with_its_border_given(tube):
    """Measured 0.046 %; what is given is kept to the bit."""
    problem, seen, without = tube
    inflow = border(seen, 1)
    given = np.isfinite(inflow) & problem.mask
    for start in (None, problem.log_d0):
        result = solve(problem, inflow=inflow, start=start)
        assert_array_equal(result.iterate.log_distance[given], inflow[given])
        assert np.all(np.diff(energies(result)) < 0)
        if start is None:
            assert percent_off(result, seen) < 0.1 < percent_off(without, seen) / 5


@pytest.mark.parametrize("lam", [0.9, 1.1])
def test_a_little_more_or_less_smoothness_is_two_steps_away(tube, lam):
    problem, seen, first = tube
    problem = replace(problem, lam=lam)
    result = solve(problem, start=first.iterate.log_distance)
    assert result.status is el.Status.CONVERGED
    assert result.iterations <= 2
    assert result.energy < energies(result)[0]
    assert result.energy < 1.02 * solve(problem).energy
    assert percent_off(result, seen) < 2


def test_a_far_start_is_brought_near_on_coarser_grids():
    """From the surface four columns aside, as in a video."""
    problem, _ = problem_of("colon", 160, noise=1, bits=8)
    cold = solve(problem)
    near = solve(problem, start=np.roll(cold.iterate.log_distance, 4, axis=1))
    assert near.status is el.Status.CONVERGED
    assert np.all(np.diff(energies(near)) < 0)
    assert near.iterations <= cold.iterations
    assert near.energy < 1.02 * cold.energy


def test_what_follows_from_a_look_is_the_same_without_asking_coarser_grids():
    problem, _ = problem_of("colon", 160, noise=1, bits=8)
    look = Look(solve(problem).iterate)
    other = replace(problem, lam=2.0)
    start = look.follow(other).log_distance
    asked, near = (solve(other, start=start, halvings=halvings) for halvings in (2, 0))
    assert near.status is el.Status.CONVERGED
    assert near.energy < 1.01 * asked.energy


@pytest.mark.parametrize(
    ("lam", "light"), [(3.0, {}), (10.0, {}), (1.0, {"k": 1.5, "gamma": 1.9})]
)
def test_a_look_goes_a_good_part_of_the_way_to_another_energy(lam, light):
    """And at the old one it shows the old surface; measured 0.16 % off."""
    problem, _ = problem_of("colon", 160, noise=1, bits=8)
    start = solve(problem).iterate
    other = replace(problem, lam=lam, photometry=replace(problem.photometry, **light))
    there = solve(other, start=start.log_distance, tolerance=1e-3).iterate.log_distance
    look = Look(start)
    at_rest = look.follow(problem).log_distance
    assert np.nanmean(np.abs(at_rest - start.log_distance)) < 3e-3
    for _ in range(6):
        seen = look.follow(other).log_distance
    before, left = (np.nanmean(np.abs(v - there)) for v in (start.log_distance, seen))
    assert left < 0.7 * before


def test_slow_falls_are_not_taken_for_the_end():
    """Falls of 1 to 2 % go on for twenty steps. Measured 2.3 % left; 29 % if one promise of 1 % is enough."""
    problem, _ = problem_of(
        "colon", 96, xi="1/z", regulariser="first", lam=1.8, noise=3, bits=8
    )
    result = solve(problem)
    assert result.status is el.Status.CONVERGED
    start = result.iterate.log_distance
    further = solve(problem, start=start, tolerance=1e-3, max_iterations=60)
    assert further.energy > 0.95 * result.energy


@pytest.mark.parametrize(("name", "value"), [("start", np.nan), ("inflow", np.inf)])
def test_a_start_that_cannot_be_used_is_refused(name, value):
    for shape in ((60, 80), (3, 4)):
        with pytest.raises(ValueError, match=name):
            solve(problem_of("plane", 80)[0], **{name: np.full(shape, value)})


@every_regulariser
def test_a_run_is_the_same_bit_for_bit_on_any_number_of_threads(all_cores, regulariser):
    problem, seen = problem_of("colon", 160, regulariser=regulariser, noise=1, bits=8)
    cut_problem = replace(problem, cuts=depth_cuts(seen.distance))
    for each in (problem, cut_problem):
        with limit_threads(1):
            alone = solve(each, max_iterations=8).distance
        with limit_threads(2):
            together = solve(each, max_iterations=8).distance
        assert_array_equal(alone, together)


ROWS, COLUMNS = np.indices((72, 96))
MASKS = {
    "one pixel": (ROWS == 30) & (COLUMNS == 30),
    "single pixels": (ROWS % 3 == 0) & (COLUMNS % 3 == 0),
    "a row": ROWS == 30,
    "a column": COLUMNS == 30,
    "a diagonal": ROWS == COLUMNS,
    "lines": (ROWS % 9 == 0)
    | (COLUMNS % 11 == 0)
    | ((ROWS % 4 == 0) & (COLUMNS % 3 == 0)),
    "a checkerboard": (ROWS + COLUMNS) % 2 == 0,
}


@pytest.mark.parametrize("mask", MASKS.values(), ids=MASKS)
@pytest.mark.parametrize("scene", ["tube", "colon"])
def test_thin_masks(scene, mask):
    result = solve(problem_of(scene, 96, mask=mask)[0])
    check_it_falls(result)
    assert np.all(np.isnan(result.distance[~mask]))
    assert result.status is not el.Status.NON_FINITE


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (7, 1), (2, 2), (3, 5), (30, 2)])
def test_tiny_frames(size):
    height, width = size
    camera = el.Pinhole(width, height, 6.0, 6.0, (width - 1) / 2, (height - 1) / 2)
    seen = el.render(el.SCENES["curved"], camera, el.Photometry())
    result = solve(Problem(seen.image, seen.mask, camera, seen.photometry))
    assert result.status in ENDED
    assert np.all(np.isfinite(result.distance))


POOR = {
    "constant": lambda levels, noise: 127.5,
    "black": lambda levels, noise: 1,
    "nearly black": lambda levels, noise: np.maximum(2.5 + noise, 1),
    "saturated": lambda levels, noise: 255,
    "clipped": lambda levels, noise: np.minimum(3 * levels, 255),
    "a lumen below one level": lambda levels, noise: np.maximum(
        np.round(0.05 * levels), 0.5
    ),
}


@pytest.mark.parametrize("spoil", POOR.values(), ids=POOR)
def test_poor_frames(rng, spoil):
    problem, _ = problem_of("colon", 96)
    everywhere = np.ones_like(problem.mask)
    levels = spoil(255 * problem.image, rng.normal(size=everywhere.shape)) * everywhere
    result = solve(replace(problem, image=levels / 255, mask=everywhere))
    assert result.status in ENDED
    check_it_falls(result)


@pytest.mark.parametrize("scene", ["tube", "plane"])
@pytest.mark.parametrize("lam", [0.0, 1e-6, 1e6])
def test_any_lam(scene, lam):
    problem, seen = problem_of(scene, 96, lam=lam)
    result = solve(problem)
    check_it_falls(result)
    if lam > 1:  # 1/d is straight then, whatever the frame shows
        assert result.iterate.terms["regulariser"] < 0.01 * energies(result)[0]
    elif scene == "plane":
        assert result.status is el.Status.CONVERGED
        assert percent_off(result, seen) < 0.05


def test_a_frame_that_is_explained_exactly_has_converged():
    """Energies of 1e-32 are rounding, and nothing promises less of them."""
    result = solve(problem_of("colon", 96, mask=MASKS["single pixels"])[0])
    assert result.status is el.Status.CONVERGED
    assert result.energy < 1e-24
    log_distance = result.iterate.log_distance
    assert_allclose(log_distance, result.problem.log_d0, rtol=0, atol=1e-9)
