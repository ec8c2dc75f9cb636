"""Coverage of normal samples, and scores."""

import numpy as np
import pytest
from scipy.stats import norm

from endolab.metrics.coverage import coverage_of


@pytest.fixture
def maps(rng):
    """Give distance, σ and truth of a picture whose error is normal with a σ between 1 and 20 %."""
    distance = rng.uniform(10, 90, (300, 400))
    sigma = distance * np.exp(rng.uniform(np.log(0.01), np.log(0.2), distance.shape))
    return distance, sigma, distance + sigma * rng.standard_normal(distance.shape)


@pytest.mark.parametrize(("factor", "charge"), [(0.5, 0.2), (1.0, 0.0), (2.0, 0.2)])
def test_a_normal_error_is_covered_as_the_tables_say(maps, factor, charge):
    distance, sigma, truth = maps
    honest = coverage_of(*maps)
    found = coverage_of(distance, factor * sigma, truth)
    expected = [100 * (2 * norm.cdf(n * factor) - 1) for n in (1, 2)]
    assert [found.within_one, found.within_two] == pytest.approx(expected, abs=0.5)
    median = factor * 100 * np.sqrt(0.01 * 0.2)
    assert found.sigma_percent == pytest.approx(median, rel=0.03)
    assert found.log_score >= honest.log_score + charge
    assert found.spearman == pytest.approx(honest.spearman)


def test_the_scale_is_taken_out_of_both(maps):
    distance, sigma, truth = maps
    there = coverage_of(*maps)
    scaled = coverage_of(distance / 7, sigma / 7, truth, align="scale")
    assert scaled.scale == pytest.approx(7, rel=1e-3)
    assert scaled.within_one == pytest.approx(there.within_one, abs=0.1)
    assert coverage_of(distance / 7, sigma / 7, truth).within_two < 1
