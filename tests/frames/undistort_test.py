"""A frame as a pinhole camera would show it."""

import numpy as np
import pytest

import endolab as el
from endolab.frames.undistort import undistort_frame


def test_undistorted_pixels_are_where_the_cameras_say():
    camera = el.load_calibration("paper", width=480).camera
    rows, columns = np.indices((camera.height, camera.width)) / camera.width
    frame = el.Frame(np.dstack([columns, rows, 0 * rows]), camera.field.valid)
    made, pinhole = undistort_frame(frame, camera)
    assert np.rad2deg(2 * np.arctan(pinhole.width / 2 / pinhole.fx)) == pytest.approx(
        90
    )
    assert made.mask.mean() > 0.9
    found = made.image[made.mask, :2] * camera.width
    assert np.abs(found - camera.project(pinhole.field.rays[made.mask])).max() < 0.05
