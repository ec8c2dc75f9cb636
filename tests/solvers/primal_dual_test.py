"""The primal-dual path against its equations in plain NumPy, its stability bound, and known surfaces."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

import endolab as el
from endolab.model.brdf import Glossy
from endolab.numerics.threads import limit_threads
from endolab.solvers.energy import model_image
from endolab.solvers.primal_dual import _Path, primal_dual
from endolab.solvers.problem import Problem
from tests.solvers.primal_dual_model import PrimalDualModel
from tests.tools.problems import (
    SHEET,
    energies,
    errors_of,
    every_regulariser,
    every_variant,
    problem_of,
)

CAMERA = el.Pinhole(19, 15, 9.0, 10.4, 8.8, 7.1)


def problem_with_holes(rng, brdf=None, **options):
    """A rough surface with holes and cuts, and a frame that it nearly explains."""
    shape = (CAMERA.height, CAMERA.width)
    mask = np.ones(shape, dtype=bool)
    cuts = rng.random((2, *shape)) < 0.1
    mask[4:7, 3:6] = mask[0, 0] = mask[10:, 9] = False
    photometry = el.Photometry(
        k=1.7, gamma=2.0, gain=900.0, brdf=brdf or el.Lambertian(0.6)
    )
    v = np.log(20) + ndimage.gaussian_filter(0.3 * rng.normal(size=shape), 1)
    problem = Problem(
        np.full(shape, 0.5), mask, CAMERA, photometry, cuts=cuts, **options
    )
    noise = rng.choice([0.01, 0.06], shape) * rng.normal(size=shape)
    seen = np.where(mask, model_image(problem, v) + noise, 0.5)
    return replace(problem, image=np.clip(seen, 0.2, 0.95)), v


@every_variant
@pytest.mark.parametrize("radius", [0, 3])
def test_compiled_steps_are_those_of_the_equations(rng, xi, regulariser, radius):
    problem, v = problem_with_holes(
        rng, xi=xi, regulariser=regulariser, lam=0.3, epsilon=1e-3
    )
    path = _Path.at(problem, v, radius, 0.8)
    twin = PrimalDualModel(problem, v, radius, 0.8)
    for theta in (1.0, 0.05, 0.02, 0.02):
        path.advance(1, theta)
        twin.step(theta)
    inside = problem.mask
    np.testing.assert_allclose(
        path.log_distance[inside], twin.v[inside], rtol=0, atol=3e-6
    )
    assert np.abs(twin.v - v)[inside].max() > 1e-3
    limit = 1 / (1 + path.state.limit[1:-1, 1:-1][inside])
    np.testing.assert_allclose(limit, twin.limit[inside], rtol=1e-4)
    np.testing.assert_allclose(
        path.state.q[: len(twin.q), 1:-1, 1:-1], twin.q, rtol=0, atol=1e-6
    )


@pytest.mark.parametrize(
    ("brdf", "radius", "off"),
    [
        (Glossy(0.5, 0.02, 8.0), 1, 3e-6),
        (SHEET, 1, 1e-3),
        (None, 5, 3e-6),
        (None, 16, 3e-6),
    ],
)
def test_another_brdf_than_a_lambertian_one_and_larger_patches(rng, brdf, radius, off):
    problem, v = problem_with_holes(rng, brdf, lam=0.3)
    path = _Path.at(problem, v, radius, 0.8)
    twin = PrimalDualModel(problem, v, radius, 0.8)
    for _ in range(3):
        path.advance(1)
        twin.step(1.0)
    differs = np.abs(path.log_distance - twin.v)[problem.mask]
    assert np.median(differs) < 1e-6
    assert (
        differs.max() < off
    )  # the slope of a sheet's BRDF jumps within a cell of the table


def test_steps_less_than_the_last_digit_add_up():
    problem, _ = problem_of("plane", 40, lam=1e-9)
    apart = np.zeros_like(problem.mask)
    apart[2::9, 2::9] = True
    problem = replace(problem, mask=problem.mask & apart)
    start = problem.log_d0 + 1e-5  # a step goes a thousandth of this
    path = _Path.at(problem, start, 0, 0.7)
    twin = PrimalDualModel(problem, start, 0, 0.7)
    path.advance(100, 1e-3)
    for _ in range(100):
        twin.step(1e-3)
    gone, expected = ((v - start)[problem.mask] for v in (path.log_distance, twin.v))
    assert np.median(expected) < -5e-7
    np.testing.assert_allclose(np.mean(gone), np.mean(expected), rtol=0.05)


@every_regulariser
def test_steps_are_the_same_bit_for_bit_on_any_number_of_threads(
    rng, all_cores, regulariser
):
    problem, _ = problem_of("colon", xi="1/z", regulariser=regulariser, lam=0.1)
    problem = replace(problem, cuts=rng.random((2, *problem.mask.shape)) < 0.02)
    paths = [_Path.at(problem, problem.log_d0, 4, 0.7) for _ in range(2)]
    for path, count in zip(paths, (1, 2), strict=True):
        with limit_threads(count):
            path.advance(20)
    for one, other in zip(paths[0].state, paths[1].state, strict=True):
        np.testing.assert_array_equal(one, other)
    assert np.abs(paths[0].log_distance - problem.log_d0)[problem.mask].max() > 0.01


@pytest.mark.parametrize(("safety", "stays"), [(0.9, True), (6.0, False)])
def test_ripples_die_within_the_bound_and_grow_beyond_it(safety, stays, rng):
    problem, seen = problem_of("plane", 80, lam=0.0)
    truth = np.log(seen.distance)
    ripple = 1e-3 * rng.normal(size=truth.shape)
    path = _Path.at(problem, truth + ripple, 0, safety)
    size = []
    for _ in range(4):
        path.advance(150, 1e3)
        size.append(np.std((path.log_distance - truth)[20:-20, 20:-20]))
    assert (size[-1] < 1e-3) if stays else (size[-1] > 2e-2), size


@pytest.mark.parametrize(("scene", "mm"), [("plane", 0.4), ("curved", 0.2)])
def test_simple_surfaces_are_found_from_the_papers_start(scene, mm):
    problem, seen = problem_of(scene, xi="1/z", lam=0.1, epsilon=3e-4)
    result = el.run(primal_dual(problem))
    errors = errors_of(result, seen)
    assert result.status is el.Status.CONVERGED
    assert result.energy < 0.2 * result.history[0]["energy"]
    assert errors.mean_mm < mm
    assert errors.mean_degrees < 5


@pytest.mark.parametrize("every", [1, 10, 25])
def test_it_has_not_converged_while_the_energy_falls(every):
    # Where v first moves by less than the tolerance, ten steps still take 11 % off.
    problem, _ = problem_of(
        "plane", xi="1/z", regulariser="second", lam=0.01, epsilon=3e-4
    )
    result = el.run(primal_dual(problem, every=every))
    assert result.status is el.Status.CONVERGED
    before, after = energies(result)[-2:]
    assert (1 - after / before) * 10 / every < 1e-3
    early = el.run(primal_dual(problem, every=10, max_iterations=140))
    assert early.status is el.Status.MAX_ITERATIONS
    before, after = energies(early)[-2:]
    assert early.history[-1]["fall"] == pytest.approx(1 - after / before)
    assert early.history[-1]["fall"] > 0.1


@every_variant
def test_no_combination_diverges_on_the_tube(xi, regulariser):
    problem, _ = problem_of(
        "tube", 80, xi=xi, regulariser=regulariser, lam=0.1, epsilon=3e-4
    )
    result = el.run(primal_dual(problem, tolerance=0, max_iterations=400, every=100))
    assert energies(result)[-1] < 0.6 * energies(result)[0]
    assert np.all(np.isfinite(result.distance[problem.mask]))


def test_steps_are_counted_and_too_few_are_said_to_be_so():
    problem, _ = problem_of("plane", 40)
    result = el.run(primal_dual(problem, every=10, max_iterations=25))
    assert result.status is el.Status.MAX_ITERATIONS
    assert [entry["k"] for entry in result.history] == [0, 10, 20, 25]
    assert result.iterations == result.history[-1]["steps"] == 25
    last = result.history[-1]
    assert last["change"] > 2e-3 * 5 * last["tau"]
    short = el.run(primal_dual(problem, every=10), max_iterations=20)
    assert (short.status, short.iterations) == (el.Status.MAX_ITERATIONS, 20)
    # How often one looks does not change what is seen.
    at_once = el.run(primal_dual(problem, every=25, max_iterations=25))
    np.testing.assert_array_equal(
        at_once.iterate.log_distance, result.iterate.log_distance
    )
