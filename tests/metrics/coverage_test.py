"""Coverage of normal samples, and scores."""

import numpy as np
import pytest
import scipy.stats

from endolab.metrics.coverage import coverage_of

SHAPE = (300, 400)


def samples(honest=1.0, seed=0):
    """Distance, σ and truth of a picture whose error is normal with a σ between 1 and 20 %."""
    rng = np.random.default_rng(seed)
    distance = rng.uniform(10, 90, SHAPE)
    share = np.exp(rng.uniform(np.log(0.01), np.log(0.2), SHAPE))
    truth = distance * (1 + share * rng.standard_normal(SHAPE))
    return distance, honest * share * distance, truth


def test_a_normal_error_is_covered_as_the_tables_say():
    found = coverage_of(*samples())
    assert found.within_one == pytest.approx(68.27, abs=0.5)
    assert found.within_two == pytest.approx(95.45, abs=0.3)
    assert found.sigma_percent == pytest.approx(100 * np.sqrt(0.01 * 0.2), rel=0.03)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_sigma_that_is_off_is_charged_for(factor):
    honest = coverage_of(*samples())
    off = coverage_of(*samples(factor))
    expected = [100 * (2 * scipy.stats.norm.cdf(n * factor) - 1) for n in (1, 2)]
    assert [off.within_one, off.within_two] == pytest.approx(expected, abs=0.5)
    assert off.log_score > honest.log_score + 0.2
    assert off.spearman == pytest.approx(honest.spearman)


def test_the_scale_is_taken_out_of_both():
    distance, sigma, truth = samples()
    there = coverage_of(distance, sigma, truth)
    scaled = coverage_of(distance / 7, sigma / 7, truth, scale="median")
    assert scaled.scale == pytest.approx(7, rel=1e-3)
    assert scaled.within_one == pytest.approx(there.within_one, abs=0.1)
    assert coverage_of(distance / 7, sigma / 7, truth).within_two < 1
