"""A frame is prepared by what is in it: the lumen, highlights."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.testing import assert_array_equal

import endolab as el
from endolab import datasets
from endolab.frames.prepare import dark_lumen, prepare, undistort_frame


@pytest.fixture(scope="module")
def known():
    return datasets.load_calibration("paper", width=480)


@pytest.fixture(scope="module")
def colon(known):
    return el.render(
        el.SCENES["colon"],
        known.camera,
        known.photometry,
        noise=2.0,
        bits=8,
        texture=0.1,
    )


@pytest.fixture(scope="module")
def wet(known):
    scene = el.SCENES["curved"]
    gain = el.render(scene, known.camera, known.photometry).photometry.gain
    lit = replace(known.photometry, gain=gain)
    return el.render(scene, known.camera, lit, noise=2.0, bits=8, highlights=0.02)


@pytest.mark.parametrize("size", [0.5, 0.8, 1.5])
def test_white_letters_are_taken_for_highlights(known, colon, size):
    ink = np.zeros(colon.mask.shape, np.uint8)
    cv2.putText(ink, "EXIT 12:34", (150, 180), cv2.FONT_HERSHEY_SIMPLEX, size, 255, 2)
    share = ink[..., None] / 255
    picture = colon.image * (1 - share) + 0.95 * share
    ready = prepare(el.Frame(picture, colon.mask), known)
    assert ready.highlights[ink > 127].mean() > 0.99


def test_the_lumen_is_where_noise_says_more_than_the_wall(known, colon):
    rows, columns = np.indices(colon.mask.shape)
    far = np.hypot(rows - 180, columns - 240) < 40
    rng = np.random.default_rng(1)
    image = np.where(far[..., None], 0.02, 0.5) + rng.normal(
        scale=3 / 255, size=colon.image.shape
    )
    found = dark_lumen(np.clip(image, 0, 1), colon.mask)
    inner = np.hypot(rows - 180, columns - 240) < 37
    outer = np.hypot(rows - 180, columns - 240) < 43
    assert found[inner].all()
    assert not found[~outer].any()
    assert not dark_lumen(np.full(far.shape, 0.5), colon.mask).any()


def test_undistorted_pixels_are_where_the_cameras_say(known):
    camera = known.camera
    rows, columns = np.indices((camera.height, camera.width), dtype=float)
    places = np.stack(
        [columns / camera.width, rows / camera.height, np.zeros_like(rows)], axis=-1
    )
    frame = el.Frame(places, np.isfinite(camera.field.cos_alpha))
    made, pinhole = undistort_frame(frame, camera)
    assert np.isclose(np.rad2deg(2 * np.arctan(pinhole.width / 2 / pinhole.fx)), 90)
    true = camera.project(pinhole.field.rays) / (camera.width, camera.height)
    assert made.mask.mean() > 0.9
    assert np.abs(made.image[..., :2] - true)[made.mask].max() * camera.width < 0.05


@pytest.mark.parametrize("way", ["ignore", "inpaint", "keep"])
def test_prepared_leaves_out_what_it_should(known, wet, way):
    ready = prepare(el.Frame(wet.image, np.ones_like(wet.mask)), known, highlights=way)
    assert ready.highlights.any()
    assert not ready.frame.mask[~ready.field_of_view].any()
    assert (ready.field_of_view & ~wet.mask).sum() == 0
    assert ready.frame.mask[ready.highlights & ~ready.lumen].all()
    assert np.array_equal(ready.frame.image, wet.image) == (way != "inpaint")


def test_prepare_and_reconstruct_mean_the_same(wet, known):
    """Where nothing is too dark, what is prepared solves as what is not, given the same words."""
    camera = el.Pinhole(160, 120, 100.0, 100.0, 79.5, 59.5)
    lit = replace(known.photometry, gain=wet.photometry.gain)
    seen = el.render(
        el.SCENES["curved"], camera, lit, noise=1.0, bits=8, highlights=0.02
    )
    frame = el.Frame(seen.image, seen.mask)
    mine = el.Calibration(camera, lit)
    ready = prepare(frame, mine, highlights="ignore")
    assert ready.highlights.any()
    one = el.reconstruct(ready.frame, mine, channel="green")
    other = el.reconstruct(frame, mine, channel="green", highlights="ignore")
    assert_array_equal(one.distance, other.distance)


def test_a_grey_and_a_saturated_frame_are_prepared(known, colon, wet):
    ready = prepare(el.Frame(wet.image[..., 1], wet.mask), known, highlights="inpaint")
    assert (ready.canonical.ndim, ready.highlights.any()) == (2, True)
    shape = colon.mask.shape
    ready = prepare(el.Frame(np.ones((*shape, 3)), np.ones(shape, bool)), known)
    assert not ready.highlights.any()
    assert not ready.lumen.any()
