"""exp of arithmetic alone against NumPy's."""

import numpy as np
import pytest

from endolab.numerics.elementary import exp


@pytest.mark.parametrize(("most", "rtol"), [(1.0, 1e-12), (20.0, 1e-10), (60.0, 1e-7)])
def test_exp_is_numpys(most, rtol):
    x = np.linspace(-most, most, 2001)
    np.testing.assert_allclose([exp(each) for each in x], np.exp(x), rtol=rtol)
