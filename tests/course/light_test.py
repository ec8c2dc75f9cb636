"""The checks of notebook 07: the right answer passes, and each mistake hears what it is."""

import numpy as np
import pytest

import endolab as el
from endolab import metrics
from endolab.course import light
from endolab.course.verdict import MISSING
from endolab.model.interreflection import Walls


@pytest.fixture(scope="module")
def walls():
    """Give the walls of a small frame."""
    calibration = el.load_calibration("paper", width=64)
    scene = el.render(el.SCENES["colon"], calibration.camera, calibration.photometry)
    cuts = metrics.occlusion_cuts(scene.distance)
    return Walls.of(np.log(scene.distance), scene.mask, scene.camera.field, calibration.photometry.k, cuts)


@pytest.fixture(scope="module")
def wet():
    """Give a frame with highlights, and the mask of those that are found."""
    sample = el.load_traced("wet-1")
    return sample, el.prepare(sample.frame, sample.calibration).highlights


def once(walls, a):
    return (walls.exchange @ (a * walls.lit)).sum() / walls.bounced(a).sum()


def test_the_light_that_bounced_once(walls):
    told = light.exercise_1(once, walls)
    assert told
    assert f"{once(walls, 0.75):.0%} at 0.75" in told.said


@pytest.mark.parametrize(
    ("slip", "said"),
    [
        (lambda w, a: 100 * once(w, a), "per cent"),
        (lambda w, a: 1 / once(w, a), "turn it round"),
        (lambda w, a: once(w, a) / a, "where is the albedo"),
        (lambda w, a: a * w.lit.sum() / w.bounced(a).sum(), "let `walls.exchange` hand it on"),
        (lambda w, a: (w.exchange @ w.exchange @ w.lit).sum() * a**2 / w.bounced(a).sum(), "twice"),
        (lambda w, a: (w.exchange @ w.lit).sum() * a / (w.lit + w.bounced(a)).sum(), "has not bounced"),
        (lambda w, a: 1 - once(w, a), "the rest"),
        (lambda w, a: (a * w.lit @ w.exchange).sum() / w.bounced(a).sum(), "stands before the light"),
        (lambda w, a: w.exchange @ (a * w.lit), "One number"),
        (lambda w, a: 0.5, "Yours says 0.50 at an albedo of 0.1"),
    ],
)
def test_each_slip_about_bounces_is_named(walls, slip, said):
    told = light.exercise_1(slip, walls)
    assert told.right is False
    assert said in told.said


def counted(sample, found, rest):
    mirrored = sample.mirrored > 0.2 * rest
    both = (mirrored & found).sum()
    return both / mirrored.sum(), both / found.sum()


def test_how_good_the_mask_is(wet):
    sample, found = wet
    rest = (sample.direct + sample.indirect)[..., 1]
    mirrored, right = sample.mirrored > 0.2 * rest, counted(sample, found, rest)
    assert light.exercise_2(right, sample, found)
    slips = {
        "per cent": (100 * right[0], 100 * right[1]),
        "wrong way round": right[::-1],
        "light that bounced": counted(sample, found, sample.direct[..., 1]),
        "no part": counted(sample, found, rest + sample.mirrored),
        "whole picture": 2 * ((mirrored & found).mean(),),
        "leave dark": 2 * ((mirrored == found).mean(),),
        "You gave 3": (1, 2, 3),
        "the mirrored is too large": (right[0] + 0.05, right[1]),
        "the found is too small": (right[0], right[1] - 0.05),
    }
    for said, wrong in slips.items():
        told = light.exercise_2(wrong, sample, found)
        assert told.right is False
        assert said in told.said


def unwritten(walls, a):
    raise NotImplementedError


def test_no_answer_is_none_yet(walls, wet):
    for told in (light.exercise_1(unwritten, walls), light.exercise_2(..., *wet)):
        assert (told.right, told.said) == (None, MISSING)
