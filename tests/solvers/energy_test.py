"""The energy against sums written out by hand, and what must leave it unchanged."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import huber

import endolab as el
from endolab.numerics.compiled import inner, pad_maps
from endolab.numerics.stencils import (
    differences,
    forward_gradient,
    hessian,
)
from endolab.solvers.energy import energy_terms, model_image
from endolab.solvers.grid import Grid
from endolab.solvers.multigrid import multiply
from endolab.solvers.problem import EXACT, LOWER_BOUND, NONE, Problem
from tests.tools.problems import SHEET, at_truth, every_variant

CAMERA = el.Pinhole(9, 7, 5.0, 5.4, 3.8, 3.1)
PHOTOMETRY = el.Photometry(k=1.7, gamma=2.0, gain=900.0, brdf=el.Lambertian(0.6))
# As much as the data, ε amid ‖D ξ‖.
WEIGHTS = {
    "first": {"lam": 2.0, "epsilon": 4e-3},
    "second": {"lam": 20.0, "epsilon": 3e-4},
}


@pytest.fixture
def rough(rng):
    """A frame of 9×7 px that a rough surface nearly explains, with holes and cuts."""
    shape = (7, 9)
    mask = np.ones(shape, dtype=bool)
    cuts = rng.random((2, *shape)) < 0.1
    mask[2, 3] = mask[0, 0] = mask[5:, 6] = False
    v = np.log(20) + 0.1 * rng.normal(size=shape)
    problem = Problem(np.full(shape, 0.5), mask, CAMERA, PHOTOMETRY, cuts=cuts)
    noise = rng.choice([0.01, 0.1], shape) * rng.normal(size=shape)
    image = np.clip(model_image(problem, v) + noise, 0.05, 0.95)
    return replace(problem, image=image), v


def test_data_term_is_the_sum_written_out(rng, rough):
    """Tangents from finite differences of the rays, their cross product, eq. 9; no mask."""
    problem, v = rough
    image = rng.uniform(0.1, 0.9, v.shape)
    problem = replace(problem, image=image, mask=np.ones(v.shape, bool), cuts=None)
    pixels = np.moveaxis(np.indices(v.shape)[::-1], 0, -1)
    rays, right, left, lower, upper = (
        CAMERA.unproject(pixels + np.array(step))
        for step in ((0, 0), (1e-5, 0), (-1e-5, 0), (0, 1e-5), (0, -1e-5))
    )
    v_row, v_column = np.gradient(v, edge_order=1)
    along_u = (right - left) / 2e-5 + v_column[..., None] * rays
    along_v = (lower - upper) / 2e-5 + v_row[..., None] * rays
    normal = np.cross(along_u, along_v)
    cos_theta = np.abs((normal * rays).sum(axis=-1)) / np.linalg.norm(normal, axis=-1)
    predicted = rays[..., 2] ** 1.7 / np.exp(2 * v) * 0.6 / np.pi * cos_theta * 900
    predicted **= 1 / 2.0
    assert_allclose(model_image(problem, v), predicted, rtol=1e-7)
    expected = huber(0.05, predicted - problem.image).mean()
    assert energy_terms(problem, v)["data"] == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("brdf", [None, SHEET])
def test_the_data_term_counts_what_a_pixel_is_evidence_of(rng, brdf):
    problem, v = at_truth("curved", 24, brdf=brdf)
    evidence = rng.choice([EXACT, LOWER_BOUND, NONE], v.shape).astype(np.int8)
    v = v + 0.05 * rng.normal(size=v.shape)
    r = model_image(problem, v) - problem.image
    r = np.select([evidence == EXACT, evidence == LOWER_BOUND], [r, np.minimum(r, 0)])
    expected = huber(problem.threshold, r)[problem.mask].mean()
    data = energy_terms(replace(problem, evidence=evidence), v)["data"]
    assert data == pytest.approx(expected, rel=1e-6 if brdf else 1e-12)


@every_variant
def test_the_regulariser_is_the_sum_written_out(rough, xi, regulariser):
    problem, v = rough
    problem = replace(problem, xi=xi, regulariser=regulariser, **WEIGHTS[regulariser])
    mask = problem.mask
    cosine = CAMERA.unproject(np.moveaxis(np.indices((7, 9))[::-1], 0, -1))[..., 2]
    d0 = (problem.image**-2.0 * cosine**1.7 * 0.6 / np.pi * 900.0) ** 0.5
    f, f0 = (
        {"1/z": 1 / (d * cosine), "d": d, "1/d": 1 / d}[xi] for d in (np.exp(v), d0)
    )
    derivatives, pixel = {
        "first": (forward_gradient, 9 / 320),
        "second": (hessian, (9 / 320) ** 2),
    }[regulariser]
    size = np.linalg.norm(derivatives(f, mask, problem.cuts), axis=0) * pixel
    size /= np.median(f0[mask])
    edge = np.linalg.norm(differences(problem.image, mask), axis=0) * 9 / 320
    costs = np.exp(-edge / 0.05) * huber(problem.epsilon, size) / problem.epsilon
    found = energy_terms(problem, v)["regulariser"]
    assert found == pytest.approx(problem.lam * costs[mask].mean(), rel=1e-9)


@pytest.mark.parametrize("scene", ["plane", "curved"])
def test_the_truth_explains_the_frame_to_the_fourth_power_of_the_pixel_and_its_rim_to_the_third(
    scene,
):
    """The data term is quadratic in the error of the normals: inside h², so a sixteenth at twice the width.

    At the rim two pixels give h, so a quarter, from a share of the pixels that halves: an eighth.
    """
    costs = []
    for width in (80, 160, 320):
        problem, v = at_truth(scene, width)
        residual = model_image(problem, v) - problem.image
        inside = np.mean(residual[1:-1, 1:-1] ** 2) / 2
        costs.append([energy_terms(problem, v)["data"], inside])
    assert np.all(costs[0] < np.array([5e-9, 1.8e-10]))
    for coarse, fine in pairwise(np.array(costs)):
        assert np.all(coarse / fine > [7.5, 15])
        assert np.all(coarse / fine < [9, 17])


@every_variant
@pytest.mark.parametrize("scale", [1e-3, 3.7])
def test_the_unit_of_length_plays_no_part(rough, xi, regulariser, scale):
    problem, v = rough
    problem = replace(problem, xi=xi, regulariser=regulariser)
    scaled = replace(problem, photometry=replace(PHOTOMETRY, gain=900.0 * scale**2))
    expected = energy_terms(problem, v)
    assert energy_terms(scaled, v + np.log(scale)) == pytest.approx(expected, rel=1e-10)
    assert min(expected.values()) > 1e-6


@every_variant
def test_the_size_of_the_picture_plays_no_part(xi, regulariser):
    both = (
        at_truth("curved", width, xi=xi, regulariser=regulariser)
        for width in (120, 240)
    )
    small, large = (energy_terms(*each)["regulariser"] for each in both)
    assert small == pytest.approx(large, rel=0.02)


def equations_at(problem, v):
    """Slope of the energy, (H, W), and matrix of the quadratic that stands for it, as solvers have them."""
    grid = Grid.of(problem)
    padded = pad_maps(np.where(problem.mask, v, 0.0))
    coefficients, descent = grid.equations_at(padded, problem.lam)
    return -inner(descent) / grid.count, coefficients.matrix(0.0) / grid.count


def derivative(function, v, direction):
    """Central difference of a function of v along a direction."""
    return (function(v + 1e-6 * direction) - function(v - 1e-6 * direction)) / 2e-6


@every_variant
@pytest.mark.parametrize("kinds", [[EXACT], [EXACT, LOWER_BOUND, NONE]])
def test_the_slope_is_the_energys(rng, rough, xi, regulariser, kinds):
    """Pixel by pixel, with residuals and roughness on both sides of their Huber thresholds."""
    problem, v = rough
    evidence = rng.choice(kinds, v.shape).astype(np.int8)
    how = {"xi": xi, "regulariser": regulariser, "evidence": evidence}
    problem = replace(problem, **how, **WEIGHTS[regulariser])
    slope, _ = equations_at(problem, v)
    of_data, _ = equations_at(replace(problem, lam=0.0), v)
    assert 0.2 < np.linalg.norm(slope - of_data) / np.linalg.norm(of_data) < 10
    pixels = np.eye(v.size).reshape(v.size, *v.shape)
    expected = [
        derivative(lambda x: sum(energy_terms(problem, x).values()), v, pixel)
        for pixel in pixels
    ]
    expected = np.where(problem.mask, np.reshape(expected, v.shape), 0.0)
    assert_allclose(slope, expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max())


@every_variant
def test_the_matrix_is_the_slopes_derivative_where_nothing_else_bends(
    rng, rough, xi, regulariser
):
    """At no residual and straight ξ, both Hubers quadratic, what Gauss-Newton leaves out is 0."""
    problem, _ = rough
    v = np.log(20.0) - (xi == "1/z") * np.log(problem.field.cos_alpha)
    how = {"xi": xi, "regulariser": regulariser, "image": model_image(problem, v)}
    problem = replace(problem, **how, **WEIGHTS[regulariser])
    delta = np.where(problem.mask, rng.normal(size=v.shape), 0.0)
    expected = derivative(lambda x: equations_at(problem, x)[0], v, delta)
    product = np.zeros(pad_maps(v).shape)
    multiply(equations_at(problem, v)[1], pad_maps(delta), product)
    assert_allclose(
        inner(product), expected, rtol=0, atol=1e-7 * np.abs(expected).max()
    )


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("lam", -1.0),
        ("lam", "auto"),
        ("xi", "z"),
        ("regulariser", "third"),
        ("image", np.zeros((9, 7))),
        ("mask", np.ones((7, 8), bool)),
        ("evidence", np.zeros((7, 9))),
        ("evidence", np.full((7, 9), 3, np.int8)),
    ],
)
def test_a_problem_refuses(rough, name, value):
    with pytest.raises(ValueError, match=name):
        replace(rough[0], **{name: value})
