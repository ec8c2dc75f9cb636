"""The path-traced frames that come with endolab: what they hold fits together, and nothing is lost."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from endolab.io.datasets.traced import LAYERS, load_traced, read
from endolab.synthetic.rendering import VEIL
from tests.tools import make_traced_frames as maker
from tests.tools.make_traced_frames import CASES


@pytest.mark.parametrize("name", CASES)
def test_layers_make_the_picture_and_the_truth_is_the_scene(name):
    sample = load_traced(name)
    options = CASES[name].options
    gamma = sample.calibration.photometry.gamma
    mask = sample.frame.mask
    assert sample.calibration.photometry.gain > 0
    rays = sample.calibration.camera.field.rays
    assert_allclose(
        sample.distance[mask], sample.scene.distance(rays)[mask], atol=0.002
    )
    facing = np.einsum("ij,ij->i", sample.normals[mask], rays[mask])
    assert np.allclose(np.linalg.norm(sample.normals[mask], axis=-1), 1)
    assert np.mean(facing < 0) > 0.999
    linear = sample.direct + sample.indirect + sample.mirrored[..., None]
    if "fog" in options:
        linear += (
            VEIL
            * (1 - np.exp(-options["fog"] * np.nan_to_num(sample.distance)))[..., None]
        )
    error = 255 * (np.clip(linear, 0, 1) ** (1 / gamma) - sample.frame.image)[mask]
    clipped = (sample.frame.image[mask] == 1) | (sample.frame.image[mask] == 0)
    noise = np.hypot(options.get("noise", 0.0), 0.3)  # of the sensor, and of rounding
    assert np.std(error[~clipped]) == pytest.approx(noise, rel=0.1)
    assert abs(error[~clipped].mean()) < 0.05
    # Light bounces most in red.
    share = np.median((sample.indirect / np.maximum(sample.direct, 1e-9))[mask], axis=0)
    assert share[0] > 2 * share[1] > 2 * share[2] > 0.2
    assert (sample.mirrored > 0).any() == ("film" in options)


def made(sample, gain=2.0):
    """What path tracing would have returned."""
    known = sample.calibration
    frame = sample.frame
    layers = {name: getattr(sample, name) for name in ("distance", "normals", *LAYERS)}
    photometry = replace(known.photometry, gain=gain)
    return SimpleNamespace(
        image=frame.image,
        mask=frame.mask,
        camera=known.camera,
        photometry=photometry,
        **layers,
    )


def test_round_trip(tmp_path):
    old = load_traced("wet-1")
    maker.write(tmp_path / "a.npz", made(old), CASES["wet-1"], 64)
    new = read(tmp_path / "a.npz")
    assert new.calibration.photometry.gain == 2.0
    assert new.scene == old.scene
    for name in ("distance", "normals", *LAYERS):
        assert_allclose(getattr(new, name), getattr(old, name), atol=1e-12)


def test_an_unknown_frame():
    with pytest.raises(ValueError, match="'dry'"):
        load_traced("dry")
