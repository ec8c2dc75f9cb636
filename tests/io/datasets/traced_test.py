"""The path-traced frames that come with endolab: what they hold fits together, and nothing is lost."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import endolab as el
from tests.research.make_traced_frames import CASES
from tests.research.mucosa import VEIL


@pytest.mark.parametrize("name", CASES)
def test_layers_make_the_picture_and_the_truth_is_the_scene(name):
    sample = el.load_traced(name)
    *_, options = CASES[name]
    frame, known = sample.frame, sample.calibration
    mask = frame.mask
    rays = known.camera.field.rays
    true = sample.scene.distance(rays)
    assert_allclose(sample.distance[mask], true[mask], atol=0.002)
    facing = np.einsum("ij,ij->i", sample.normals[mask], rays[mask])
    assert np.mean(facing < 0) > 0.999
    linear = sample.direct + sample.indirect + sample.mirrored[..., None]
    if "fog" in options:
        thick = 1 - np.exp(-options["fog"] * np.nan_to_num(sample.distance))
        linear += VEIL * thick[..., None]
    stored = np.clip(linear, 0, 1) ** (1 / known.photometry.gamma)
    clipped = (frame.image == 1) | (frame.image == 0)
    error = 255 * (stored - frame.image)[mask][~clipped[mask]]
    noise = np.hypot(options.get("noise", 0.0), 0.3)  # of the sensor, and of rounding
    assert np.std(error) == pytest.approx(noise, rel=0.1)
    assert abs(error.mean()) < 0.05
    # Light bounces most in red.
    share = np.median((sample.indirect / np.maximum(sample.direct, 1e-9))[mask], axis=0)
    assert share[0] > 2 * share[1] > 2 * share[2] > 0.2
