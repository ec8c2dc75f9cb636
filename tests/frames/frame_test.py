"""A frame before it is solved: channels, shrinking, noise, blur."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import endolab as el
from endolab.frames.frame import smooth_light
from endolab.frames.surround import field_of_view
from endolab.numerics.noise import noise_level
from tests.tools.problems import problem_of

GAMMA = 2.2


def test_channels_of_a_colour_picture(rng):
    image = rng.uniform(size=(4, 6, 3))
    frame = el.Frame(image, np.full((4, 6), 255))
    assert frame.mask.all()
    weights = {
        "red": (1, 0, 0),
        "green": (0, 1, 0),
        "blue": (0, 0, 1),
        "grey": (0.299, 0.587, 0.114),
    }
    for name in weights:
        found, plane = frame.channel(name)
        assert found == name
        assert_allclose(plane, image @ weights[name], rtol=1e-12)
    assert frame.channel()[0] == "green"


@pytest.mark.parametrize(
    ("tint", "noise", "is_grey"),
    [
        ((1, 1, 1), 0, True),
        ((1.02, 1, 0.98), 2, True),
        ((1, 1, 1), 8, True),
        ((1.1, 1, 1), 2, False),
    ],
)
def test_three_channels_that_are_one_make_a_grey_picture(rng, tint, noise, is_grey):
    light = problem_of("curved", 320)[1].image[..., None] * np.array(tint)
    image = (light + rng.normal(scale=noise / 255, size=light.shape)).clip(0, 1)
    image[40:60, 40:150] = 1, 0.9, 0  # letters
    frame = el.Frame(image, np.ones(image.shape[:2], bool))
    assert (frame.image.ndim == 2) is is_grey
    if is_grey:
        weights = (0.299, 0.587, 0.114)
        assert_allclose(frame.channel("red")[1], image @ weights, rtol=1e-12)


@pytest.mark.parametrize("size", [(32, 24), (27, 19), (64, 48), (1, 1)])
def test_shrinking_keeps_the_light(rng, size):
    image = rng.uniform(size=(48, 64, 3))
    small = el.Frame(image, np.ones((48, 64), bool)).resize(*size, GAMMA)
    assert small.mask.shape == size[::-1]
    assert small.mask.all()
    light, expected = ((a**GAMMA).mean(axis=(0, 1)) for a in (small.image, image))
    assert_allclose(light, expected, rtol=1e-6)


@pytest.mark.parametrize("colours", [(), (3,)])
def test_shrinking_averages_the_pixels_of_the_mask_alone(rng, colours):
    image = rng.uniform(size=(12, 16, *colours))
    mask = rng.uniform(size=(12, 16)) < 0.6
    light = (image.T * mask.T).T ** GAMMA
    image[~mask] = rng.choice([np.nan, 1.0, 0.0], size=((~mask).sum(), *colours))
    small = el.Frame(image, mask).resize(8, 6, GAMMA)
    inside = mask.reshape(6, 2, 8, 2).sum(axis=(1, 3))
    assert_array_equal(small.mask, inside >= 2)
    blocks = light.reshape(6, 2, 8, 2, *colours).sum(axis=(1, 3))
    expected = (blocks[small.mask].T / inside[small.mask]).T ** (1 / GAMMA)
    assert_allclose(small.image[small.mask], expected, rtol=1e-6)
    assert np.all(np.isfinite(small.image))


@pytest.mark.parametrize("sigma", [0.5, 1.0, 2.0, 5.0])
def test_noise_is_estimated(rng, sigma):
    _, ball = problem_of("curved", 320)
    noisy = ball.image + rng.normal(scale=sigma / 255, size=ball.mask.shape)
    assert 255 * noise_level(noisy, ball.mask) == pytest.approx(sigma, rel=0.1)


def test_edges_are_not_noise_and_a_mask_two_pixels_wide_shows_none(rng):
    image = np.where(np.indices((100, 100))[1] // 25 % 2, 0.8, 0.2)
    assert noise_level(image, np.ones(image.shape, bool)) == 0
    mask = np.zeros((20, 20), bool)
    mask[4:6] = True
    assert noise_level(rng.uniform(size=mask.shape), mask) == 0


def test_blur_spreads_light_like_a_gaussian():
    """One lit pixel: its light stays, with the variance of the Gaussian along both axes."""
    image = np.zeros((81, 81))
    image[40, 40] = 0.8
    light = smooth_light(image, np.ones(image.shape, bool), GAMMA, 3.0) ** GAMMA
    assert light.sum() == pytest.approx(0.8**GAMMA, rel=1e-9)
    for places in np.indices(image.shape):
        spread = np.average((places - 40) ** 2, weights=light)
        assert spread == pytest.approx(9.0, rel=0.01)


@pytest.mark.parametrize("turn", [np.fliplr, np.flipud, np.transpose])
def test_a_turned_picture_has_the_turned_field_of_view_and_the_same_noise(rng, turn):
    """Once 30 px were seen in one of two that were turned, and equal bytes counted as noise or not."""
    i, j = np.indices((90, 120))
    levels = np.round(rng.uniform(60, 200, i.shape)) / 255
    image = np.where(np.hypot(i - 43, j - 61) < 40, levels, 0.0)
    there = np.ascontiguousarray(turn(image))
    shown, shown_there = field_of_view(image), field_of_view(there)
    assert_array_equal(shown_there, turn(shown))
    expected = noise_level(image, shown)
    assert noise_level(there, shown_there) == pytest.approx(expected, rel=1e-12)
