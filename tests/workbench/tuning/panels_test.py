"""The tuner's panels and boards: what is shown, where it lies, what is said of it."""

from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.reconstruction.uncertainty import noise_left
from endolab.solvers.problem import NONE
from endolab.workbench.plots.scales import OKABE_ITO, SOURCE_COLOURS
from endolab.workbench.tuning.boards import draw_answer, draw_columns, draw_pair
from endolab.workbench.tuning.engine import Tuner
from endolab.workbench.tuning.panels import (
    PANELS,
    USUAL_PANELS,
    View,
    ratio_of,
    relative_change,
)
from endolab.workbench.tuning.pictures import (
    DRAWING,
    Map,
    to_colours,
)
from endolab.workbench.tuning.sentences import warnings
from endolab.workbench.tuning.source import Knobs
from endolab.workbench.tuning.tried import Tried, suggested_lam


@pytest.fixture(scope="module")
def engine():
    engine = Tuner(datasets.load_calibration("simple", 160))
    yield engine
    engine.close()


@pytest.fixture(scope="module")
def answer(engine):
    return engine.solve_cold(Knobs(scene="tube", width=160, noise=1.0))


@pytest.fixture(scope="module")
def smoother(engine, answer):
    return engine.solve_cold(replace(answer.settings, lam=100.0))


@pytest.fixture(scope="module")
def cut_answer(answer):
    """The answer with a cut and a highlight."""
    cuts = np.zeros((2, 120, 160), bool)
    evidence = np.zeros((120, 160), np.int8)
    cuts[0, 40:80, 80] = True
    evidence[50:60, 20:30] = NONE
    iterate = answer.result.iterate
    problem = replace(iterate.problem, cuts=cuts, evidence=evidence)
    result = replace(answer.result, iterate=replace(iterate, problem=problem))
    return replace(answer, result=result)


def test_every_panel_fills_its_cell_and_reads_its_pixels(answer):
    trusted = replace(answer, uncertainty=el.uncertainty_of(answer.result, draws=4))
    for panel in PANELS.values():
        drawn = panel(trusted, View())
        drawn.draw(np.full((300, 400, 3), 255, np.uint8), 12)
        if isinstance(drawn, Map) and drawn.picture is not None:
            assert drawn.picture.shape[:2] == answer.result.mask.shape
            assert drawn.says is None or isinstance(drawn.says(60, 80), str)
    sigma = 100 * trusted.uncertainty.sigma / answer.result.distance
    shown = PANELS["σ"](trusted, View())
    assert np.array_equal(shown.picture, to_colours(sigma, shown.limits, "magma"))
    decided = PANELS["what determined each pixel"](trusted, View()).picture
    for k, colour in enumerate(SOURCE_COLOURS.values(), 1):
        is_it = (decided == colour).all(axis=-1)
        assert np.array_equal(is_it, trusted.uncertainty.dominant_source == k)
    assert "find σ" in PANELS["σ"](answer, View()).title


def test_a_residual_below_noise_is_no_news_and_contours_are_seen(answer, cut_answer):
    residual = PANELS["model - frame"](answer, View()).picture
    quiet = np.abs(answer.residual) <= 2 * 255 * noise_left(answer.result)[0]
    assert np.array_equal((residual == DRAWING.below_noise).all(axis=-1), quiet)
    shown = PANELS["contours"](cut_answer, View())
    assert (shown.picture[40:80, 80] == OKABE_ITO.vermilion).all()
    assert (shown.picture[50:60, 20:30] == OKABE_ITO.purple).all()
    assert "cut" in shown.says(50, 80)
    assert "40 px" in " ".join(name for name, _ in shown.keys)


def test_two_and_several_share_one_scale(answer, smoother):
    board = draw_pair(answer, smoother, View())
    a, b = (board.places[number].panel for number in (0, 1))
    assert (a.limits, a.title[0], b.title[0]) == (b.limits, "A", "B")
    ratio = ratio_of(answer, smoother)
    expected = 100 * (
        smoother.result.distance[60, 80] / answer.result.distance[60, 80] - 1
    )
    assert float(ratio.says(60, 80).split()[0]) == pytest.approx(expected, abs=0.06)
    columns = {"λ 1": answer, "λ 10": None, "λ 100": smoother}
    several = draw_columns(columns, answer, View())
    assert [place.answer for place in several.places] == [answer, smoother] * 3
    change = several.places[
        3
    ].panel  # beside the frame, whose one bar is beside the row
    expected = to_colours(relative_change(answer, smoother), change.limits, "RdBu_r")
    np.testing.assert_array_equal(change.picture, expected)


def test_what_should_be_known_is_a_sentence(engine, answer, smoother, cut_answer):
    assert warnings(answer, None) == []
    sphere = engine.solve_cold(replace(answer.settings, regulariser="first", lam=1e4))
    assert "λ is too large" in warnings(sphere, None)[0].sentence
    found = warnings(smoother, Tried.of(cut_answer))
    assert any("Contours changed with λ" in one.sentence for one in found)
    iterate = answer.result.iterate
    nearer = np.where(np.arange(160) < 16, np.log(0.8), 0)  # a tenth of the pixels
    moved = replace(iterate, log_distance=iterate.log_distance + nearer)
    elsewhere = replace(answer, followed=replace(answer.result, iterate=moved))
    assert "not unique: 10 %" in warnings(elsewhere, None)[0].chip
    small = replace(iterate, log_distance=iterate.log_distance + np.log(1.05))
    alike = replace(answer, followed=replace(answer.result, iterate=small))
    assert warnings(alike, None) == []


def test_the_lam_curve_has_a_line_for_each_set_of_contours(
    answer, smoother, cut_answer
):
    tried = [Tried.of(one) for one in (answer, smoother, cut_answer)]
    chart = PANELS["λ curve"](answer, View(tried=tried))
    lams = [curve[1].tolist() for curve in chart.curves]
    assert sorted(lams) == [[1], [1], [1, 100], [1, 100]]
    brought = [dot.brings.lam for dot in chart.dots if dot.brings]
    assert sorted(brought) == [1, 1, 1, 1, 100, 100]
    assert chart.guides[1][0] == pytest.approx([suggested_lam(tried, answer)] * 2)


def test_maps_are_cropped_to_the_mask_and_all_are_zoomed_to_one_window(answer):
    mask = np.zeros((120, 160), bool)
    mask[30:90, 40:120] = True
    iterate = answer.result.iterate
    problem = replace(iterate.problem, mask=mask)
    cropped = replace(
        answer,
        result=replace(answer.result, iterate=replace(iterate, problem=problem)),
    )
    board = draw_answer(cropped, USUAL_PANELS, View(zoom=(0.0, 0.5, 0.5, 1.0)))
    for place in board.places[:3]:
        assert place.window == pytest.approx((40 / 160, 60 / 120, 80 / 160, 90 / 120))
        assert place.pixel(0.01, 0.01) == (60, 40)
        assert place.pixel(0.99, 0.99) == (89, 79)
