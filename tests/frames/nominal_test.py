"""A picture of an endoscope that nobody calibrated, and parts of a calibration's pictures."""

from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab.frames.nominal import nominal_of_several
from endolab.model.photometry import NOMINAL

CAMERA = el.KannalaBrandt(80, 60, 30.0, 30.0, 41.0, 28.0, (0.02, 0.0, 0.0, 0.0))


def disc(height, width, column, row, radius):
    i, j = np.indices((height, width))
    inside = np.hypot(j - column, i - row) < radius
    return el.Frame(np.where(inside, 0.5 + 0.1 * np.sin(j / 9), 0.0), inside)


@pytest.mark.parametrize(
    ("frame", "fov", "pixels"),
    [
        (disc(240, 320, 150, 118, 100), 90, [[50, 118], [150, 118], [150, 218]]),
        (disc(240, 320, 150, 118, 100), 140, [[50, 118], [150, 118], [150, 218]]),
        (disc(240, 320, 0, 0, 999), 120, [[0, 0], [159.5, 119.5], [319, 239]]),
    ],
)
def test_the_field_of_view_is_that_of_the_disc_or_the_diagonal(frame, fov, pixels):
    nominal = el.nominal_calibration(frame, fov)
    angles = np.rad2deg(np.arccos(nominal.camera.unproject(pixels)[:, 2]))
    assert angles == pytest.approx([fov / 2, 0, fov / 2], abs=1)
    assert nominal.photometry == NOMINAL
    assert nominal.photometry.gain is None


def test_of_several_frames_the_widest_field_but_one_counts_for_each_size():
    blue = el.Frame(
        np.tile(np.linspace(0.1, 0.2, 320), (240, 1)), np.ones((240, 320), bool)
    )
    dark_side, *discs = (disc(240, 320, 150, 118, radius) for radius in (80, 100, 100))
    small = disc(120, 120, 60, 60, 50)
    known = nominal_of_several([blue, dark_side, discs[0], small, discs[1]], 140)
    for frame in (discs[0], small):
        own = el.nominal_calibration(frame)
        assert known.fit("", frame.width, frame.height).camera == own.camera


def test_a_crop_that_is_enlarged_sees_along_the_same_rays():
    known = el.Calibration(CAMERA, el.Photometry(k=2))
    zoomed = known.crop(10, 6, 40, 30).fit("frame", 80, 60)
    assert zoomed.photometry == known.photometry
    assert known.fit("frame", 161, 121).camera.width == 161
    pixels = np.array([[0.0, 0.0], [33.0, 12.0], [79.0, 59.0]])
    before = (pixels + 0.5) / 2 - 0.5 + [10, 6]
    np.testing.assert_allclose(
        zoomed.camera.unproject(pixels), CAMERA.unproject(before), atol=1e-12
    )


def test_a_light_that_is_missing_is_nominal_and_the_evidence_says_so():
    content = el.Calibration(CAMERA, el.Photometry(), {"x": 1}).to_dict()
    del content["photometry"]
    read = el.Calibration.from_dict(content)
    assert read.photometry == NOMINAL
    assert read.evidence == {"x": 1, "photometry": {"nominal": True}}
    again = el.Calibration.from_dict(replace(read).to_dict())
    assert again == read
