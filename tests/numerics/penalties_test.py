"""The Huber penalty against SciPy's."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import special

from endolab.numerics.penalties import huber


@pytest.mark.parametrize("threshold", [1e-4, 0.05, 1.0, 30.0])
def test_huber_is_scipys(rng, threshold):
    r = threshold * np.concatenate(
        [rng.normal(scale=3, size=200), [-5.0, -1.0, 0.0, 1.0, 8.0]]
    )
    assert_allclose(huber(r, threshold), special.huber(threshold, r), rtol=1e-13)
