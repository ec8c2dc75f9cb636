"""The Huber penalty against SciPy's."""

import pytest
from numpy.testing import assert_allclose
from scipy import special

from endolab.numerics.penalties import huber


@pytest.mark.parametrize("threshold", [1e-4, 0.05, 1.0, 30.0])
def test_huber_is_scipys(rng, threshold):
    r = threshold * rng.normal(scale=3, size=200)
    r[:3] = -threshold, 0.0, threshold
    assert_allclose(huber(r, threshold), special.huber(threshold, r), rtol=1e-13)
