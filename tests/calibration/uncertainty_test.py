"""Maps of uncertainty against cameras and lights that are drawn, and against a fit's own true error."""

import numpy as np
import pytest
import scipy
from scipy.spatial.transform import Rotation

from endolab import datasets
from endolab.calibration.geometric.projection import camera_of, camera_vector
from endolab.calibration.uncertainty import (
    places,
    ray_uncertainty,
)

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
    seen = np.isfinite(PAPER.unproject(places(PAPER))[..., 0])
    assert 0 < seen.sum() < seen.size
    lost = covariance()
    lost[2, 2] = np.inf
    for known, value in ((lost, np.inf), (covariance(), 0)):
        found = ray_uncertainty(PAPER, known)
        for values in (found.px, found.mrad):
            assert np.array_equal(np.isnan(values), ~seen)
            assert np.all(values[seen] >= value)
