"""Numbers by their order, against NumPy and SciPy."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy import ndimage

from endolab.numerics.ranks import median, medians, nth_lowest, sorted_places, window_percentile


@pytest.mark.parametrize("different", [2, 100, 10**9])
def test_sorted_places_are_those_of_a_stable_sort(rng, different):
    values = rng.integers(0, different, 5000) / 7
    assert_array_equal(sorted_places(values), np.argsort(values, kind="stable"))


def test_places_of_few():
    assert_array_equal(sorted_places(np.array([])), [])
    assert_array_equal(sorted_places(np.array([3.0])), [0])


@pytest.mark.parametrize("count", [1, 2, 7, 1000])
def test_a_median_and_the_nth_lowest_are_numpys(rng, count):
    values = rng.normal(size=count)
    assert median(values) == np.median(values)
    assert [nth_lowest(values, nth) for nth in range(count)] == np.sort(values).tolist()


@pytest.mark.parametrize("different", [3, 10**9])
def test_medians_are_those_of_each_group(rng, different):
    values, labels = rng.integers(0, different, 4000) / 3, rng.integers(-1, 300, 4000)
    numbers = np.unique(labels[labels >= 0])
    found = medians(values, labels, 301)
    assert_array_equal(found[numbers], ndimage.median(values, labels, numbers))
    assert np.isnan(found[300])


@pytest.mark.parametrize("shape", [(30, 41), (1, 7), (8, 3)])
@pytest.mark.parametrize("percent", [0, 25, 75, 100])
@pytest.mark.parametrize("width", [1, 3, 9])
def test_percentiles_in_a_window_are_those_of_scipy(rng, shape, percent, width):
    a = rng.normal(size=shape).round(2)
    expected = ndimage.percentile_filter(a, percent, size=width, mode="nearest")
    assert_array_equal(window_percentile(a, percent, width), expected)
