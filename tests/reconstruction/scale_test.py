"""Scale and meaning: one known length fixes all, and the sentences' figures are true."""

import re

import numpy as np
import pytest

import endolab as el
from endolab.reconstruction.report import meaning
from endolab.reconstruction.scale import factor_of_distance, scale_of
from endolab.solvers.energy import energy_terms
from tests.tools.cases import drawn

CAMERA = el.Pinhole(200, 150, 110.0, 110.0, 99.5, 74.5)
# column, row
ONE = (41, 50)
OTHER = (150, 109)


@pytest.fixture(scope="module")
def bowl():
    """A noisy bowl, and the calibration that explains it."""
    calibration = el.Calibration(CAMERA, el.Photometry(brdf=el.Lambertian(0.4)))
    return drawn("curved", calibration, noise=1.0, seed=3)


def solve(bowl, **options):
    return bowl.relit(gain=None).solve(**options)


@pytest.fixture(scope="module")
def relative(bowl):
    return solve(bowl)


def point(bowl, pixel):
    return bowl.distance[pixel[::-1]] * CAMERA.field.rays[pixel[::-1]]


@pytest.mark.parametrize("width", [None, 67])
def test_one_length_gives_the_true_size(bowl, width):
    """Within what noise does to five pixels; the pixel is one of the whole picture, though it was shrunk."""
    distance = float(np.linalg.norm(point(bowl, ONE)))
    diameter = float(np.linalg.norm(point(bowl, ONE) - point(bowl, OTHER)))
    true = np.median(bowl.distance[bowl.frame.mask])
    for length in (
        {"known_distance": (distance, *ONE)},
        {"known_diameter": (diameter, ONE, OTHER)},
    ):
        result = solve(bowl, width=width, **length)
        assert result.metric
        assert np.median(result.distance[result.mask]) == pytest.approx(true, rel=0.015)


def test_a_length_that_is_known_changes_the_unit_alone(bowl, relative):
    seen = []
    whole = solve(bowl, known_distance=(30.0, *ONE), observers=[seen.append])
    assert seen[-1] is whole.iterate
    factor = factor_of_distance(relative, 30.0, *ONE)
    np.testing.assert_allclose(whole.distance, factor * relative.distance, rtol=1e-12)
    np.testing.assert_allclose(whole.normals, relative.normals, atol=1e-9)
    # The same in every unit.
    terms = energy_terms(whole.problem, whole.iterate.log_distance)
    assert sum(terms.values()) == pytest.approx(relative.energy, rel=1e-9)


def test_what_fixed_the_scale_is_named_and_what_the_gain_would_have_made_of_it(
    bowl, relative
):
    assert scale_of(relative) == "none"
    assert scale_of(solve(bowl, known_distance=(30, *ONE))) == "known distance"
    both = bowl.solve(known_diameter=(12.5, ONE, OTHER))
    true = float(np.linalg.norm(point(bowl, ONE) - point(bowl, OTHER)))
    stated = re.search(r"By the gain.* would be ([\d.]+) mm", "\n".join(meaning(both)))
    assert float(stated[1]) == pytest.approx(true, rel=0.01)
