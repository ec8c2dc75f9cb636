"""Boxes on the screen are told from the wall by where they are; walls have none."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import endolab as el
from endolab.frames.boxes import find_box


@pytest.mark.parametrize("noise", [0.0, 2.0])
@pytest.mark.parametrize(
    ("what", "columns", "rows"),
    [
        ("menu", (4, 84), (6, 96)),
        ("panel with text", (100, 240), (30, 60)),
        ("second picture", (110, 210), (60, 140)),
        ("panel at the border", (260, 320), (90, 200)),
    ],
)
def test_a_box_is_found_where_it_is_and_left_out_if_it_is_flat(
    rng, what, columns, rows, noise
):
    image = el.load_traced("diffuse-1").frame.image.copy()
    box = image[slice(*rows), slice(*columns)]
    second = image[::3, ::3][: box.shape[0], : box.shape[1]].copy()
    box[:] = second if what == "second picture" else 0.25
    if "text" in what:
        box[10:18, 10:110:3] = 0.9
    image = (image + rng.normal(scale=noise / 255, size=image.shape)).clip(0, 1)
    everywhere = np.ones(image.shape[:2], bool)
    assert find_box(image, everywhere) == (*columns, *rows)
    # One of one colour is left out, with a pixel around it, unless a mask was given.
    frame = el.Frame(image, everywhere)
    flat = np.zeros_like(everywhere)
    if what != "second picture":
        flat[rows[0] - 1 : rows[1] + 1, columns[0] - 1 : columns[1] + 1] = True
    assert_array_equal(frame.selection.pixels, ~flat)
    assert frame.selection.box_share == flat.mean()
    everywhere[0, 0] = False
    assert el.Frame(image, everywhere).selection.box_share == 0


@pytest.mark.parametrize("name", el.datasets.TRACED)
def test_a_wall_has_no_box(name):
    frame = el.load_traced(name).frame
    assert find_box(frame.image, frame.mask) is None
