"""The checks of notebook 10: the right answer passes, and each mistake hears what it is."""

import numpy as np
import pytest

import endolab as el
from endolab.course import trust_lessons
from endolab.course.verdict import MISSING


@pytest.fixture(scope="module")
def tube():
    """Give a frame, a part of the picture left out, and its calibration."""
    calibration = el.load_calibration("simple", 60)
    view = el.render(el.SCENES["tube"], calibration.camera, calibration.photometry)
    mask = view.mask.copy()
    mask[:5] = False
    return el.Frame(view.image, mask), el.Calibration(view.camera, view.photometry)


@pytest.fixture(scope="module")
def touched(tube):
    """Give a trust and its result."""
    result = el.reconstruct(*tube)
    return el.trust_of(result, draws=4), result


@pytest.fixture(scope="module")
def noisy():
    """Give a frame with noise, its calibration and its true distance."""
    calibration = el.load_calibration("paper", 80)
    shot = el.render(el.SCENES["tube"], calibration.camera, calibration.photometry, noise=4, bits=8)
    return el.Frame(shot.image, shot.mask), el.Calibration(shot.camera, shot.photometry), shot.distance


def test_what_one_known_distance_is_worth(touched):
    trust, result = touched
    shape = np.where(result.mask, trust.sigma_shape, np.nan)
    share = shape / result.distance
    one, other = np.nanmin(share), np.nanmax(share)
    told = trust_lessons.exercise_1((one, other), *touched)
    assert told
    assert f"{one:.1%} by the surest" in told.said
    at = [np.nanargmin(share), np.nanargmax(share)]
    in_mm = [np.nanargmin(shape), np.nanargmax(shape)]
    slips = {
        "per cent": (100 * one, 100 * other),
        "Those are mm": shape.ravel()[at],
        "wrong way round": (other, one),
        "scale by the gain": (trust.sigma_scale, trust.sigma_scale),
        "At all others": (0, 0),
        "You add": np.hypot((one, other), trust.sigma_scale),
        "That is `sigma`": (trust.sigma / result.distance).ravel()[at],
        "by their mm": share.ravel()[in_mm],
        "nan": (np.nan, other),
        "the first is too large": (1.5 * one, other),
        "the second is too small": (one, 0.7 * other),
        "You gave 1": one,
    }
    for said, wrong in slips.items():
        told = trust_lessons.exercise_1(wrong, *touched)
        assert told.right is False
        assert said in told.said


def test_what_the_first_exercise_promises_is_kept(tube, touched):
    trust, result = touched
    share = np.where(result.mask, trust.sigma_shape / result.distance, np.nan)
    row, column = np.unravel_index(np.nanargmax(share), share.shape)
    known = (float(result.distance[row, column]), float(column), float(row))
    again = el.trust_of(el.reconstruct(*tube, known_distance=known), draws=4)
    assert again.sigma_scale == pytest.approx(share[row, column], rel=trust_lessons.CLOSE)


def test_which_lam_noise_calls_for(noisy):
    frame, known, true = noisy
    runs = [el.reconstruct(frame, known, channel="green", lam=lam) for lam in (1.0, "auto")]
    assert runs[1].problem.lam > 1

    def each(measure):
        return [measure(run.distance) for run in runs]

    one, other = each(lambda d: 100 * np.nanmean(np.abs(d / true - 1)))
    told = trust_lessons.exercise_2("more", (one, other), *noisy)
    assert told
    assert f"from {one:.1f} % to {other:.1f} %" in told.said
    slips = {
        "yours are shares": (one / 100, other / 100),
        "wrong way round": (other, one),
        "cancel": each(lambda d: 100 * np.nanmean(d / true - 1)),
        "median": each(lambda d: 100 * np.nanmedian(np.abs(d / true - 1))),
        "squares": each(lambda d: 100 * np.sqrt(np.nanmean((d / true - 1) ** 2))),
        "largest": each(lambda d: 100 * np.nanmax(np.abs(d / true - 1))),
        "mm": each(lambda d: np.nanmean(np.abs(d - true))),
        "is `lam` given": (one, one),
        "with λ = 1. Is": (2 * one, other),
        "with the chosen λ": (one, 2 * other),
        "You gave 3": (one, other, 1),
    }
    for said, wrong in slips.items():
        told = trust_lessons.exercise_2("more", wrong, *noisy)
        assert told.right is False
        assert said in told.said
    assert "the prediction is not" in trust_lessons.exercise_2("less", (one, other), *noisy).said
    assert "not 'larger'" in trust_lessons.exercise_2("larger", (one, other), *noisy).said


def test_no_answer_is_none_yet():
    for told in (trust_lessons.exercise_1(..., None, None), trust_lessons.exercise_2("more", ..., 0, 0, 0)):
        assert (told.right, told.said) == (None, MISSING)
