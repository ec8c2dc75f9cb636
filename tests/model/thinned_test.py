"""Every n-th pixel's normal and slant are those of the whole map, whatever the mask and the cuts."""

import numpy as np
import pytest

import endolab as el
from endolab.model.surface import normals, slant
from endolab.model.thinned import ThinnedMaps
from endolab.numerics.derivatives import gradient


@pytest.mark.parametrize("step", [1, 2, 3, 7])
@pytest.mark.parametrize("is_cut", [False, True])
def test_every_nth_is_as_in_the_whole(step, is_cut, rng):
    field = el.load_calibration("paper", width=48).camera.field
    v = rng.normal(3, 0.2, field.shape)
    mask = field.valid & (
        rng.random(field.shape) > 0.3
    )  # holes, borders and lonely pixels
    v[~mask] = np.nan
    cuts = rng.random((2, *field.shape)) < 0.3 if is_cut else None
    every = np.s_[::step, ::step]
    facing = normals(v, field, mask)[every]
    expected = slant(*gradient(v, mask, cuts, edge_order=1), field)[every]
    maps = ThinnedMaps(field, mask, cuts, step)
    for _ in range(2):  # what it keeps is not used up
        np.testing.assert_allclose(maps.slant(v), expected, rtol=1e-12, equal_nan=True)
        np.testing.assert_allclose(maps.normals(v), facing, rtol=1e-12, equal_nan=True)
