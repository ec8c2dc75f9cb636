"""Maps on another number of pixels."""

import cv2
import numpy as np
import pytest

from endolab.numerics.resampling import resample


@pytest.mark.parametrize("shape", [(30, 41), (12, 16), (7, 9), (40, 5)])
def test_it_is_opencvs_in_double_precision_and_turns_with_the_map(rng, shape):
    maps = rng.normal(size=(12, 16, 2))
    found = resample(maps, shape)
    np.testing.assert_allclose(
        found, cv2.resize(maps, shape[::-1], interpolation=cv2.INTER_LINEAR), atol=1e-5
    )
    np.testing.assert_allclose(
        resample(maps[::-1, ::-1], shape), found[::-1, ::-1], atol=1e-13
    )
    turned = resample(maps.swapaxes(0, 1), shape[::-1])
    np.testing.assert_allclose(turned.swapaxes(0, 1), found, atol=1e-13)
