"""BRDFs: energy, interpolation, derivatives."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from endolab.model.brdf import Glossy, Lambertian, TabulatedBRDF

TABLE = TabulatedBRDF((0.1, 0.4, 0.9, 1.3), (0.30, 0.26, 0.20, 0.05))
BRDFS = {"matt": Lambertian(0.5), "table": TABLE, "glossy": Glossy(0.5, 0.02, 40.0)}
COSINE, WEIGHT = np.polynomial.legendre.leggauss(2000)
# on the hemisphere, dω = 2π d(cos)
COSINE = 0.5 * (COSINE + 1)
WEIGHT = 0.5 * WEIGHT


@pytest.mark.parametrize("albedo", [0.2, 1.0])
def test_a_matt_surface_returns_its_albedo(albedo):
    f = Lambertian(albedo).value(COSINE, COSINE)
    assert 2 * np.pi * WEIGHT @ (f * COSINE) == pytest.approx(albedo, rel=1e-12)


@pytest.mark.parametrize("shininess", [0.0, 50.0, 500.0])
def test_the_film_returns_its_share(shininess):
    """The lobe integrates to k_s over the half vector, and the matt floor shines through."""
    glossy = Glossy(0.6, 0.03, shininess)
    lobe = glossy.value(np.ones(COSINE.size), COSINE) - 0.6 / np.pi
    assert 2 * np.pi * WEIGHT @ (lobe * COSINE) == pytest.approx(0.03, rel=1e-6)


def test_a_table_is_linear_in_the_angle_and_constant_beyond():
    theta = np.array([0.0, 0.1, 0.25, 0.4, 0.65, 1.1, 1.3, 1.5])
    expected = [0.30, 0.30, 0.28, 0.26, 0.23, 0.125, 0.05, 0.05]
    assert_allclose(TABLE.value(np.ones(8), np.cos(theta)), expected, atol=1e-14)


@pytest.mark.parametrize("brdf", BRDFS.values(), ids=BRDFS)
def test_the_slope_is_the_derivative(brdf):
    cosine = np.linspace(0.03, 0.97, 1500)
    step = 1e-6
    above = brdf.value(cosine + step, cosine + step)
    below = brdf.value(cosine - step, cosine - step)
    assert_allclose(brdf.slope(cosine), (above - below) / (2 * step), rtol=0, atol=1e-6)
