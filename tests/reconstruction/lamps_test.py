"""Lamps where they are: beside the lens they cost nothing more, once they are listed and there are mm."""

import re
from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab.io.found import load_found, save_found
from endolab.metrics.contrast import explained_contrast
from endolab.model.lights import SpotLight
from endolab.numerics.iteration import finish
from endolab.reconstruction.lamps import Lamps, divide_by_lamps
from endolab.reconstruction.pipeline import find
from endolab.reconstruction.prior_sigma import PriorSigma
from endolab.reconstruction.report import meaning, warnings
from endolab.reconstruction.settings import Settings
from endolab.synthetic.scenes import SCENES
from tests.tools.problems import percent_off, problem_of, relit

ONE = ((6.0, 0.0, 0.0),)
PAIR = ((3.0, 0.0, 0.0), (-3.0, 0.0, 0.0))
ONE_SIDE = ((4.0, 2.0, 0.0), (-1.0, 4.0, 0.0))


def seen_by(scene, lamps, width=240):
    """A scene that lamps at these places light, as a frame, its calibration and its truth."""
    paper = el.load_calibration("paper", width)
    light = paper.photometry.with_lamps(lamps) if lamps else paper.photometry
    seen = el.render(SCENES[scene], paper.camera, light, noise=1, bits=8)
    return (
        el.Frame(seen.image, seen.mask),
        el.Calibration(seen.camera, seen.photometry),
        seen,
    )


@pytest.mark.parametrize(
    ("scene", "lamps", "options", "percent"),
    [
        ("curved", ONE, {}, 0.4),  # 7.0 by one lamp at the centre
        ("tube", ONE, {}, 1.2),  # 17.2
        ("tube", PAIR, {}, 0.6),  # 1.8
        ("colon", ONE, {}, 6.2),  # 19.0; 5.3 where the lamp is at the centre
        ("colon", ONE_SIDE, {}, 6.2),  # 9.6
        ("tube", ONE, {"channel": "green"}, 1.3),
        ("tube", ONE, {"solver": "fast_marching"}, 3.5),
        (
            "curved",
            ONE,
            {"solver": "primal_dual", "lam": 0.1, "max_iterations": 200},
            0.4,
        ),
    ],
)
def test_the_error_is_that_of_a_lamp_at_the_centre(scene, lamps, options, percent):
    frame, known, seen = seen_by(scene, lamps)
    result = el.reconstruct(frame, known, **options)
    assert percent_off(result, seen, result.mask) < percent
    assert explained_contrast(result) > 0.97  # beside cuts, too
    sentences = " ".join(meaning(result))
    assert all(f"({x:g}, {y:g}, {z:g})" in sentences for x, y, z in lamps)


def test_without_millimetres_the_lamps_are_left_out_and_that_is_said():
    frame, known, seen = seen_by("tube", ONE)
    relative = relit(known, gain=None)
    silent = el.reconstruct(frame, relative)
    assert any("6 mm aside" in text for text in warnings(silent))
    assert silent.problem.lamp_ratio is None
    length = float(np.median(seen.distance[silent.mask]))
    result = el.reconstruct(frame, relative, median_distance=length)
    assert not any("aside" in text for text in warnings(result))
    assert percent_off(result, seen, result.mask) < 2


def test_an_endoscope_whose_usual_distance_is_known_needs_no_length():
    frame, known, seen = seen_by("tube", ONE)
    usual = float(np.median(seen.distance[seen.mask]))
    errors = []
    for off in (0.7, 1.0, 1.3):
        stated = {"photometry": {"usual_distance": off * usual}}
        result = el.reconstruct(
            frame, replace(relit(known, gain=None), evidence=stated)
        )
        assert not result.metric
        shape = result.distance / seen.distance
        errors.append(100 * np.nanmean(np.abs(shape / np.nanmedian(shape) - 1)))
    assert max(errors) < 8.5  # of 17


def test_lamps_that_are_listed_at_the_centre_change_no_bit():
    frame, known, _ = seen_by("tube", (), 160)
    light = known.photometry
    listed = relit(known, k=light.k - 1, lights=(SpotLight(exponent=1.0),))
    one, other = (el.reconstruct(frame, endoscope) for endoscope in (known, listed))
    assert np.array_equal(one.distance, other.distance, equal_nan=True)


def test_what_was_found_has_the_lamps_to_the_bit_and_follows_when_they_move(tmp_path):
    frame, known, seen = seen_by("tube", ONE)
    found = finish(find(frame, known, Settings()))
    save_found(found, tmp_path / "found.npz")
    whole = el.reconstruct(frame, known)
    again = el.solve_found(load_found(tmp_path / "found.npz"), known)
    assert np.array_equal(again.distance, whole.distance, equal_nan=True)
    centred = relit(known, **vars(known.photometry.simplify()))
    found = finish(find(frame, centred, Settings()))
    before, moved = (el.solve_found(found, one) for one in (centred, known))
    assert percent_off(moved, seen, moved.mask) < 4
    (sentence,) = (text for text in meaning(moved) if "(6, 0, 0)" in text)
    change = 100 * np.nanmean(np.abs(moved.distance / before.distance - 1))
    assert float(re.search(r"by (\S+) % in the mean", sentence)[1]) == pytest.approx(
        change, rel=0.3
    )


@pytest.mark.parametrize(
    ("now", "options"),
    [
        ({"gamma": 1.7}, {}),
        ({"lights": ()}, {}),
        ({"gain": None}, {}),
        ({"gain": None}, {"median_distance": 100.0}),
    ],
)
def test_what_was_found_is_solved_as_if_anew_once_light_or_unit_are_others(
    now, options
):
    frame, known, _ = seen_by("tube", ONE, 160)
    how = {"channel": "green", "contours": False}
    found = finish(find(frame, known, Settings(**how)))
    other = relit(known, **now)
    again = el.solve_found(found, other, **options)
    anew = el.reconstruct(frame, other, **how, **options)
    apart = again.distance / anew.distance
    assert np.nanmean(np.abs(apart / np.nanmedian(apart) - 1)) < 0.012
    assert [*warnings(again)] == [*warnings(anew)]
    assert again.report.lamps == anew.report.lamps


def test_a_start_keeps_the_lamps_and_takes_others():
    frame, known, _ = seen_by("tube", ONE, 160)
    first = el.reconstruct(frame, known)
    finer = el.reconstruct(frame, known, start=first, lam=0.5)
    assert np.array_equal(finer.problem.lamp_ratio, first.problem.lamp_ratio)
    lamps = known.photometry.with_lamps(((-6.0, 0.0),))
    other = el.reconstruct(frame, relit(known, lights=lamps.lights), start=first)
    right, left = (one.problem.lamp_ratio for one in (first, other))
    assert np.corrcoef(right[first.mask], left[first.mask])[0, 1] < 0


def test_the_divided_picture_is_what_one_lamp_at_the_centre_makes():
    problem, seen = problem_of("curved", 80)
    lamps = problem.photometry.with_lamps(ONE_SIDE)
    lit = el.render(SCENES["curved"], problem.camera, lamps)
    ratio = Lamps(lamps, Settings()).ratio(
        el.Iterate.of(problem, np.log(seen.distance))
    )
    inside = problem.mask
    divided = divide_by_lamps(replace(problem, image=lit.image), ratio).image
    assert np.max(np.abs(divided / problem.image - 1)[inside]) < 0.02
    assert np.ptp(lit.image[inside] / problem.image[inside]) > 0.1


def test_the_place_that_a_calibration_found_is_as_uncertain_as_it_says():
    _, known, _ = seen_by("tube", ONE, 120)
    errors = {f"lamp {lamp} {axis}": 0.3 for lamp in (1, 2) for axis in "xy"}
    stated = {"photometry": {"standard_errors": errors}}
    assert PriorSigma.of(replace(known, evidence=stated)).lamp == pytest.approx(
        0.3 / np.sqrt(2)  # of the mean of two
    )
    by_hand = replace(known, evidence=stated | {"lamps": "given"})
    assert PriorSigma.of(by_hand).lamp == PriorSigma().lamp


def test_a_start_in_another_unit_keeps_no_light_of_the_lamps():
    """Three times as far away, ω was hardly any, and stayed: 11.1 % instead of 1.4."""
    frame, known, seen = seen_by("tube", ONE, 80)
    known = relit(known, gain=None)
    median = float(np.median(seen.distance[seen.mask]))
    far = el.reconstruct(frame, known, median_distance=3 * median)
    again = el.reconstruct(frame, known, median_distance=median, start=far)
    anew = el.reconstruct(frame, known, median_distance=median)
    np.testing.assert_array_equal(again.distance, anew.distance)
