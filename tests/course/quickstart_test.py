"""Exercises of notebook 00: right answers pass, and each mistake is told from the others."""

from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab.course import quickstart as check


@pytest.fixture(scope="module")
def seen():
    """A small frame of the colon."""
    calibration = el.load_calibration("paper", width=120)
    return el.render(el.SCENES["colon"], calibration.camera, calibration.photometry, bits=8, noise=1.0)


@pytest.fixture(scope="module")
def solve(seen):
    """Reconstruct it, with or without its gain."""

    def solved(gain=seen.photometry.gain, **how):
        known = el.Calibration(seen.camera, replace(seen.photometry, gain=gain))
        return el.reconstruct(el.Frame(seen.image, seen.mask), known, **how)

    return solved


@pytest.fixture(scope="module")
def result(solve):
    """With the gain."""
    return solve()


@pytest.fixture(scope="module")
def free(solve):
    """Without it."""
    return solve(None)


@pytest.fixture(scope="module")
def by_channel(solve):
    """A result for each colour."""
    return {name: solve(channel=name) for name in check.COLOURS}


def factor_of(free, result):
    return np.nanmedian(result.distance) / np.nanmedian(free.distance)


def test_the_number_that_brings_mm_back_is_right(free, result):
    assert check.exercise_1(free, factor_of(free, result), result)


def test_nothing_is_no_answer(free, result, by_channel, seen):
    assert check.exercise_1(free, ..., result).right is None
    assert check.exercise_2(by_channel, ..., ..., seen).right is None


@pytest.mark.parametrize(
    ("mistake", "said"),
    [
        (lambda right, free, result: 1 / right, "the way back"),
        (lambda right, free, result: right**2, "its square"),
        (lambda right, free, result: right**0.5, "its root"),
        (lambda right, free, result: np.nanmedian(result.distance), "of `result`"),
        (lambda right, free, result: np.nanmedian(free.distance), "of `free` itself"),
        (lambda right, free, result: 3 * right, "With it the median becomes"),
    ],
)
def test_a_wrong_number_is_told_by_what_it_is(free, result, mistake, said):
    told = check.exercise_1(free, mistake(factor_of(free, result), free, result), result)
    assert told.right is False
    assert said in told.said


def test_a_result_of_another_kind_is_told(free, result, solve):
    for answer, said in (
        (result, "still in mm"),
        (solve(None, median_distance=30.0), "still in mm"),
        (solve(None, width=100), "not as large"),
        (free.distance, "ndarray"),
    ):
        told = check.exercise_1(answer, factor_of(free, result), result)
        assert told.right is False
        assert said in told.said


def test_the_bright_colour_is_best_and_the_one_that_the_wall_swallows_in_tissue(by_channel, seen):
    off = {name: np.nanmedian(np.abs(one.distance / seen.distance - 1)) for name, one in by_channel.items()}
    order = sorted(off, key=off.get)
    assert check.exercise_2(by_channel, order[0], "blue", seen)
    for best, tissue, said in (
        (order[2], "blue", "Best is what errs least"),
        (order[0], "red", "more than of any other"),
        (order[0], "green", "less?"),
        (order[0], "grey", "one of red, green and blue"),
    ):
        told = check.exercise_2(by_channel, best, tissue, seen)
        assert told.right is False
        assert said in told.said


def test_results_must_be_those_of_the_channels_that_they_are_named_after(by_channel, seen):
    for answer, said in (
        (by_channel | {"red": by_channel["blue"]}, "What is named red was solved from 'blue'"),
        (by_channel | {"red": by_channel["red"].distance}, "ndarray"),
        ({"red": by_channel["red"]}, "three results"),
        (by_channel["red"], "three results"),
    ):
        told = check.exercise_2(answer, "red", "blue", seen)
        assert told.right is False
        assert said in told.said
