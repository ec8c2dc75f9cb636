"""What is shown of a frame is what was solved: each pixel, or why it was left out, and the light."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import endolab as el

KNOWN = el.load_calibration("paper", width=160)


def disc(row, column):
    """Give a part of the picture, 14 px across; one with straight edges is left out as a menu."""
    rows, columns = np.indices(KNOWN.camera.field.valid.shape)
    return np.hypot(rows - row, columns - column) < 7


@pytest.mark.parametrize("channel", ["green", "separated", "grey"])
@pytest.mark.parametrize("asked", [True, False], ids=["mask", "surround"])
def test_each_pixel_is_solved_or_says_why_not(channel, asked):
    seen = el.render(el.SCENES["curved"], KNOWN.camera, KNOWN.photometry)
    dark, bright, overlay = disc(46, 46), disc(46, 86), disc(76, 66)
    parts = [dark[..., None], bright[..., None]]
    image = np.select(parts, [0.01 * seen.image, 1.0], seen.image)
    mask = seen.mask & ~disc(26, 66) if asked else np.ones_like(seen.mask)
    if channel == "grey":
        image = image[..., 1]
    frame = el.Frame(image, mask, silent=overlay)
    how = {"smooth": 0, "highlights": "keep", "max_iterations": 1}
    result = el.reconstruct(frame, KNOWN, channel=channel, **how)
    shown = el.prepare(result)
    assert_array_equal(shown.field_of_view, frame.pixels_to_use())
    outside, inside = ~shown.field_of_view, result.mask
    assert_array_equal(1 * outside + shown.without_ray + shown.dark + inside, 1)
    assert shown.without_ray.any()
    assert np.rad2deg(np.arccos(KNOWN.camera.field.cos_alpha[inside])).max() < 80
    for found, given in (
        (shown.dark, dark),
        (shown.saturated, bright),
        (shown.highlights, overlay),
    ):
        assert_array_equal(found, given)
    assert_array_equal(np.isfinite(shown.solved), inside)
    assert len(shown.notes) == 6


def test_without_the_fall_off_a_wall_that_is_lit_alike_looks_alike():
    cosine = np.fmax(KNOWN.camera.field.cos_alpha, 0.01)
    light = 0.3 * np.where(np.arange(cosine.shape[1]) < 80, 1.0, 0.5) * cosine**3.0
    tissue = np.array([1.0, 0.5, 0.4])
    photometry = el.Photometry(k=3.0, gamma=2.0, gain=None)
    calibration = replace(KNOWN, photometry=photometry)
    frame = el.Frame((light[..., None] * tissue) ** 0.5, KNOWN.camera.field.valid)
    result = el.reconstruct(frame, calibration, channel="green", solver="facing")
    shown = el.prepare(result)
    assert_allclose(shown.canonical[60, 30:60] ** 2, np.tile(0.81 * tissue, (30, 1)))
    assert_allclose(shown.canonical[60, 100:130] ** 2 / (0.405 * tissue), 1.0)
    assert_array_equal(np.isfinite(shown.canonical[..., 0]), result.mask)
