"""Scale and meaning: one known length fixes all, and the sentences' figures are true."""

import re
from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab import plots
from endolab.depth.energy import energy_terms
from endolab.depth.problem import AT_LEAST, NONE, Origin
from endolab.reconstruction.assumptions import meaning
from endolab.reconstruction.scale import (
    check_scale,
    factor_of_diameter,
    factor_of_distance,
    rescaled,
    scale_of,
    with_known_length,
)
from tests.tools.problems import Shot

CAMERA = el.Pinhole(200, 150, 110.0, 110.0, 99.5, 74.5)
ONE, OTHER = (41, 50), (150, 109)  # column, row


@pytest.fixture(scope="module")
def shot():
    """A noisy bowl, and the calibration that explains it."""
    calibration = el.Calibration(CAMERA, el.Photometry(brdf=el.Lambertian(0.4)))
    return Shot("curved", calibration, noise=1.0, seed=3)


def solve(shot, **options):
    return el.reconstruct(shot.frame, shot.up_to_scale, **options)


@pytest.fixture(scope="module")
def relative(shot):
    return solve(shot)


@pytest.fixture(scope="module")
def known(shot):
    return shot.reconstruct()


def posed(result, **changes):
    """A result whose problem differs."""
    return replace(result, iterate=replace(result.iterate, problem=replace(result.problem, **changes)))


def point(shot, pixel):
    return shot.truth.distance[pixel[::-1]] * CAMERA.field.rays[pixel[::-1]]


def said(result, word):
    """The one sentence with that word."""
    (sentence,) = [each for each in meaning(result) if word in each]
    assert sentence.endswith(".")
    assert "  " not in sentence
    return sentence


@pytest.mark.parametrize("width", [None, 100, 67])
def test_one_length_gives_the_true_size(shot, width):
    """Within what noise does to five pixels; the pixel is one of the whole picture, though it was shrunk."""
    result = solve(shot, width=width)
    size = (CAMERA.width, CAMERA.height)
    distance = float(np.linalg.norm(point(shot, ONE)))
    diameter = float(np.linalg.norm(point(shot, ONE) - point(shot, OTHER)))
    by_distance = factor_of_distance(result, distance, *ONE, size=size)
    for factor in (by_distance, factor_of_diameter(result, diameter, ONE, OTHER, size=size)):
        whole = rescaled(result, factor)
        assert whole.metric
        true = np.median(shot.truth.distance[shot.truth.mask])
        assert np.median(whole.distance[whole.mask]) == pytest.approx(true, rel=0.015)


def test_the_problem_knows_the_size_of_the_picture(shot):
    result = solve(shot, width=100)
    assert result.problem.origin.picture_size == (200, 150)
    assert factor_of_distance(result, 30, *ONE) == factor_of_distance(result, 30, *ONE, size=(200, 150))
    assert factor_of_distance(result, 30, *ONE) != factor_of_distance(result, 30, *ONE, size=(100, 75))


def test_one_odd_pixel_does_not_fix_the_scale(relative):
    odd = relative.iterate.log_distance.copy()
    odd[ONE[::-1]] += 1.0
    wrong = replace(relative, iterate=replace(relative.iterate, log_distance=odd))
    expected = factor_of_distance(relative, 30, *ONE)
    assert factor_of_distance(wrong, 30, *ONE) == pytest.approx(expected, rel=0.01)


def test_the_result_is_the_same_surface_in_another_unit(relative):
    whole = with_known_length(relative, known_distance=(30.0, *ONE))
    factor = factor_of_distance(relative, 30.0, *ONE)
    np.testing.assert_allclose(whole.distance, factor * relative.distance)
    np.testing.assert_allclose(whole.normals, relative.normals, atol=1e-9)
    assert not whole.distance.flags.writeable
    terms = energy_terms(whole.problem, whole.iterate.log_distance)
    assert sum(terms.values()) == pytest.approx(relative.energy, rel=1e-9)
    assert relative.problem.origin.scale is None
    assert with_known_length(relative) is relative
    np.testing.assert_allclose(rescaled(whole, 1 / factor, False).distance, relative.distance)


def test_a_length_that_is_known_solves_nothing_twice(shot, relative):
    seen = []
    whole = solve(shot, known_distance=(30.0, *ONE), observers=[seen.append])
    stages = [step.stage for step in seen if step.stage not in ("smooth", "vote")]  # of a grey picture
    assert stages == ["solution"] * len(relative.history) + ["scaled"]
    assert seen[-1] is whole.iterate
    assert [row["energy"] for row in whole.history] == [row["energy"] for row in relative.history]
    factor = factor_of_distance(relative, 30.0, *ONE)
    np.testing.assert_allclose(whole.distance, factor * relative.distance, rtol=1e-12)
    gains = [result.problem.photometry.gain for result in (whole, relative)]
    assert gains[0] == pytest.approx(factor**2 * gains[1])


@pytest.mark.parametrize(
    ("pixel", "message"),
    [
        ((200, 20), "the pixel at column 200, row 20 is outside the picture of 200x150 px"),
        ((20, -1), "the pixel at column 20, row -1 is outside the picture of 200x150 px"),
        ((20, 20), "the pixel at column 20, row 20 is outside the mask, where no distance is known"),
    ],
)
def test_a_pixel_without_a_distance_is_refused(relative, pixel, message):
    hole = relative.mask.copy()
    hole[10:30, 10:30] = False
    result = posed(relative, mask=hole)
    with pytest.raises(ValueError, match=message):
        factor_of_distance(result, 30, *pixel)
    with pytest.raises(ValueError, match=message):
        factor_of_diameter(result, 30, ONE, pixel)


def test_two_pixels_that_are_one_are_refused(relative):
    with pytest.raises(ValueError, match=r"are 3\.2 px apart in the depth map, too near"):
        factor_of_diameter(relative, 4, ONE, (ONE[0] + 3, ONE[1] + 1))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"median_distance": 3, "known_distance": (3, 1, 2)}, "median_distance and known_distance exclude"),
        ({"known_distance": (0, 1, 2)}, r"_distance must be positive and finite \(mm\), got \(0, 1, 2\)"),
        ({"known_distance": (3, np.nan, 2)}, "known_distance must be positive and finite"),
        ({"known_distance": 3}, r"known_distance must be \(mm, column, row\), got 3"),
        ({"known_distance": "near"}, "known_distance must be .mm, column, row., got near"),
        ({"known_diameter": (3, 1, 2, 3, 4)}, r"known_diameter must be \(mm, \(column, row\), \(column"),
        ({"known_diameter": (3, (1, 2), (3,))}, "known_diameter must be"),
        ({"known_diameter": (-3, (1, 2), (3, 4))}, "known_diameter must be positive"),
        ({"median_distance": np.inf}, "median_distance must be positive and finite"),
        ({"median_distance": 1e300}, r"median_distance must lie in \[0.001, 1e\+06\] mm, got 1e\+300"),
        ({"known_diameter": (1e-320, (1, 2), (3, 4))}, "known_diameter must lie in"),
    ],
)
def test_a_bad_length_is_refused(given, message):
    with pytest.raises(ValueError, match=message):
        check_scale(**given)


@pytest.mark.parametrize("factor", [0.0, -1.0, np.nan, np.inf])
def test_a_bad_factor_is_refused(relative, factor):
    with pytest.raises(ValueError, match="factor must be positive and finite"):
        rescaled(relative, factor)


def test_a_good_length_passes():
    check_scale()
    check_scale(known_diameter=[3, [1, 2], [3, 4]])
    check_scale(known_distance=np.array([3, 1, 2]))


def test_the_first_frames_length_is_that_of_all(shot):
    frames = [(name, light * shot.frame.image) for name, light in (("a", 1.0), ("b", 0.9), ("c", 0.95))]
    length = (30.0, *ONE)
    steps = list(el.reconstruct_sequence(frames, shot.up_to_scale, known_distance=length))
    results = [step.result for step in steps]
    assert [scale_of(result) for result in results] == ["known distance", "frame before", "frame before"]
    for result in results:
        assert result.metric
        assert 1 / factor_of_distance(result, 1.0, *ONE) == pytest.approx(30, rel=0.05)
    assert "carried over from the frame before" in meaning(results[1])[0]
    plain = [step.result for step in el.reconstruct_sequence(frames[:2], shot.up_to_scale)]
    assert [scale_of(result) for result in plain] == ["none", "frame before"]
    assert "nearly that of the frame before" in meaning(plain[1])[0]


def test_a_length_in_a_broken_first_frame_is_not_taken_for_another_frames(shot):
    frames = [("a", None), ("b", shot.frame.image)]
    with pytest.raises(ValueError, match="a: cannot be read"):
        list(el.reconstruct_sequence(frames, shot.up_to_scale, known_distance=(30.0, *ONE)))


def test_how_the_scale_was_fixed_is_said(shot, relative, known):
    assert scale_of(relative) == scale_of(relative.iterate) == "none"
    assert meaning(relative.iterate) == meaning(relative)
    assert scale_of(known) == "gain"
    assert "the gain of the endoscope is known" in meaning(known)[0]
    assert "their unit is arbitrary" in meaning(relative)[0]
    middle = solve(shot, median_distance=33.0)
    assert scale_of(middle) == "median distance"
    assert "said to be 33 mm" in meaning(middle)[0]
    near = with_known_length(relative, known_distance=(30.0, *ONE))
    assert "column 41, row 50 was said to be 30 mm away" in meaning(near)[0]
    wide = with_known_length(relative, known_diameter=(12.5, ONE, OTHER))
    assert "column 41, row 50 and column 150, row 109 were said to be 12.5 mm apart" in meaning(wide)[0]
    assert (scale_of(near), scale_of(wide)) == ("known distance", "known diameter")
    assert not any("By the gain" in each for each in meaning(near))


def test_a_gain_that_says_another_length_is_not_kept_quiet(shot, known):
    true = float(shot.truth.distance[ONE[::-1]])
    result = with_known_length(known, known_distance=(1.5 * true, *ONE))
    mm = float(re.search(r"would be ([\d.]+) mm", said(result, "By the gain")).group(1))
    assert mm == pytest.approx(true, rel=0.02)


def test_ten_percent_of_albedo_is_five_of_every_distance(shot, known):
    """The sentence, checked by solving with a wall that is taken to be darker than it is."""
    assert "every distance is 5 % too short" in said(known, "square root of albedo times gain")
    assert "one albedo, 0.4;" in said(known, "a patch")
    darker = replace(shot.truth.photometry, brdf=el.Lambertian(0.4 / 1.1))
    result = el.reconstruct(shot.frame, el.Calibration(CAMERA, darker))
    np.testing.assert_allclose(np.nanmedian(result.distance / known.distance), 1 / 1.05, rtol=0.005)


def test_other_walls_are_described_too(relative, known):
    assert "one albedo; a patch" in said(relative, "patch")  # its value plays no part
    table = replace(known.problem.photometry, brdf=el.TabulatedBRDF((0.0, 1.5), (0.1, 0.1)))
    assert "reflectance (π times the BRDF, facing), 0.31;" in said(posed(known, photometry=table), "patch")
    glossy = replace(known.problem.photometry, brdf=el.Glossy(0.5))
    assert "one albedo, 0.5;" in said(posed(known, photometry=glossy), "patch")


def test_what_gamma_does_is_what_it_does(shot, relative):
    """Solve with γ 0.1 larger: the ratio of the dark to the bright changes by what the sentence says."""
    words = r"γ were (\S+) and not (\S+),.* ([\d.]+) % or more nearer.* ([\d.]+) %"
    more, gamma, nearer, farther = map(float, re.search(words, said(relative, "γ")).groups())
    assert (more, gamma) == (pytest.approx(2.3), pytest.approx(2.2))
    wrong = el.Calibration(CAMERA, replace(shot.up_to_scale.photometry, gamma=2.3))
    other, plain = (el.reconstruct(shot.frame, each, solver="facing") for each in (wrong, shot.up_to_scale))
    change = np.log(other.distance / plain.distance)
    image, mask = plain.problem.image, plain.mask
    near = (mask & (np.abs(image - np.percentile(image[mask], at)) < 0.004) for at in (5, 50, 95))
    low, middle, high = (np.nanmean(change[pixels]) for pixels in near)
    assert 100 * np.expm1(middle - high) == pytest.approx(nearer, rel=0.1)
    assert 100 * np.expm1(low - middle) == pytest.approx(farther, rel=0.1)


def test_pixels_that_say_less_are_counted(relative):
    assert not any("saturated" in each or "Highlights" in each for each in meaning(relative))
    evidence = np.zeros(relative.mask.shape, np.int8)
    evidence[:10, :30], evidence[20:22, :75] = AT_LEAST, NONE
    assert relative.mask.all()
    result = posed(relative, evidence=evidence)
    assert "300 of 30000 pixels (1 %), which only say 'at least this bright'" in said(result, "saturated")
    assert "150 of 30000 pixels (0.5 %)" in said(result, "Highlights")


def test_bounced_light_and_notes_are_told(relative):
    assert "counts as direct" in said(relative, "bounced")
    result = posed(relative, origin=Origin(albedo=(0.75, 0.38, 0.3), notes=("The colours say little.",)))
    assert "with albedos of 0.75, 0.38, 0.3 (R, G, B), and taken out" in said(result, "bounced")
    assert meaning(result)[-1] == "The colours say little."


@pytest.mark.parametrize("size", [(200, 150), (60, 150), (200, 40)])
def test_the_overview_says_it_at_its_foot(size):
    """Under everything else, and within the page, whatever the frame's shape."""
    camera = el.Pinhole(*size, 110.0, 110.0, size[0] / 2, size[1] / 2)
    result = solve(Shot("curved", el.Calibration(camera, el.Photometry())), solver="facing")
    pixels = [(0.2 * size[0], 0.2 * size[1]), (0.7 * size[0], 0.8 * size[1])]
    for shown in (result, with_known_length(result, known_diameter=(12.25, *pixels))):
        figure = plots.overview(shown)
        assert figure.get_supxlabel() == meaning(shown)[0]
        figure.canvas.draw()
        foot = figure._supxlabel.get_window_extent()
        assert 0 <= foot.x0 < foot.x1 <= figure.bbox.width
        assert 0 <= foot.y0 < foot.y1 < min(ax.get_tightbbox().y0 for ax in figure.axes)
