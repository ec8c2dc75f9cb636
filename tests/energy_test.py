"""The energy against sums written out by hand, and what must leave it unchanged."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.depth.energy import Problem, energy_terms, model_image

CAMERA = el.Pinhole(7, 5, 4.0, 4.4, 2.8, 2.1)
PHOTOMETRY = el.Photometry(k=1.7, gamma=2.0, gain=900.0, brdf=el.Lambertian(0.6))
every_xi = pytest.mark.parametrize("xi", ["1/z", "d", "1/d"])
every_regulariser = pytest.mark.parametrize("regulariser", ["first", "second"])


@pytest.fixture
def tiny(rng):
    """A frame of 7×5 px and a depth map that does not explain it well, with a hole in the mask."""
    mask = np.ones((5, 7), dtype=bool)
    mask[2, 3] = mask[0, 0] = False
    image = rng.uniform(0.1, 0.9, (5, 7))
    v = np.log(20 + rng.uniform(-1, 1, (5, 7)))
    return Problem(image, mask, CAMERA, PHOTOMETRY, epsilon=2e-5), v


def posed(scene, width, **options):
    calibration = datasets.calibration("simple", width)
    rendered = el.render(el.SCENES[scene], calibration.camera, calibration.photometry)
    problem = Problem(
        rendered.image[..., 1],
        rendered.mask,
        calibration.camera,
        rendered.photometry.channel("green"),
        **options,
    )
    return problem, np.log(rendered.distance)


def huber(r, t):
    return r * r / 2 if abs(r) <= t else t * (abs(r) - t / 2)


# Written out ---------------------------------------------------------------------------


def test_data_term_is_the_sum_written_out(tiny):
    """Tangents from finite differences of the rays, their cross product, eq. 9; no mask."""
    problem, v = tiny
    problem = replace(problem, mask=np.ones((5, 7), dtype=bool))
    v_row, v_column = np.gradient(v, edge_order=2)
    h, expected = 1e-5, 0.0
    for row, column in np.ndindex(5, 7):
        ray, right, left, lower, upper = (
            CAMERA.unproject((column + a, row + b)) for a, b in ((0, 0), (h, 0), (-h, 0), (0, h), (0, -h))
        )
        along_u = (right - left) / (2 * h) + v_column[row, column] * ray
        along_v = (lower - upper) / (2 * h) + v_row[row, column] * ray
        normal = np.cross(along_u, along_v)
        cos_theta = abs(normal @ ray) / np.linalg.norm(normal)
        d2 = np.exp(2 * v[row, column])
        predicted = (ray[2] ** 1.7 / d2 * 0.6 / np.pi * cos_theta * 900.0) ** (1 / 2.0)
        assert model_image(problem, v)[row, column] == pytest.approx(predicted, rel=1e-7)
        expected += huber(predicted - problem.image[row, column], 0.05)
    assert energy_terms(problem, v)["data"] == pytest.approx(expected / 35, rel=1e-7)


@every_xi
@every_regulariser
def test_regulariser_is_the_sum_written_out(tiny, xi, regulariser):
    problem, v = tiny
    problem = replace(problem, xi=xi, regulariser=regulariser, lam=0.3)
    mask, cosine = problem.mask, CAMERA.unproject(np.moveaxis(np.indices((5, 7))[::-1], 0, -1))[..., 2]
    maps = {"1/z": lambda v: np.exp(-v) / cosine, "d": np.exp, "1/d": lambda v: np.exp(-v)}
    start = np.log(problem.image**-2.0 * cosine**1.7 * 0.6 / np.pi * 900.0) / 2
    f = maps[xi](v) / np.median(maps[xi](start)[mask])

    def at(pixel, *offsets):
        """Values at offsets (row, column) from a pixel; None if one is not in the mask."""
        places = [(pixel[0] + a, pixel[1] + b) for a, b in offsets]
        inside = all(0 <= r < 5 and 0 <= c < 7 and mask[r, c] for r, c in places)
        return [f[place] for place in places] if inside else None

    def image_step(pixel, a, b):
        other = (pixel[0] + a, pixel[1] + b)
        inside = other[0] < 5 and other[1] < 7 and mask[other]
        return problem.image[other] - problem.image[pixel] if inside else 0.0

    total = 0.0
    for pixel in map(tuple, np.argwhere(mask)):
        if regulariser == "first":
            steps = [at(pixel, (0, 0), (0, 1)), at(pixel, (0, 0), (1, 0))]
            size = np.sqrt(sum((x[1] - x[0]) ** 2 for x in steps if x)) * 7 / 320
        else:
            lines = [at(pixel, (0, -1), (0, 0), (0, 1)), at(pixel, (-1, 0), (0, 0), (1, 0))]
            square = at(pixel, (0, 0), (0, 1), (1, 0), (1, 1))
            second = [(x[0] - 2 * x[1] + x[2]) ** 2 for x in lines if x]
            if square:
                second.append(2 * (square[0] - square[1] - square[2] + square[3]) ** 2)
            size = np.sqrt(sum(second)) * (7 / 320) ** 2
        g = np.exp(-np.hypot(image_step(pixel, 0, 1), image_step(pixel, 1, 0)) * 7 / 320 / 0.05)
        total += 0.3 * g * huber(size, 2e-5) / 2e-5
    assert energy_terms(problem, v)["regulariser"] == pytest.approx(total / mask.sum(), rel=1e-9)


# At the truth --------------------------------------------------------------------------


@pytest.mark.parametrize("scene", ["plane", "curved"])
def test_the_truth_explains_the_frame_to_the_fourth_power_of_the_pixel(scene):
    """Normals err by h² and the data term is quadratic: twice the width, a sixteenth."""
    data = [energy_terms(*posed(scene, width))["data"] for width in (80, 160, 320)]
    assert data[0] < 1e-10
    for coarse, fine in pairwise(data):
        assert 14 < coarse / fine < 18


@pytest.mark.parametrize("step", [-0.01, 0.01])
def test_any_other_distance_explains_it_worse(step):
    problem, v = posed("curved", 80)
    assert energy_terms(problem, v + step)["data"] > 1e5 * energy_terms(problem, v)["data"]


@every_regulariser
@pytest.mark.parametrize(("xi", "cosine_power"), [("d", 0), ("1/d", 0), ("1/z", 1)])
def test_a_constant_xi_costs_nothing(tiny, xi, cosine_power, regulariser):
    problem = replace(tiny[0], xi=xi, regulariser=regulariser)
    v = np.log(20.0) - cosine_power * np.log(problem.field.cos_alpha)
    assert energy_terms(problem, v)["regulariser"] < 1e-20


def test_a_plane_in_a_pinhole_camera_is_straight_in_1_over_z_alone():
    for xi, straight in (("1/z", True), ("1/d", False), ("d", False)):
        problem, v = posed("plane", 80, xi=xi, regulariser="second")
        assert (energy_terms(problem, v)["regulariser"] < 1e-20) == straight
        problem = replace(problem, regulariser="first")
        assert energy_terms(problem, v)["regulariser"] > 1e-4


# What changes nothing ------------------------------------------------------------------


@every_xi
@every_regulariser
@pytest.mark.parametrize("scale", [1e-3, 3.7])
def test_the_unit_of_length_plays_no_part(tiny, xi, regulariser, scale):
    problem, v = tiny
    problem = replace(problem, xi=xi, regulariser=regulariser)
    scaled = replace(problem, photometry=replace(PHOTOMETRY, gain=900.0 * scale**2))
    expected = energy_terms(problem, v)
    assert energy_terms(scaled, v + np.log(scale)) == pytest.approx(expected, rel=1e-10)
    assert min(expected.values()) > 1e-6


@every_xi
@every_regulariser
def test_the_size_of_the_picture_plays_no_part(xi, regulariser):
    small, large = (
        energy_terms(*posed("curved", width, xi=xi, regulariser=regulariser))["regulariser"]
        for width in (120, 240)
    )
    assert small == pytest.approx(large, rel=0.02)


def test_lam_weighs_the_regulariser_alone(tiny):
    problem, v = tiny
    one, three, none = (energy_terms(replace(problem, lam=lam), v) for lam in (1.0, 3.0, 0.0))
    assert three["regulariser"] == pytest.approx(3 * one["regulariser"], rel=1e-12)
    assert none["regulariser"] == 0
    assert one["data"] == three["data"] == none["data"]


@every_xi
@every_regulariser
@pytest.mark.parametrize("outside", [np.nan, 0.0, 50.0])
def test_what_lies_outside_the_mask_plays_no_part(tiny, xi, regulariser, outside):
    problem, v = tiny
    problem = replace(problem, xi=xi, regulariser=regulariser)
    image = np.where(problem.mask, problem.image, outside)
    spoilt = replace(problem, image=image), np.where(problem.mask, v, outside)
    assert energy_terms(*spoilt) == energy_terms(problem, v)
    np.testing.assert_array_equal(model_image(*spoilt), model_image(problem, v))
    np.testing.assert_array_equal(np.isnan(model_image(problem, v)), ~problem.mask)


# Weights and complaints ----------------------------------------------------------------


def test_edges_of_the_image_weigh_less(tiny):
    image = np.full((5, 7), 0.2)
    image[:, 4:] = 0.9
    weight = replace(tiny[0], image=image, mask=np.ones((5, 7), bool)).edge_weight
    assert np.all(weight[:, 3] == np.exp(-0.7 * 7 / 320 / 0.05))
    assert np.all(np.delete(weight, 3, axis=1) == 1)
    weight = tiny[0].edge_weight[tiny[0].mask]
    assert weight.min() > 0
    assert weight.max() <= 1


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("lam", -1.0, "lam must be finite and at least 0, got -1.0"),
        ("lam", np.nan, "lam must be finite and at least 0, got nan"),
        ("lam", np.inf, "lam"),
        ("epsilon", 0.0, "epsilon must be positive and finite, got 0.0"),
        ("epsilon", np.nan, "epsilon"),
        ("threshold", -0.1, "threshold must be positive and finite, got -0.1"),
        ("xi", "z", "unknown xi 'z'; choose 1/z, d, 1/d"),
        ("regulariser", "third", "unknown regulariser 'third'; choose first or second"),
        ("image", np.zeros((7, 5)), r"image has shape \(7, 5\), the camera \(5, 7\)"),
        ("mask", np.ones((5, 6), bool), r"mask has shape \(5, 6\), the camera \(5, 7\)"),
    ],
)
def test_a_problem_refuses(tiny, key, value, message):
    with pytest.raises(ValueError, match=message):
        replace(tiny[0], **{key: value})


def test_units(tiny):
    assert tiny[0].unit == "mm"
    assert replace(tiny[0], metric=False).unit == "relative units"
