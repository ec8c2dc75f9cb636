"""Highlights are found where the film mirrors and nowhere else, and are filled in smoothly."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.frames.highlights import find_highlights, inpaint


def wall(kind="curved", gain=None, **options):
    """A rendered wall, its mask and its gain."""
    known = datasets.load_calibration("paper", width=480)
    light = replace(known.photometry, gain=gain)
    seen = el.render(el.SCENES[kind], known.camera, light, **options)
    return seen.image, seen.mask, seen.photometry.gain


@pytest.mark.parametrize("kind", ["plane", "colon"])
def test_a_dry_wall_has_none(kind):
    image, mask, _ = wall(kind, noise=3.0, bits=8, texture=0.1)
    for picture, share in ((image, 0.002), (image[..., 1], 0.004)):
        assert find_highlights(picture, mask)[mask].mean() < share


def test_a_wet_wall_has_those_that_the_film_mirrors_and_fewer_are_found_without_colour():
    """The truth: more than a fifth of the tissue's green light."""
    dry, mask, gain = wall()
    clean, image = (
        wall(gain=gain, highlights=0.02, **how)[0]
        for how in ({}, {"noise": 3.0, "bits": 8})
    )
    truth = mask & (clean[..., 1] ** 2.2 > 1.2 * dry[..., 1] ** 2.2)
    assert truth.sum() > 100
    for picture, share in ((image, 0.6), (image[..., 1], 0.3)):
        found = find_highlights(picture, mask)
        assert (found & truth).sum() > share * truth.sum()
        assert (found & truth).sum() > 0.6 * found.sum()
    same = np.repeat(image[..., 1:2], 3, axis=-1)
    assert np.mean(find_highlights(same, mask) != found) < 0.005


@pytest.mark.parametrize("size", [0.5, 0.8, 1.5])
def test_white_letters_are_taken_for_highlights(size):
    image, mask, _ = wall("colon", noise=2.0, bits=8, texture=0.1)
    ink = np.zeros(mask.shape, np.uint8)
    cv2.putText(ink, "EXIT 12:34", (150, 180), cv2.FONT_HERSHEY_SIMPLEX, size, 255, 2)
    share = ink[..., None] / 255
    found = find_highlights(image * (1 - share) + 0.95 * share, mask)
    assert found[ink > 127].mean() > 0.99


ROWS, COLUMNS = np.indices((240, 320))
NEAR = np.exp(-((ROWS - 120) ** 2 + (COLUMNS - 160) ** 2) / (2 * 60**2))
TISSUE = np.array([0.75, 0.38, 0.30])


@pytest.mark.parametrize(
    ("image", "share"),
    [
        (np.ones((30, 40)), 0),
        (np.ones((1, 1, 3)), 0),
        (np.minimum(2 * NEAR[..., None] * TISSUE, 1) ** (1 / 2.2), 0.002),
    ],
    ids=["grey", "one pixel", "large and overexposed"],
)
def test_what_is_bright_but_large_is_no_highlight(image, share):
    assert find_highlights(image, np.ones(image.shape[:2], bool)).mean() <= share


def test_a_smooth_picture_is_filled_within_two_per_cent(rng):
    dry, mask, _ = wall()
    holes = np.zeros(mask.shape, bool)
    for row, column in rng.integers(40, 300, (40, 2)):
        holes[row : row + 9, column : column + 13] = True
    holes &= mask
    filled = inpaint(np.where(holes[..., None], 1.0, dry), holes, mask)
    lit = holes & (dry[..., 1] > 0.1)
    assert np.abs(filled[lit] / dry[lit] - 1).mean() < 0.02
    assert np.array_equal(filled[~holes], dry[~holes])


@pytest.mark.parametrize("black", [0, 10])
def test_filling_makes_no_peak_does_not_leak_and_turns_with_the_picture(rng, black):
    """Of neighbours that were as near, one left 1e-8 of itself, which a wet wall's solve made 1 %."""
    image = rng.uniform(0.3, 0.6, (40, 50))
    image[:, :black] = 0.0
    mask = image > 0
    holes = np.zeros(image.shape, bool)
    holes[5:31, 5:30] = holes[35:, 45:] = True
    filled = inpaint(image, holes, mask)
    inside = filled[holes & mask]
    assert 0.3 <= inside.min() <= inside.max() <= 0.6
    assert not filled[~mask].any()
    mirrored = inpaint(image[:, ::-1], holes[:, ::-1], mask[:, ::-1])[:, ::-1]
    np.testing.assert_allclose(mirrored, filled, rtol=1e-9)


def test_phantoms_keep_their_tissue(data):
    for sample in (
        datasets.open_dataset(data / "c3vd_trans_t1_a")[0],
        datasets.open_dataset(data / "simcol3d")[0],
    ):
        mask = sample.frame.mask
        assert find_highlights(sample.frame.image, mask)[mask].mean() < 0.005
