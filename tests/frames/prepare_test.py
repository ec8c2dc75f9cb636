"""A frame is prepared by what is in it: the lumen, highlights."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.frames.prepare import dark_lumen, prepare, undistort_frame

WET = {"noise": 2.0, "bits": 8, "highlights": 0.02}


@pytest.fixture(scope="module")
def known():
    return datasets.load_calibration("paper", width=480)


@pytest.fixture(scope="module")
def wet(known):
    """Give a wet wall."""
    seen = el.render(el.SCENES["curved"], known.camera, known.photometry, **WET)
    return el.Frame(seen.image, seen.mask)


@pytest.mark.parametrize("size", [0.5, 0.8, 1.5])
def test_white_letters_are_taken_for_highlights(known, size):
    how = {"noise": 2.0, "bits": 8, "texture": 0.1}
    colon = el.render(el.SCENES["colon"], known.camera, known.photometry, **how)
    ink = np.zeros(colon.mask.shape, np.uint8)
    cv2.putText(ink, "EXIT 12:34", (150, 180), cv2.FONT_HERSHEY_SIMPLEX, size, 255, 2)
    share = ink[..., None] / 255
    picture = colon.image * (1 - share) + 0.95 * share
    ready = prepare(el.Frame(picture, colon.mask), known)
    assert ready.highlights[ink > 127].mean() > 0.99


def test_the_lumen_is_where_noise_says_more_than_the_wall(rng):
    rows, columns = np.indices((360, 480))
    away = np.hypot(rows - 180, columns - 240)
    noise = rng.normal(scale=3 / 255, size=away.shape)
    mask = np.ones(away.shape, bool)
    found = dark_lumen(np.clip(np.where(away < 40, 0.02, 0.5) + noise, 0, 1), mask)
    assert found[away < 37].all()
    assert not found[away >= 43].any()
    assert not dark_lumen(np.full(away.shape, 0.5), mask).any()


def test_undistorted_pixels_are_where_the_cameras_say(known):
    camera = known.camera
    rows, columns = np.indices((camera.height, camera.width)) / camera.width
    frame = el.Frame(np.dstack([columns, rows, 0 * rows]), camera.field.valid)
    made, pinhole = undistort_frame(frame, camera)
    assert np.rad2deg(2 * np.arctan(pinhole.width / 2 / pinhole.fx)) == pytest.approx(
        90
    )
    assert made.mask.mean() > 0.9
    found = made.image[made.mask, :2] * camera.width
    assert np.abs(found - camera.project(pinhole.field.rays[made.mask])).max() < 0.05


@pytest.mark.parametrize("way", ["ignore", "inpaint", "keep"])
def test_prepared_leaves_out_what_it_should(known, wet, way):
    frame = el.Frame(wet.image, np.ones_like(wet.mask))
    ready = prepare(frame, known, highlights=way)
    assert ready.highlights.any()
    assert not ready.frame.mask[~ready.field_of_view].any()
    assert not (ready.field_of_view & ~wet.mask).any()
    assert ready.frame.mask[ready.highlights & ~ready.lumen].all()
    assert np.array_equal(ready.frame.image, wet.image) == (way != "inpaint")


def test_a_grey_and_a_saturated_frame_are_prepared(known, wet):
    ready = prepare(replace(wet, image=wet.image[..., 1]), known, highlights="inpaint")
    assert (ready.canonical.ndim, ready.highlights.any()) == (2, True)
    white = np.ones_like(wet.image)
    ready = prepare(el.Frame(white, np.ones_like(wet.mask)), known)
    assert not ready.highlights.any()
    assert not ready.lumen.any()
