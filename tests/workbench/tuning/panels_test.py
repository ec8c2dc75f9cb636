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
    DARK,
    DRAWING,
    Chart,
    Map,
    ticks,
    to_colours,
)
from endolab.workbench.tuning.sentences import summary, warnings
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
    assert board.places[1].pixel(40.5 / 160, 30.5 / 120) == (30, 40)
    text = board.places[1].says(30, 40)
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


def test_the_line_tells_what_is_explained_and_which_way_to_go(engine, answer, smoother):
    line = summary(answer)
    assert line.startswith("λ 1 · second order (auto) · explains ")
    assert "grey levels · converged in" in line
    smoothest = engine.solve_cold(replace(answer.settings, lam=1e4))
    tried = [Tried.of(answer), Tried.of(smoother), Tried.of(smoothest)]
    best = suggested_lam(tried, smoothest)
    assert 1 < best < 1e4
    assert f"λ {best:.2g}" in summary(smoothest, tried)
    assert "less λ" in summary(smoothest)
    dark = [replace(Tried.of(smoothest), explained=0.5 + 0.1 * i) for i in range(5)]
    lams = [10.0**i for i in range(5)]
    none = [
        replace(one, settings=replace(one.settings, lam=lam))
        for one, lam in zip(dark, lams, strict=True)
    ]
    assert "no λ" in summary(smoothest, none)
    marched = engine.solve_cold(replace(answer.settings, solver="fast_marching"))
    assert "λ" not in summary(marched)
    assert PANELS["λ curve"](marched, View(tried=tried)).picture is None


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


def test_the_spread_is_the_most_over_the_least(answer, smoother):
    several = replace(answer, variants={"λ 10": smoother})
    spread = PANELS["spread over λ"](several, View())
    ratio = smoother.result.distance[60, 80] / answer.result.distance[60, 80]
    expected = 100 * (max(ratio, 1 / ratio) - 1)
    assert float(spread.says(60, 80).split()[0]) == pytest.approx(expected, abs=0.06)
    assert "2 of 5" in spread.title


def test_a_section_has_a_gap_where_the_surface_is_cut(answer, cut_answer):
    for one, gaps in ((answer, 0), (cut_answer, 1)):
        chart = PANELS["section"](one, View(line=(True, 0.5)))
        inside = np.isfinite(chart.curves[-1][1])
        assert (~inside).sum() == gaps
    assert not inside[81]  # between the columns 80 and 81


def test_equal_ratios_of_distance_are_equal_steps_of_colour(answer):
    shown = to_colours(np.array([[10.0, 20.0, 40.0]]), (10.0, 40.0), log=True)
    even = to_colours(np.arange(3.0)[None], (0.0, 2.0))
    np.testing.assert_allclose(shown.astype(float), even, atol=1)
    board = PANELS["distance"](answer, View())
    bare = np.full((300, 400, 3), 255, np.uint8)
    lined = bare.copy()
    replace(board, distance=None).draw(bare, 12)
    board.draw(lined, 12)
    assert not np.array_equal(bare, lined)


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


def test_the_cursor_is_where_its_point_is_in_the_section(answer):
    board = draw_answer(answer, ["section"], View(line=(False, 0.5)))
    place = board.places[0]
    x, y = np.round(np.multiply(place.mark(60, 80), (1200, 640))).astype(int)
    around = board.picture[y - 2 : y + 3, x - 2 : x + 3].reshape(-1, 3).astype(int)
    assert np.abs(around - OKABE_ITO.vermilion).sum(axis=1).min() < 60
    assert "column 80, row 60" in place.says(60, 80)


def test_at_night_paper_is_dark_and_ink_is_light(answer):
    board = draw_answer(answer, USUAL_PANELS, View(look=DARK))
    assert np.median(board.picture) < 60
    assert (board.picture[:24] == DARK.ink).all(axis=-1).any()


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
