"""What is shown of a frame is what was solved: each pixel, or why it was left out, and the light."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

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
    image = np.where(dark[..., None], 0.01 * seen.image, seen.image)
    image[bright] = 1.0
    mask = seen.mask & ~disc(26, 66) if asked else np.ones_like(seen.mask)
    if channel == "grey":
        image = image[..., 1]
    frame = el.Frame(image, mask, silent=overlay)
    how = {"channel": channel, "smooth": 0, "highlights": "keep"}
    result = el.reconstruct(frame, KNOWN, **how)
    shown = el.prepare(result)
    assert_array_equal(shown.field_of_view, frame.selection.pixels)
    inside = result.mask
    left_out = 1 * ~shown.field_of_view + shown.without_ray + shown.dark
    assert_array_equal(left_out + inside, 1)
    assert shown.without_ray.any()
    assert np.rad2deg(np.arccos(KNOWN.camera.field.cos_alpha[inside])).max() < 80
    parts = [shown.dark, shown.saturated, shown.highlights]
    assert_array_equal(parts, [dark, bright, overlay])


def test_without_the_fall_off_a_wall_that_is_lit_alike_is_of_one_brightness():
    light = 0.3 * np.fmax(KNOWN.camera.field.cos_alpha, 0.01) ** 3.0
    stored = light[..., None] ** 0.5 * (1.0, 0.5, 0.4)
    calibration = replace(KNOWN, photometry=el.Photometry(k=3.0, gamma=2.0))
    frame = el.Frame(stored, KNOWN.camera.field.valid)
    result = el.reconstruct(frame, calibration, channel="green", solver="facing")
    canonical = el.prepare(result).canonical
    assert np.abs(canonical[result.mask] - (0.9, 0.45, 0.36)).max() < 1e-9
    assert np.isnan(canonical[~result.mask]).all()
