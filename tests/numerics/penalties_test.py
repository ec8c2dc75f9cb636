"""The Huber penalty against its definition, its derivative and SciPy's."""

import numpy as np
import pytest
from scipy import integrate, special

from endolab.numerics.penalties import huber

THRESHOLDS = [1e-4, 0.05, 1.0, 30.0]


@pytest.mark.parametrize("threshold", THRESHOLDS)
def test_huber_is_the_integral_of_the_clipped_residual(threshold):
    for r in np.array([-5.0, -1.0, -0.3, 0.0, 0.7, 1.0, 8.0]) * threshold:
        area, _ = integrate.quad(
            lambda s: np.clip(s, -threshold, threshold), 0, r, points=[np.sign(r) * threshold] if r else None
        )
        assert huber(r, threshold) == pytest.approx(area, rel=1e-12, abs=1e-300)


@pytest.mark.parametrize("threshold", THRESHOLDS)
def test_huber_agrees_with_scipy(rng, threshold):
    r = threshold * rng.normal(scale=3, size=(4, 50))
    np.testing.assert_allclose(huber(r, threshold), special.huber(threshold, r), rtol=1e-13)


@pytest.mark.parametrize("threshold", THRESHOLDS)
def test_huber_is_even_convex_and_smooth(rng, threshold):
    a, b = threshold * rng.normal(scale=3, size=(2, 500))
    np.testing.assert_array_equal(huber(a, threshold), huber(-a, threshold))
    chord = 0.5 * (huber(a, threshold) + huber(b, threshold))
    assert np.all(huber(0.5 * (a + b), threshold) <= chord + 1e-12 * threshold**2)
    h = 1e-5 * threshold
    slope = (huber(a + h, threshold) - huber(a - h, threshold)) / (2 * h)
    np.testing.assert_allclose(slope, np.clip(a, -threshold, threshold), rtol=0, atol=1e-5 * threshold)


def test_a_small_threshold_gives_total_variation(rng):
    r = rng.normal(size=1000)
    np.testing.assert_allclose(huber(r, 1e-6) / 1e-6, np.abs(r), rtol=0, atol=1e-6)


@pytest.mark.parametrize("threshold", [0.0, -1.0, np.nan, np.inf])
def test_a_bad_threshold_is_named(threshold):
    with pytest.raises(ValueError, match="threshold"):
        huber([1.0], threshold)
