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


def test_no_constant_betters_the_best_one_and_it_draws_with_itself():
    distance, _, truth = samples()
    found = coverage_of(distance, 0.07 * distance, truth)
    error = np.abs(1 - truth / distance)
    assert found.constant_percent == pytest.approx(100 * np.sqrt(np.mean(error**2)))
    tried = np.geomspace(0.01, 0.2, 60)
    assert found.constant_log_score <= min(
        -np.mean(scipy.stats.norm.logpdf(error, scale=one)) for one in tried
    )
    same = coverage_of(distance, found.constant_percent / 100 * distance, truth)
    assert same.log_score == pytest.approx(found.constant_log_score)
    assert np.isnan(same.spearman) or abs(same.spearman) < 0.02  # by rounding alone


def test_the_scale_is_taken_out_of_both():
    distance, sigma, truth = samples()
    there = coverage_of(distance, sigma, truth)
    scaled = coverage_of(distance / 7, sigma / 7, truth, scale="median")
    assert scaled.scale == pytest.approx(7, rel=1e-3)
    assert scaled.within_one == pytest.approx(there.within_one, abs=0.1)
    assert coverage_of(distance / 7, sigma / 7, truth).within_two < 1


def test_what_cannot_be_compared_is_refused():
    ones = np.ones((3, 4))
    with pytest.raises(ValueError, match="sigma has shape"):
        coverage_of(ones, np.ones((3, 5)), ones)
    with pytest.raises(ValueError, match="no pixel"):
        coverage_of(ones, np.nan * ones, ones)
    with pytest.raises(ValueError, match="unknown scale"):
        coverage_of(ones, ones, ones, scale="mean")
