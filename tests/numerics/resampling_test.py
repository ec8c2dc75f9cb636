"""Maps on another number of pixels."""

import cv2
import pytest
from numpy.testing import assert_allclose

from endolab.numerics.resampling import resample


@pytest.mark.parametrize("shape", [(30, 41), (12, 16), (7, 9), (40, 5)])
def test_it_is_opencvs_in_double_precision_and_turns_with_the_map(rng, shape):
    maps = rng.normal(size=(12, 16, 2))
    found = resample(maps, shape)
    opencvs = cv2.resize(maps, shape[::-1], interpolation=cv2.INTER_LINEAR)
    assert_allclose(found, opencvs, atol=1e-5)
    turned = resample(maps[::-1, ::-1].swapaxes(0, 1), shape[::-1]).swapaxes(0, 1)
    assert_allclose(turned[::-1, ::-1], found, atol=1e-13)
