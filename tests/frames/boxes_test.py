"""Boxes on the screen are told from the wall by where they are; walls have none."""

import numpy as np
import pytest

import endolab as el
from endolab import datasets
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
def test_a_box_is_found_where_it_is(rng, what, columns, rows, noise):
    image = el.load_traced("diffuse-1").frame.image.copy()
    box = image[slice(*rows), slice(*columns)]
    second = image[::3, ::3][: box.shape[0], : box.shape[1]].copy()
    box[:] = second if what == "second picture" else 0.25
    if "text" in what:
        box[10:18, 10:110:3] = 0.9
    image = (image + rng.normal(scale=noise / 255, size=image.shape)).clip(0, 1)
    assert find_box(image, np.ones(image.shape[:2], bool)) == (*columns, *rows)


@pytest.mark.parametrize("name", datasets.TRACED)
def test_a_wall_has_no_box(name):
    frame = el.load_traced(name).frame
    assert find_box(frame.image, frame.mask) is None
