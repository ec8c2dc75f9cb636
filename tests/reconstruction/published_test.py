"""How far published frames are off, where they are here."""

import numpy as np
import pytest

import endolab as el
from endolab.metrics.depth_errors import compare


@pytest.mark.parametrize(
    ("name", "index", "options", "most"),
    [
        ("c3vd_trans_t1_a", 0, {"width": 675}, 9.5),
        ("c3vd_trans_t1_a", 0, {"width": 675, "solver": "facing"}, 15),
        ("simcol3d", 3, {}, 10),
    ],
)
def test_errors_on_published_frames(data, name, index, options, most):
    """Measured: over a phantom the default 8.3 to 9.1 %, d₀ 13.9; over a synthetic colon 9.0 to 10.9."""
    sample = el.open_dataset(data / name)[index]
    result = el.reconstruct(sample.frame, sample.calibration, **options)
    cosine = result.problem.field.cos_alpha
    height, width = cosine.shape
    shape = height, len(sample.distance) // height, width, -1
    truth = sample.distance.reshape(shape).mean(axis=(1, 3))  # nan where part of it is
    mask = cosine > np.cos(np.deg2rad(55))
    errors = compare(result.distance, truth, cosine, mask=mask, align="scale")
    assert errors.pixels > 0.5 * mask.sum()
    assert errors.mean_percent < most
