"""The checks of notebook 08: the right answer passes, and each mistake hears what it is."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import endolab as el
from endolab.course import real_frame
from endolab.course.verdict import MISSING

HOW = {"channel": "green", "width": 160}


@pytest.fixture(scope="module")
def wet():
    """Give a frame with highlights, and its calibration, with a gain that is not known."""
    sample = el.load_traced("wet-2")
    calibration = sample.calibration
    return sample.frame, replace(calibration, photometry=replace(calibration.photometry, gain=None))


@pytest.fixture(scope="module")
def surfaces(wet):
    """Give the three surfaces of the first exercise."""
    ways = ("keep", "ignore", "inpaint")
    return {way: el.reconstruct(*wet, highlights=way, median_distance=40, **HOW).distance for way in ways}


def each(surfaces, measure):
    return tuple(measure(surfaces[way], surfaces["inpaint"]) for way in ("keep", "ignore"))


def mean_share(one, other):
    return np.nanmean(np.abs(one / other - 1))


def test_how_much_highlights_matter(wet, surfaces):
    keep, ignore = each(surfaces, mean_share)
    told = real_frame.exercise_1((keep, ignore), *wet)
    assert told
    assert f"{keep:.2%}" in told.said
    unlike = mean_share(surfaces["keep"], surfaces["ignore"])
    slips = {
        "per cent": (100 * keep, 100 * ignore),
        "cancel": each(surfaces, lambda one, other: np.nanmean(one / other - 1)),
        "mm": each(surfaces, lambda one, other: np.nanmean(np.abs(one - other))),
        "squares": each(surfaces, lambda one, other: np.sqrt(np.nanmean((one / other - 1) ** 2))),
        "largest": each(surfaces, lambda one, other: np.nanmax(np.abs(one / other - 1))),
        "nan": each(surfaces, lambda one, other: np.mean(np.abs(one / other - 1))),
        "wrong way round": (ignore, keep),
        "each with `inpaint`": (unlike, ignore),
        "`keep` is wrong": (2 * keep, ignore),
        "`ignore` is wrong": (keep, 2 * ignore),
        "You gave 3": (keep, ignore, 0),
    }
    for said, wrong in slips.items():
        told = real_frame.exercise_1(wrong, *wet)
        assert told.right is False
        assert said in told.said


def test_what_a_larger_gamma_does(wet):
    frame, calibration = wet

    @cache
    def with_gamma(gamma):
        photometry = replace(calibration.photometry, gamma=gamma)
        return el.reconstruct(frame, replace(calibration, photometry=photometry), **HOW)

    def ratio(gamma):
        near, far = np.nanpercentile(with_gamma(gamma).distance, [5, 95])
        return far / near

    one, other = ratio(2.2), ratio(1.1 * 2.2)
    extremes = with_gamma(2.2).distance
    told = real_frame.exercise_2((one, one**1.1, other), with_gamma, 2.2)
    assert told
    assert f"measured {other / one - 1:+.0%}" in told.said
    slips = {
        "turn it round": (1 / one, one**1.1, other),
        "the extremes": (np.nanmax(extremes) / np.nanmin(extremes), one**1.1, other),
        "another one than 9": (9, one**1.1, other),
        "in an exponent": (one, 1.1 * one, other),
        "goes the wrong way": (one, one ** (1 / 1.1), other),
        "already in the first ratio": (one, one**0.55, other),
        "Not yet: the prediction": (one, 2 * one, other),
        "was γ changed": (one, one**1.1, one),
        "a smaller γ": (one, one**1.1, ratio(2.0)),
        "measured with γ = 2.42": (one, one**1.1, 2 * other),
        "You gave 2": (one, other),
    }
    for said, wrong in slips.items():
        told = real_frame.exercise_2(wrong, with_gamma, 2.2)
        assert told.right is False
        assert said in told.said


def test_no_answer_is_none_yet(wet):
    for told in (real_frame.exercise_1(..., *wet), real_frame.exercise_2(..., None, 2.2)):
        assert (told.right, told.said) == (None, MISSING)
