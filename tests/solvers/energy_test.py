"""The energy against sums written out by hand, and what must leave it unchanged."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.special import huber

import endolab as el
from endolab.numerics.compiled import inner, pad_maps
from endolab.numerics.stencils import differences, forward_gradient, hessian
from endolab.solvers.energy import energy_terms, model_image
from endolab.solvers.grid import Grid
from endolab.solvers.multigrid import multiply
from endolab.solvers.problem import EXACT, LOWER_BOUND, NONE, Problem
from tests.tools.problems import SHEET, at_truth, every_variant

CAMERA = el.Pinhole(7, 5, 4.0, 4.4, 2.8, 2.1)
CAMERA_9 = el.Pinhole(9, 7, 5.0, 5.4, 3.8, 3.1)
PHOTOMETRY = el.Photometry(k=1.7, gamma=2.0, gain=900.0, brdf=el.Lambertian(0.6))


@pytest.fixture
def tiny(rng):
    """A frame of 7×5 px and a depth map that does not explain it well, with a hole in the mask."""
    mask = np.ones((5, 7), dtype=bool)
    mask[2, 3] = mask[0, 0] = False
    image = rng.uniform(0.1, 0.9, (5, 7))
    v = np.log(20 + rng.uniform(-1, 1, (5, 7)))
    return Problem(image, mask, CAMERA, PHOTOMETRY, epsilon=2e-5), v


@pytest.fixture
def problem_with_holes(rng):
    """A frame of 9×7 px that a rough surface nearly explains, with holes and cuts."""
    shape = (7, 9)
    mask = np.ones(shape, dtype=bool)
    cuts = rng.random((2, *shape)) < 0.1
    mask[2, 3] = mask[0, 0] = mask[5:, 6] = False
    v = np.log(20) + 0.1 * rng.normal(size=shape)
    problem = Problem(np.full(shape, 0.5), mask, CAMERA_9, PHOTOMETRY, cuts=cuts)
    noise = rng.choice([0.01, 0.1], shape) * rng.normal(size=shape)
    return replace(
        problem, image=np.clip(model_image(problem, v) + noise, 0.05, 0.95)
    ), v


def with_regulariser(problem, xi, regulariser):
    """A problem with a regulariser that weighs as much as its data, ε amid its ‖D ξ‖."""
    lam, epsilon = {
        "first": (2.0, 4e-3),
        "second": (20.0, 3e-4),
    }[regulariser]
    return replace(problem, xi=xi, regulariser=regulariser, lam=lam, epsilon=epsilon)


def costless_surface(problem, xi):
    """A surface that costs nothing: of constant ξ."""
    return np.log(20.0) - (xi == "1/z") * np.log(problem.field.cos_alpha)


def test_data_term_is_the_sum_written_out(tiny):
    """Tangents from finite differences of the rays, their cross product, eq. 9; no mask."""
    problem, v = tiny
    problem = replace(problem, mask=np.ones((5, 7), dtype=bool))
    v_row, v_column = np.gradient(v, edge_order=1)
    h = 1e-5
    expected = 0.0
    for row, column in np.ndindex(5, 7):
        ray, right, left, lower, upper = (
            CAMERA.unproject((column + a, row + b))
            for a, b in ((0, 0), (h, 0), (-h, 0), (0, h), (0, -h))
        )
        along_u = (right - left) / (2 * h) + v_column[row, column] * ray
        along_v = (lower - upper) / (2 * h) + v_row[row, column] * ray
        normal = np.cross(along_u, along_v)
        cos_theta = abs(normal @ ray) / np.linalg.norm(normal)
        d2 = np.exp(2 * v[row, column])
        predicted = (ray[2] ** 1.7 / d2 * 0.6 / np.pi * cos_theta * 900.0) ** (1 / 2.0)
        assert model_image(problem, v)[row, column] == pytest.approx(
            predicted, rel=1e-7
        )
        expected += huber(0.05, predicted - problem.image[row, column])
    assert energy_terms(problem, v)["data"] == pytest.approx(expected / 35, rel=1e-7)


@pytest.mark.parametrize("brdf", [None, SHEET])
def test_the_data_term_counts_what_a_pixel_is_evidence_of(rng, brdf):
    problem, v = at_truth("curved", 24, brdf=brdf)
    evidence = rng.choice([EXACT, LOWER_BOUND, NONE], v.shape).astype(np.int8)
    v = v + 0.05 * rng.normal(size=v.shape)
    r = model_image(problem, v) - problem.image
    r = np.where(evidence == LOWER_BOUND, np.minimum(r, 0), r)
    costs = np.where(evidence == NONE, 0, huber(problem.threshold, r))
    expected = costs[problem.mask].mean()
    data = energy_terms(replace(problem, evidence=evidence), v)["data"]
    assert data == pytest.approx(expected, rel=1e-6 if brdf else 1e-12)


@every_variant
def test_the_regulariser_is_the_sum_written_out(problem_with_holes, xi, regulariser):
    problem, v = problem_with_holes
    problem = with_regulariser(problem, xi, regulariser)
    mask = problem.mask
    cosine = CAMERA_9.unproject(np.moveaxis(np.indices((7, 9))[::-1], 0, -1))[..., 2]
    maps = {
        "1/z": lambda v: np.exp(-v) / cosine,
        "d": np.exp,
        "1/d": lambda v: np.exp(-v),
    }
    d0 = np.log(problem.image**-2.0 * cosine**1.7 * 0.6 / np.pi * 900.0) / 2
    f = maps[xi](v) / np.median(maps[xi](d0)[mask])
    order, derivative = {"first": (1, forward_gradient), "second": (2, hessian)}[
        regulariser
    ]
    size = (
        np.linalg.norm(derivative(f, mask, problem.cuts), axis=0) * (9 / 320) ** order
    )
    edge = np.linalg.norm(differences(problem.image, mask), axis=0) * 9 / 320
    costs = np.exp(-edge / 0.05) * huber(problem.epsilon, size) / problem.epsilon
    expected = problem.lam * costs[mask].mean()
    found = energy_terms(problem, v)["regulariser"]
    assert found == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("scene", ["plane", "curved"])
def test_the_truth_explains_the_frame_to_the_fourth_power_of_the_pixel_and_its_rim_to_the_third(
    scene,
):
    """The data term is quadratic in the error of the normals: inside h², so a sixteenth at twice the width.

    At the rim two pixels give h, so a quarter, from a share of the pixels that halves: an eighth.
    """
    data = []
    inside = []
    for width in (80, 160, 320):
        problem, v = at_truth(scene, width)
        residual = model_image(problem, v) - problem.image
        data.append(energy_terms(problem, v)["data"])
        inside.append(np.mean(residual[1:-1, 1:-1] ** 2) / 2)
    assert data[0] < 5e-9
    assert inside[0] < 1.8e-10
    assert all(7.5 < coarse / fine < 9 for coarse, fine in pairwise(data))
    assert all(15 < coarse / fine < 17 for coarse, fine in pairwise(inside))


@every_variant
@pytest.mark.parametrize("scale", [1e-3, 3.7])
def test_the_unit_of_length_plays_no_part(tiny, xi, regulariser, scale):
    problem, v = tiny
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


def derivative(function, v, direction, h=1e-6):
    """Central difference of a function of v along a direction."""
    return (function(v + h * direction) - function(v - h * direction)) / (2 * h)


@every_variant
@pytest.mark.parametrize("kinds", [[EXACT], [EXACT, LOWER_BOUND, NONE]])
def test_the_slope_is_the_energys(rng, problem_with_holes, xi, regulariser, kinds):
    """Pixel by pixel, with residuals and roughness on both sides of their Huber thresholds."""
    problem, v = problem_with_holes
    evidence = rng.choice(kinds, v.shape).astype(np.int8)
    problem = with_regulariser(replace(problem, evidence=evidence), xi, regulariser)
    slope, _ = equations_at(problem, v)
    of_data, _ = equations_at(replace(problem, lam=0.0), v)
    assert 0.2 < np.linalg.norm(slope - of_data) / np.linalg.norm(of_data) < 10
    expected = np.zeros(v.shape)
    for pixel in map(tuple, np.argwhere(problem.mask)):
        unit = np.zeros(v.shape)
        unit[pixel] = 1.0
        expected[pixel] = derivative(
            lambda x: sum(energy_terms(problem, x).values()), v, unit
        )
    np.testing.assert_allclose(
        slope, expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max()
    )


@every_variant
def test_the_matrix_is_the_slopes_derivative_where_nothing_else_bends(
    rng, problem_with_holes, xi, regulariser
):
    """At no residual and straight ξ, both Hubers quadratic, what Gauss-Newton leaves out is 0."""
    problem, _ = problem_with_holes
    v = costless_surface(problem, xi)
    problem = replace(problem, image=model_image(problem, v))
    problem = with_regulariser(problem, xi, regulariser)
    delta = np.where(problem.mask, rng.normal(size=v.shape), 0.0)
    expected = derivative(lambda x: equations_at(problem, x)[0], v, delta)
    product = np.zeros(pad_maps(v).shape)
    multiply(equations_at(problem, v)[1], pad_maps(delta), product)
    np.testing.assert_allclose(
        inner(product), expected, rtol=0, atol=1e-7 * np.abs(expected).max()
    )


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("lam", np.nan),
        ("lam", -1.0),
        ("lam", "auto"),
        ("epsilon", 0.0),
        ("threshold", np.inf),
        ("xi", "z"),
        ("regulariser", "third"),
        ("image", np.zeros((7, 5))),
        ("mask", np.ones((5, 6), bool)),
        ("cuts", np.ones((5, 7), bool)),
        ("evidence", np.zeros((5, 7))),
        ("evidence", np.full((5, 7), 3, np.int8)),
    ],
)
def test_a_problem_refuses(tiny, name, value):
    with pytest.raises(ValueError, match=name):
        replace(replace(tiny[0], xi="d"), **{name: value})
