"""Samples: levels, places and normals as the model and the scene say."""

from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab.calibration.geometric.pose import Pose
from endolab.calibration.photometric.samples import sample_sheet
from endolab.calibration.simulation.trajectory import fold_pose, trajectory
from endolab.calibration.simulation.video import PAPER_SHEET, render_sheet

CAMERA = el.load_calibration("paper", 720).camera
PAPER = el.Photometry(k=2.5, gamma=2.2, brdf=PAPER_SHEET)
TABLE = el.TabulatedBRDF((0.0, 0.5, 1.5), (0.3, 0.25, 0.1))
BESIDE = el.SpotLight((3.0, 0.0, 0.0), exponent=1.0)


@pytest.mark.parametrize(
    ("name", "light"),
    [
        ("vicalib_small", PAPER),
        ("vicalib_folded", PAPER),
        ("vicalib_grey", replace(PAPER, brdf=TABLE)),
        ("charuco", replace(PAPER, lights=(BESIDE,))),
    ],
)
def test_a_clean_frame_gives_the_models_levels(name, light):
    target = el.TARGETS[name]
    fair_ones = 0
    how = {"fold": 0.5 if target.fold else 0.0, "distance": (25.0, 60.0), "tilt": 0.8}
    for poses in trajectory(target, CAMERA, 8, **how):
        frame = render_sheet(target, poses, CAMERA, light, noise=0.0)
        samples = sample_sheet(frame.image, target, poses, CAMERA, most=500)
        known = replace(light, gain=frame.gain)
        level = known.intensity(samples.points, samples.normals)
        level *= np.where(samples.material == 1, 0.5, 1.0) ** (1 / 2.2)
        fair = (level < 0.92) & (samples.cos_theta > 0.15)
        fair_ones += fair.sum()
        np.testing.assert_allclose(
            255 * samples.level[fair], 255 * level[fair], atol=0.3
        )
        pixels = CAMERA.project(samples.points)
        np.testing.assert_allclose(pixels, np.round(pixels), atol=1e-6)
    assert fair_ones > 100


def test_panels_not_found_and_a_sheet_out_of_the_picture_give_nothing():
    target = el.TARGETS["vicalib_folded"]
    middle = Pose(np.eye(3), [-target.fold_x, -20.0, 40.0])
    poses = fold_pose(target, middle, 0.4)
    image = np.full((540, 720), 0.5)
    right = sample_sheet(image, target, [None, poses[1]], CAMERA, most=999)
    assert len(right) > 0
    assert np.all(right.normals == poses[1].normal)
    for shift in ([500.0, 0.0, 0.0], [0.0, 0.0, -80.0]):
        moved = replace(poses[1], translation=poses[1].translation + shift)
        assert len(sample_sheet(image, target, [None, moved], CAMERA)) == 0
