"""Highlights are found where the film mirrors and nowhere else, and are filled in smoothly."""

import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.frames.highlights import find_highlights, inpaint


def wall(kind="curved", **options):
    known = datasets.load_calibration("paper", width=480)
    return el.render(el.SCENES[kind], known.camera, known.photometry, **options)


@pytest.fixture(scope="module")
def film():
    """Give a wet wall and which pixels mirror more than a fifth of the tissue's green light."""
    dry = wall()
    clean = el.render(el.SCENES["curved"], dry.camera, dry.photometry, highlights=0.02)
    noise = np.random.default_rng(0).normal(scale=3 / 255, size=clean.image.shape)
    image = (
        np.round(255 * np.clip(clean.image + noise * clean.mask[..., None], 0, 1)) / 255
    )
    return (
        image,
        clean.mask,
        clean.mask & (clean.image[..., 1] ** 2.2 > 1.2 * dry.image[..., 1] ** 2.2),
    )


@pytest.mark.parametrize("kind", ["plane", "colon"])
def test_a_dry_wall_has_none(kind):
    dry = wall(kind, noise=3.0, bits=8, texture=0.1)
    for image, share in ((dry.image, 0.002), (dry.image[..., 1], 0.004)):
        assert find_highlights(image, dry.mask)[dry.mask].mean() < share


def test_a_wet_wall_has_those_that_the_film_mirrors_and_fewer_are_found_without_colour(
    film,
):
    image, mask, truth = film
    assert truth.sum() > 100
    for picture, share in ((image, 0.6), (image[..., 1], 0.3)):
        found = find_highlights(picture, mask)
        assert (found & truth).sum() > share * truth.sum()
        assert (found & truth).sum() > 0.6 * found.sum()
    same = np.repeat(image[..., 1:2], 3, axis=-1)
    assert np.mean(find_highlights(same, mask) != found) < 0.005


@pytest.mark.parametrize("shape", [(30, 40), (1, 1, 3)])
def test_a_constant_picture_has_none(shape):
    assert not find_highlights(np.ones(shape), np.ones(shape[:2], bool)).any()


def test_a_large_overexposed_wall_is_no_highlight():
    rows, columns = np.indices((240, 320))
    near = np.exp(-((rows - 120) ** 2 + (columns - 160) ** 2) / (2 * 60**2))
    image = np.clip(2.0 * near[..., None] * np.array([0.75, 0.38, 0.30]), 0, 1) ** (
        1 / 2.2
    )
    assert find_highlights(image, np.ones(rows.shape, bool)).mean() < 0.002


def test_a_smooth_picture_is_filled_within_two_per_cent(rng):
    dry = wall("curved")
    holes = np.zeros(dry.mask.shape, bool)
    for row, column in rng.integers(40, 300, (40, 2)):
        holes[row : row + 9, column : column + 13] = True
    holes &= dry.mask
    filled = inpaint(np.where(holes[..., None], 1.0, dry.image), holes, dry.mask)
    lit = holes & (dry.image[..., 1] > 0.1)
    assert np.abs(filled / np.where(dry.image > 0, dry.image, 1) - 1)[lit].mean() < 0.02
    assert np.array_equal(filled[~holes], dry.image[~holes])


def test_filling_makes_no_peak_and_does_not_leak(rng):
    image = rng.uniform(0.3, 0.6, (40, 50))
    holes = np.zeros((40, 50), bool)
    mask = np.ones(image.shape, bool)
    mask[:, :10] = False
    image[~mask] = 0.0
    holes[5:30, 5:30] = holes[35:, 45:] = True
    filled = inpaint(image, holes, mask)
    inside = filled[holes & mask]
    assert 0.3 <= inside.min() <= inside.max() <= 0.6
    assert not filled[~mask].any()


def test_a_mirrored_picture_is_filled_mirrored(rng):
    """Of neighbours that were as near, one left 1e-8 of itself, which a wet wall's solve made 1 %."""
    image = rng.uniform(0.3, 0.6, (40, 50))
    holes = np.zeros((40, 50), bool)
    holes[5:31, 5:30] = True
    mask = np.ones(image.shape, bool)
    filled = inpaint(image, holes, mask)
    mirrored = inpaint(image[:, ::-1], holes[:, ::-1], mask)[:, ::-1]
    np.testing.assert_allclose(mirrored, filled, rtol=1e-9)


def test_phantoms_keep_their_tissue(data):
    samples = (
        datasets.read_c3vd(data / "c3vd_trans_t1_a", 1),
        datasets.read_simcol3d(data / "simcol3d", 0),
    )
    for frame in (sample.frame for sample in samples):
        assert find_highlights(frame.image, frame.mask)[frame.mask].mean() < 0.005
