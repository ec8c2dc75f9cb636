"""The tuner's panels and boards: what is shown, where it lies, what is said of it."""

from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.reconstruction.uncertainty.estimate import noise_left
from endolab.solvers.problem import NONE
from endolab.workbench.plots.scales import OKABE_ITO, SOURCE_COLOURS
from endolab.workbench.tuning.boards import draw_answer, draw_columns, draw_pair
from endolab.workbench.tuning.engine import Tuner
from endolab.workbench.tuning.panels import PANELS, USUAL_PANELS, Dot, View, ratio_of
from endolab.workbench.tuning.pictures import DRAWING, Chart, Map, ticks, to_colours
from endolab.workbench.tuning.sentences import summary, warnings
from endolab.workbench.tuning.source import Knobs


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


def dot_of(answer):
    return Dot(answer.settings, answer.data, answer.roughness, answer.cut_count)


def test_every_panel_fills_its_cell_and_reads_its_pixels(answer):
    trusted = replace(answer, uncertainty=el.uncertainty_of(answer.result, draws=4))
    for name, panel in PANELS.items():
        drawn = panel(trusted, View())
        drawn.draw(np.full((300, 400, 3), 255, np.uint8), 12)
        if isinstance(drawn, Map) and name != "3D":
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
    assert "40 px cut" in summary(cut_answer)


def test_the_board_says_where_its_maps_are_and_uses_its_room(answer):
    board = draw_answer(answer, USUAL_PANELS, View())
    assert board.picture.shape == (640, 1200, 3)
    for name, place in zip(USUAL_PANELS, board.places, strict=True):
        wide = place.box[2] - place.box[0]
        tall = place.box[3] - place.box[1]
        assert (wide, tall) == pytest.approx((1 / 3, 1 / 2))
        if name in ("frame", "distance", "model - frame"):
            left, top, right, bottom = place.spot
            assert right - left > 0.75 * wide or bottom - top > 0.85 * tall
    text = board.places[1].says(40.5 / 160, 30.5 / 120)
    assert text.startswith(f"{answer.result.distance[30, 40]:.4g} ")


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
    limits = PANELS["distance"](answer, View()).limits
    for place in several.places[:2]:  # whose one bar is beside the row
        assert place.panel.limits is None
        expected = to_colours(place.answer.result.distance, limits)
        np.testing.assert_array_equal(place.panel.picture, expected)


def test_what_should_be_known_is_a_sentence(engine, answer, smoother, cut_answer):
    assert warnings(answer, None) == []
    sphere = engine.solve_cold(replace(answer.settings, regulariser="first", lam=1e4))
    assert "λ is too large" in warnings(sphere, None)[0]
    sentences = warnings(smoother, dot_of(cut_answer))
    assert any("Contours changed with λ" in sentence for sentence in sentences)
    elsewhere = replace(answer, followed=smoother.result)
    assert "ends elsewhere" in warnings(elsewhere, None)[0]
    assert summary(answer).startswith("λ 1 · curvature (auto) · converged")


def test_ticks_are_round_and_a_chart_of_nothing_is_drawn():
    assert [label for _, label in ticks(0, 10)] == ["0", "2", "4", "6", "8", "10"]
    labels = [label for _, label in ticks(-2.1, -0.9, log=True)]
    assert labels == ["0.01", "0.02", "0.05", "0.1"]
    assert len(ticks(0.0, 0.01, log=True)) > 2
    nothing = np.full(3, np.nan)
    for curves in ([], [("a", nothing, nothing, (0, 0, 0))]):
        paper = np.full((150, 200, 3), 255, np.uint8)
        Chart("", "x", "y", curves, log=(True, True)).draw(paper, 12)
        assert paper.std() > 5
