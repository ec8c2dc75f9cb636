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


def turned_back(camera, true, rays):
    """The turn by which another camera's pixels of rays are most like the true one's."""

    def off(vector):
        turned = Rotation.from_rotvec(vector).apply(rays.reshape(-1, 3))
        return (camera.project(rays).reshape(-1, 2) - true.project(turned)).ravel()

    return Rotation.from_rotvec(scipy.optimize.least_squares(off, np.zeros(3)).x)


def test_rays_are_as_uncertain_as_those_of_cameras_that_are_drawn():
    """What is left of 300 cameras after the turn that brings them nearest to the true one."""
    sure = covariance()
    pixels = places(PAPER, 16)[1:-1, 2:-2]
    rays = PAPER.unproject(pixels)
    random = np.random.default_rng(1)
    left = []
    for vector in random.multivariate_normal(camera_vector(PAPER), sure, 300):
        camera = camera_of(vector, 160, 120)
        turn = turned_back(camera, PAPER, rays)
        others = turn.apply(camera.unproject(pixels).reshape(-1, 3))
        left.append(others - rays.reshape(-1, 3))
    found = ray_uncertainty(PAPER, sure, pixels)
    ratio = found.ravel() / (
        1e3 * np.sqrt(np.mean(np.sum(np.square(left), axis=-1), axis=0))
    )
    assert np.median(ratio) == pytest.approx(1, rel=0.05)
    assert ratio == pytest.approx(1, rel=0.2)


def test_what_is_not_told_is_unknown_and_what_no_ray_has_is_nan():
    seen = np.isfinite(PAPER.unproject(places(PAPER))[..., 0])
    assert 0 < seen.sum() < seen.size
    lost = covariance()
    lost[4, 4] = np.inf
    for known, value in ((lost, np.inf), (covariance(), 0)):
        found = ray_uncertainty(PAPER, known)
        assert np.array_equal(np.isnan(found), ~seen)
        assert np.all(found[seen] >= value)
