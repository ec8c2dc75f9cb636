"""Samples: levels, places and normals as the model and the scene say."""

from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab.calibration.photometric.samples import sample_sheet
from endolab.calibration.simulation.sheet_image import Sensor, render_sheet
from endolab.calibration.simulation.trajectory import Movement, trajectory
from endolab.calibration.simulation.video import PAPER_SHEET

CAMERA = el.load_calibration("paper", 720).camera
PAPER = el.Photometry(k=2.5, gamma=2.2, brdf=PAPER_SHEET)


@pytest.mark.parametrize(
    "name", ["vicalib_small", "vicalib_folded", "vicalib_grey", "charuco"]
)
def test_a_clean_frame_gives_the_models_levels(name):
    target = el.TARGETS[name]
    fair_ones = 0
    movement = Movement(0.5 if target.fold else 0.0, distance=(25.0, 60.0), tilt=0.8)
    for number, poses in enumerate(trajectory(target, CAMERA, 6, movement)):
        frame = render_sheet(target, poses, CAMERA, PAPER, Sensor(noise=0.0, bits=16))
        samples = sample_sheet(
            frame.image, target, poses, CAMERA, frame=number, most=500
        )
        known = replace(PAPER, gain=frame.gain)
        linear = known.intensity(samples.points, samples.normals) ** 2.2
        model = (linear * np.where(samples.material == 1, 0.5, 1.0)) ** (1 / 2.2)
        fair = (model < 0.92) & (samples.cos_theta > 0.15)
        fair_ones += fair.sum()
        np.testing.assert_allclose(
            255 * samples.level[fair], 255 * model[fair], atol=0.3
        )
        assert np.all(samples.frame == number)
        panels = [
            np.all(np.abs(samples.normals - pose.normal) < 1e-12, axis=1)
            for pose in poses
        ]
        assert np.all(np.sum(panels, axis=0) == 1)
        for pose, here in zip(poses, panels, strict=True):
            np.testing.assert_allclose(
                (samples.points[here] - pose.translation) @ pose.normal, 0, atol=1e-9
            )
        pixels = CAMERA.project(samples.points)
        np.testing.assert_allclose(pixels, np.round(pixels), atol=1e-6)
        assert samples.cos_theta.min() > 0
    assert fair_ones > 100


def test_panels_not_found_and_a_sheet_out_of_the_picture_give_nothing():
    target = el.TARGETS["vicalib_folded"]
    poses = trajectory(
        target, CAMERA, 1, Movement(0.4, (40.0, 40.0), tilt=0.0, reach=0.0)
    )[0]
    image = render_sheet(target, poses, CAMERA, PAPER, Sensor(noise=0.0)).image
    whole = sample_sheet(image, target, poses, CAMERA, most=999)
    right = sample_sheet(image, target, [None, poses[1]], CAMERA, most=999)
    assert 0 < len(right) < len(whole)
    assert np.all(right.normals == poses[1].normal)
    assert len(sample_sheet(image, target, [None, None], CAMERA)) == 0
    target = el.TARGETS["vicalib_small"]
    pose = trajectory(
        target, CAMERA, 1, Movement(distance=(40.0, 40.0), tilt=0.0, reach=0.0)
    )[0][0]
    for shift in ([500.0, 0.0, 0.0], [0.0, 0.0, -80.0]):
        moved = replace(pose, translation=pose.translation + shift)
        assert len(sample_sheet(np.zeros((540, 720)), target, [moved], CAMERA)) == 0
