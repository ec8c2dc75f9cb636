"""Maps of uncertainty against cameras and lights that are drawn, and against a fit's own true error."""

from dataclasses import replace

import numpy as np
import pytest
import scipy
from scipy.spatial.transform import Rotation

from endolab import datasets
from endolab.calibration.geometric.projection import camera_of, camera_vector
from endolab.calibration.uncertainty import (
    fall_off_uncertainty,
    places,
    ray_uncertainty,
)
from tests.tools.simulated_session import simulated

PAPER = datasets.load_calibration("paper", width=160).camera
WIDE = np.deg2rad(70)  # the picture without its corners
SPREAD = np.array(
    [0.05, 0.06, 0.2, 0.15, 2e-4, 2e-4, 1e-4, 3e-5]
)  # px, and of k1 to k4


def covariance(seed=0):
    """One whose numbers hang together, of the sizes of a calibration."""
    mixed = np.eye(8) + 0.4 * np.random.default_rng(seed).standard_normal((8, 8))
    found = mixed @ mixed.T
    scale = SPREAD / np.sqrt(np.diag(found))
    return found * scale * scale[:, None]


def rms(a):
    """Over draws, of the length."""
    return np.sqrt(np.mean(np.sum(a**2, axis=-1), axis=0))


def turned_back(camera, true, rays):
    """The turn by which another camera's pixels of rays are most like the true one's."""

    def off(vector):
        turned = Rotation.from_rotvec(vector).apply(rays.reshape(-1, 3))
        return (camera.project(rays).reshape(-1, 2) - true.project(turned)).ravel()

    return Rotation.from_rotvec(scipy.optimize.least_squares(off, np.zeros(3)).x)


def test_rays_are_as_uncertain_as_those_of_cameras_that_are_drawn():
    """2000 cameras: the ray of each pixel, the pixel of each ray, and what is left after the best turn."""
    sure = covariance()
    pixels = places(PAPER, 16)[1:-1, 2:-2]
    found = ray_uncertainty(PAPER, sure, pixels)
    rays = PAPER.unproject(pixels)
    drawn = np.random.default_rng(1).multivariate_normal(
        camera_vector(PAPER), sure, 2000
    )
    cameras = [camera_of(vector, 160, 120) for vector in drawn]
    others = np.array([camera.unproject(pixels) for camera in cameras])
    assert found.mrad == pytest.approx(1e3 * rms(others - rays), rel=0.06)
    assert found.px == pytest.approx(
        rms(np.array([c.project(rays) for c in cameras]) - pixels), rel=0.06
    )
    some = [turned_back(camera, PAPER, rays) for camera in cameras[:300]]
    turned = np.array(
        [turn.apply(o.reshape(-1, 3)) for turn, o in zip(some, others, strict=False)]
    )
    ratio = found.mrad_shape.ravel() / (1e3 * rms(turned - rays.reshape(-1, 3)))
    assert np.median(ratio) == pytest.approx(1, rel=0.05)
    assert ratio == pytest.approx(1, rel=0.2)
    size = np.sqrt(np.mean([turn.magnitude() ** 2 for turn in some]))
    assert found.mrad_turn == pytest.approx(1e3 * size, rel=0.1)


def test_what_is_not_told_is_unknown_and_what_no_ray_has_is_nan():
    lost = covariance()
    lost[2, 2] = np.inf
    found = ray_uncertainty(PAPER, lost)
    seen = np.isfinite(PAPER.unproject(places(PAPER))[..., 0])
    assert np.isinf(found.mrad_turn)
    for values in (found.px, found.mrad):
        assert np.array_equal(np.isinf(values), seen)
    assert 0 < seen.sum() < seen.size
    found = ray_uncertainty(PAPER, covariance())
    for values in (found.px, found.mrad, found.mrad_shape):
        assert np.array_equal(np.isfinite(values), seen)
        assert np.array_equal(np.isnan(values), ~seen)


def test_the_light_is_as_uncertain_as_k():
    session = simulated()[0]
    light = session.light
    cosine = PAPER.unproject(places(PAPER))[..., 2]
    found = fall_off_uncertainty(light, PAPER)
    below = light.photometry.attenuation(cosine)
    k = light.k + light.standard_errors["k"]
    above = replace(light.photometry, k=k).attenuation(cosine)
    seen = np.isfinite(cosine)
    assert found[seen] == pytest.approx(100 * np.log(below / above)[seen], abs=1e-9)
    assert np.isnan(found[~seen]).all()
    assert found[45, 60] < 0.01 < found[45, 5]  # nothing on the axis
