"""A picture of an endoscope that nobody calibrated, and parts of a calibration's pictures."""

from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab.model.photometry import NOMINAL

CAMERA = el.KannalaBrandt(80, 60, 30.0, 30.0, 41.0, 28.0, (0.02, 0.0, 0.0, 0.0))


def disc(column, row, radius):
    i, j = np.indices((240, 320))
    inside = np.hypot(j - column, i - row) < radius
    return el.Frame(np.where(inside, 0.5 + 0.1 * np.sin(j / 9), 0.0), inside)


@pytest.mark.parametrize("fov", [90, 140])
@pytest.mark.parametrize(
    ("frame", "pixels"),
    [
        (disc(150, 118, 100), [[50, 118], [150, 118], [150, 218]]),
        (disc(0, 0, 999), [[0, 0], [159.5, 119.5], [319, 239]]),
    ],
)
def test_the_field_of_view_is_that_of_the_disc_or_the_diagonal(frame, fov, pixels):
    nominal = el.nominal_calibration(frame, fov)
    angles = np.rad2deg(np.arccos(nominal.camera.unproject(pixels)[:, 2]))
    assert angles == pytest.approx([fov / 2, 0, fov / 2], abs=1)
    assert nominal.photometry == NOMINAL
    assert nominal.photometry.gain is None


def test_a_crop_that_is_enlarged_sees_along_the_same_rays():
    known = el.Calibration(CAMERA, el.Photometry(k=2))
    zoomed = known.crop(10, 6, 40, 30).fit("frame", 80, 60)
    assert zoomed.photometry == known.photometry
    pixels = np.array([[0.0, 0.0], [33.0, 12.0], [79.0, 59.0]])
    before = (pixels + 0.5) / 2 - 0.5 + [10, 6]
    np.testing.assert_allclose(
        zoomed.camera.unproject(pixels), CAMERA.unproject(before), atol=1e-12
    )
    assert known.fit("frame", 161, 121).camera.width == 161  # a pixel more is no crop


def test_a_light_that_is_missing_is_nominal_and_the_evidence_says_so():
    content = el.Calibration(CAMERA, el.Photometry(), {"x": 1}).to_dict()
    del content["photometry"]
    read = el.Calibration.from_dict(content)
    assert read.photometry == NOMINAL
    assert read.evidence == {"x": 1, "photometry": {"nominal": True}}
    again = el.Calibration.from_dict(replace(read).to_dict())
    assert again == read
