"""Lamps where they are: beside the lens they cost nothing more, once they are listed and there are mm."""

import re
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import endolab as el
from endolab.numerics.iteration import finish
from endolab.reconstruction.lamps import Lamps, divide_by_lamps
from endolab.reconstruction.pipeline import find
from endolab.reconstruction.prior_sigma import PriorSigma
from endolab.reconstruction.report import meaning, warnings
from endolab.reconstruction.settings import Settings
from tests.tools.cases import drawn
from tests.tools.problems import errors_of, percent_off, problem_of, relit

ONE = ((6.0, 0.0, 0.0),)
ONE_SIDE = ((4.0, 2.0, 0.0), (-1.0, 4.0, 0.0))


def lit(scene="tube", lamps=ONE, width=240):
    """A scene that lamps at these places light."""
    light = el.load_calibration("paper").photometry.with_lamps(lamps)
    return drawn(scene, "paper", width, light, noise=1, bits=8)


@pytest.mark.parametrize(
    ("scene", "lamps", "options", "percent"),
    [
        ("curved", ONE, {}, 0.4),  # 7.0 by one lamp at the centre
        ("tube", ONE, {}, 1.2),  # 17.2
        ("tube", ((3.0, 0.0, 0.0), (-3.0, 0.0, 0.0)), {}, 0.6),  # 1.8
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
    shot = lit(scene, lamps)
    result = shot.solve(**options)
    assert percent_off(result, shot, result.mask) < percent
    assert el.explained_contrast(result) > 0.97  # beside cuts, too
    sentences = " ".join(meaning(result))
    assert all(f"({x:g}, {y:g}, {z:g})" in sentences for x, y, z in lamps)


def test_without_millimetres_the_lamps_are_left_out_and_that_is_said():
    shot = lit()
    relative = shot.relit(gain=None)
    silent = relative.solve()
    assert any("6 mm aside" in text for text in warnings(silent))
    assert silent.problem.lamp_ratio is None
    length = float(np.median(shot.distance[silent.mask]))
    result = relative.solve(median_distance=length)
    assert not any("aside" in text for text in warnings(result))
    assert percent_off(result, shot, result.mask) < 2


def test_an_endoscope_whose_usual_distance_is_known_needs_no_length():
    shot = lit()
    usual = float(np.nanmedian(shot.distance))
    for off in (0.7, 1.0, 1.3):
        stated = {"photometry": {"usual_distance": off * usual}}
        relative = relit(replace(shot.calibration, evidence=stated), gain=None)
        result = el.reconstruct(shot.frame, relative)
        assert not result.metric
        assert errors_of(result, shot, align="scale").mean_percent < 8.5  # of 17


def test_lamps_that_are_listed_at_the_centre_change_no_bit():
    shot = drawn("tube", "paper", 160, noise=1, bits=8)
    k = shot.calibration.photometry.k - 1
    listed = shot.relit(k=k, lights=(el.SpotLight(exponent=1.0),))
    assert_array_equal(listed.solve().distance, shot.solve().distance)


def test_what_was_found_follows_when_lamps_move():
    shot = lit()
    known = shot.calibration
    centred = replace(known, photometry=known.photometry.simplify())
    found = finish(find(shot.frame, centred, Settings()))
    before, moved = (el.solve_found(found, one) for one in (centred, known))
    assert percent_off(moved, shot, moved.mask) < 4
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
    shot = lit(width=160)
    how = {"channel": "green", "contours": False}
    found = finish(find(shot.frame, shot.calibration, Settings(**how)))
    other = shot.relit(**now)
    again = el.solve_found(found, other.calibration, **options)
    anew = other.solve(**how, **options)
    assert errors_of(again, anew, align="scale").mean_percent < 1.2
    assert [*warnings(again)] == [*warnings(anew)]
    assert again.report.lamps == anew.report.lamps


def test_a_start_keeps_the_lamps_and_takes_others():
    shot = lit(width=160)
    first = shot.solve()
    finer = shot.solve(start=first, lam=0.5)
    assert_array_equal(finer.problem.lamp_ratio, first.problem.lamp_ratio)
    lamps = shot.calibration.photometry.with_lamps(((-6.0, 0.0),))
    other = shot.relit(lights=lamps.lights).solve(start=first)
    right, left = (one.problem.lamp_ratio for one in (first, other))
    assert np.corrcoef(right[first.mask], left[first.mask])[0, 1] < 0


def test_the_divided_picture_is_what_one_lamp_at_the_centre_makes():
    problem, seen = problem_of("curved", 80)
    lamps = problem.photometry.with_lamps(ONE_SIDE)
    lit = el.render(el.SCENES["curved"], problem.camera, lamps)
    ratio = Lamps(lamps, Settings()).ratio(
        el.Iterate.of(problem, np.log(seen.distance))
    )
    inside = problem.mask
    divided = divide_by_lamps(replace(problem, image=lit.image), ratio).image
    assert np.max(np.abs(divided / problem.image - 1)[inside]) < 0.02
    assert np.ptp(lit.image[inside] / problem.image[inside]) > 0.1


def test_the_place_that_a_calibration_found_is_as_uncertain_as_it_says():
    known = lit(width=120).calibration
    errors = {f"lamp {lamp} {axis}": 0.3 for lamp in (1, 2) for axis in "xy"}
    stated = {"photometry": {"standard_errors": errors}}
    assert PriorSigma.of(replace(known, evidence=stated)).lamp == pytest.approx(
        0.3 / np.sqrt(2)  # of the mean of two
    )
    by_hand = replace(known, evidence=stated | {"lamps": "given"})
    assert PriorSigma.of(by_hand).lamp == PriorSigma().lamp


def test_a_start_in_another_unit_keeps_no_light_of_the_lamps():
    """Three times as far away, ω was hardly any, and stayed: 11.1 % instead of 1.4."""
    shot = lit(width=80)
    solve = shot.relit(gain=None).solve
    median = float(np.nanmedian(shot.distance))
    far = solve(median_distance=3 * median)
    again = solve(median_distance=median, start=far)
    assert_array_equal(again.distance, solve(median_distance=median).distance)
