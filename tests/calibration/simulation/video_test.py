"""The simulated calibration video: what a hand may do with a sheet."""

from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab.calibration.simulation.trajectory import trajectory
from endolab.calibration.simulation.video import simulate_samples

CAMERA = el.load_calibration("paper").camera
FOLDED = el.TARGETS["vicalib_folded"]


@pytest.mark.parametrize("fold", [0.0, 0.05, 1.2])
def test_panels_share_the_fold_and_turn_away(fold):
    ridge = np.array([[FOLDED.fold_x, y, 0.0] for y in (0.0, 38.0)])
    for left, right in trajectory(FOLDED, CAMERA, 30, fold=fold):
        np.testing.assert_allclose(
            left.transform(ridge), right.transform(ridge), atol=1e-9
        )
        assert left.normal @ right.normal == pytest.approx(np.cos(fold), abs=1e-12)
        # Convex: each panel lies behind the plane of the other, seen from where the sheet is read.
        tip = right.transform([[76.0, 19.0, 0.0]])
        assert np.all((tip - left.translation) @ left.normal <= 1e-9)


@pytest.mark.parametrize(("noise", "off"), [(0.0, 1e-12), (0.01, 0.5 / 255)])
def test_levels_are_rounded_if_there_is_noise(noise, off):
    light = el.Photometry(2.5, 2.2, None, el.Lambertian(0.8))
    how = {"noise": noise, "outliers": 0.0, "per_frame": 50}
    samples, gains = simulate_samples(FOLDED, CAMERA, light, 4, **how)
    paper = samples[samples.material == 0]
    bright = replace(light, gain=1.0).intensity(paper.points, paper.normals)
    level = np.minimum(bright * gains[paper.frame] ** (1 / light.gamma), 1.0)
    largest = np.abs(paper.level - level).max()
    assert 0.8 * off <= largest <= 1.2 * off if noise else largest < off
