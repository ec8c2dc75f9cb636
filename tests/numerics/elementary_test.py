"""exp and log of arithmetic alone against NumPy's, in units in the last place."""

import numpy as np
import pytest

from endolab.numerics.compiled import kernel
from endolab.numerics.elementary import exp, log


@kernel
def exps_and_logs(x, y, exps, logs):
    for j in range(x.size):
        exps[j] = exp(x[j])
        logs[j] = log(y[j])


@pytest.mark.parametrize("most", [1e-12, 1e-3, 0.3, 1.0, 10.0, 30.0, 690.0, 699.0])
def test_exp_and_log_are_numpys(rng, most):
    x = np.concatenate([rng.uniform(-most, most, 20_000), [0.0, most, -most]])
    y = np.exp(x)
    exps, logs = np.empty_like(x), np.empty_like(x)
    exps_and_logs(x, y, exps, logs)
    for found, expected in ((exps, y), (logs, np.log(y))):
        assert np.all(np.abs(found - expected) <= 2 * np.spacing(np.abs(expected)))
