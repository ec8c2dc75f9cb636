"""exp and log of arithmetic alone against NumPy's, in units in the last place."""

import numpy as np
import pytest

from endolab.numerics.compiled import kernel
from endolab.numerics.elementary import exp, log


@kernel
def exps(x, out):
    for j in range(x.size):
        out[j] = exp(x[j])


@kernel
def logs(x, out):
    for j in range(x.size):
        out[j] = log(x[j])


def units_off(function, x, expected):
    out = np.empty_like(x)
    function(x, out)
    return np.abs(out - expected) / np.spacing(np.abs(expected))


@pytest.mark.parametrize("most", [1e-12, 1e-3, 1.0, 30.0, 699.0])
def test_exp(rng, most):
    x = np.concatenate([rng.uniform(-most, most, 20_000), [0.0, most, -most]])
    assert units_off(exps, x, np.exp(x)).max() <= 2


@pytest.mark.parametrize("most", [1e-12, 1e-3, 0.3, 10.0, 690.0])
def test_log(rng, most):
    x = np.exp(np.concatenate([rng.uniform(-most, most, 20_000), [0.0, most, -most]]))
    assert units_off(logs, x, np.log(x)).max() <= 2
