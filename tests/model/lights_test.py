"""Spot lights: fall-off and cone."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from endolab.model.lights import SpotLight

LIGHT = SpotLight(
    position=(3.0, -2.0, 0.5), direction=(0.2, -0.1, 2.0), exponent=1.7, weight=0.6
)


def test_radiance_is_the_papers_formula(rng):
    x = rng.uniform([-40, -40, 15], [40, 40, 90], (50, 3))
    offset = x - np.array([3.0, -2.0, 0.5])
    distance = np.sqrt((offset**2).sum(axis=-1))
    axis = np.array([0.2, -0.1, 2.0]) / np.sqrt(0.04 + 0.01 + 4.0)
    expected = 0.6 * (offset @ axis / distance) ** 1.7 / distance**2
    radiance, reach = LIGHT.illuminate(x)
    assert_allclose(radiance, expected, rtol=1e-13)
    assert_allclose(reach, distance, rtol=1e-14)


@pytest.mark.parametrize("exponent", [0.0, 0.5, 2.0])
def test_nothing_shines_backwards(exponent):
    light = SpotLight(direction=(0, 0, 1), exponent=exponent)
    x = np.array([[0.0, 0.0, -5.0], [3.0, 0.0, -0.1], [3.0, 0.0, 0.0]])
    assert np.all(light.illuminate(x)[0] == 0)
