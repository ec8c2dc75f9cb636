"""Figures: what they say, what they leave out, and that they leave nothing behind."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.text import Text

import endolab as el
from endolab import plots
from endolab.workbench.plots import style
from tests.tools.problems import coloured_colon


@pytest.fixture(scope="module")
def colon():
    return coloured_colon(el.load_calibration("paper", width=80).camera)


@pytest.fixture(scope="module")
def rendered(colon):
    return colon[1]


@pytest.fixture(scope="module")
def start(colon):
    return el.Iterate.of(colon[0], colon[0].log_d0)


@pytest.fixture(autouse=True)
def _no_figure_stays():
    yield
    plt.close("all")


def test_a_depth_map_has_units_and_limits_and_equal_ratios_are_equal_steps():
    distance = np.linspace(10.0, 110.0, 1200).reshape(30, 40)
    distance[:10, :10] = np.nan
    ax = plots.show_depth(distance)
    image = ax.images[0]
    assert image.get_clim() == pytest.approx(tuple(np.nanpercentile(distance, [1, 99])))
    assert image.colorbar.ax.get_ylabel() == "distance [mm]"
    norm = image.norm
    assert norm(40.0) - norm(20.0) == pytest.approx(norm(20.0) - norm(10.0))
    image = plots.show_depth(distance, limits=(1.0, 200.0)).images[0]
    assert image.get_clim() == (1.0, 200.0)
    plots.show_depth(distance * np.nan).figure.canvas.draw()
    assert plots.show_sigma(distance * np.nan).images[0].get_clim() == (0, 1)


def test_isolines_lie_at_the_ticks_and_not_across_jumps():
    ramp = np.tile(np.arange(20.5, 60.0), (30, 1))
    ramp[:, 20:] += 60  # from 39.5 to 100.5 mm in one step
    ax = plots.show_depth(ramp)
    (lines,) = ax.collections
    assert set(lines.levels) <= set(ax.images[0].colorbar.get_ticks())
    drawn = {}
    for level, path in zip(lines.levels, lines.get_paths(), strict=True):
        if len(path):
            drawn[level] = np.unique(path.vertices[:, 0])
    assert drawn == {30: 9.5, 110: 29.5}
    assert not plots.show_depth(np.full((9, 9), 40.0)).collections


def test_an_error_is_signed_and_centred():
    truth = np.full((4, 4), 50.0)
    estimate = truth + np.linspace(-1, 4, 16).reshape(4, 4)
    estimate[0, 0] = np.nan
    image = plots.show_error(estimate, truth).images[0]
    assert image.get_array()[3, 3] == pytest.approx(8.0)
    assert image.get_clim()[0] == -image.get_clim()[1]
    assert image.get_clim()[1] == pytest.approx(8.0, rel=0.1)
    plots.show_error(truth, truth).figure.canvas.draw()  # no error at all


def test_a_section_lies_on_the_surface(rendered):
    field = rendered.camera.field
    distances = {"truth": rendered.distance, "mine": 2 * rendered.distance}
    ax = plots.show_section(distances, field)
    z, y = ax.lines[0].get_data()
    points = rendered.distance[..., None] * field.rays
    assert np.array_equal(z, points[:, 40, 2], equal_nan=True)
    assert np.array_equal(y, points[:, 40, 1], equal_nan=True)
    assert ax.yaxis_inverted()
    assert [text.get_text() for text in ax.get_legend().get_texts()] == [
        "truth",
        "mine",
    ]


def test_a_section_of_a_cut_surface_has_gaps(rendered, start):
    cuts = np.zeros((2, *start.mask.shape), bool)
    cuts[1, 30, 40] = True  # from row 30 to 31
    cut = replace(start, problem=replace(start.problem, cuts=cuts))
    field = rendered.camera.field
    whole, broken = (
        plots.show_section({"a": surface}, field, column=40).lines[0].get_xdata()
        for surface in (start, cut)
    )
    assert np.array_equal(np.delete(broken, 31), whole, equal_nan=True)
    assert np.isnan(broken[31])


def test_a_surface_from_the_side_is_seen_from_the_left_and_above():
    x, y = np.meshgrid(np.linspace(-10, 10, 30), np.linspace(-8, 8, 24))
    wall = np.stack([x, y, np.full_like(x, 50.0)], axis=-1)
    ax = plots.show_cloud(wall, np.full(x.shape, 0.5), angle=30, elevation=0)
    corners = np.stack([path.vertices[:4] for path in ax.collections[0].get_paths()])
    assert corners.mean(axis=(0, 1)) == pytest.approx([-25.0, 0.0], abs=0.5)


def result_of(iterate):
    return el.Result(iterate, el.Status.CONVERGED, [{"k": 0, "energy": 1.0}], 0.1)


def section_of(figure):
    return next(ax for ax in figure.axes if ax.get_title().startswith("Section"))


def test_an_overview_says_everything_and_leaves_no_figure(start, rendered):
    open_figures = plt.get_fignums()
    figure = plots.overview(result_of(start), truth=rendered.distance)
    assert plt.get_fignums() == open_figures
    assert sum(bool(ax.get_title()) for ax in figure.axes) == 6
    assert "reached its goal" in figure.get_suptitle()
    assert "relative" not in figure.get_suptitle()
    names = [text.get_text() for text in section_of(figure).get_legend().get_texts()]
    assert names == ["truth", "start", "estimate"]


def test_an_overview_without_a_gain_says_relative_and_may_be_grey(start, rendered):
    problem = replace(start.problem, metric=False, picture=None)
    relative = result_of(replace(start, problem=problem))
    figure = plots.overview(relative, truth=7 * rendered.distance)
    assert "relative units" in figure.get_suptitle()
    truth, _, estimate, _ = section_of(figure).lines
    assert 0.5 < np.nanmedian(estimate.get_xdata() / truth.get_xdata()) < 2
    labels = [ax.get_xlabel() + ax.get_ylabel() for ax in figure.axes]
    assert not any("mm" in label for label in labels)


def one_of_each(start, rendered, axes=(None,) * 7):
    """Every plot function that draws on axes, in `axes` or its own."""
    history = [{"k": k, "energy": 0.5**k} for k in range(5)]
    curves = {"truth": rendered.distance, "start": start.distance}
    return [
        plots.show_picture(rendered.image, axes[0]),
        plots.show_depth(start.distance, axes[1]),
        plots.show_normals(start.normals, axes[2]),
        plots.show_error(start.distance, rendered.distance, axes[3]),
        plots.show_section(curves, rendered.camera.field, axes[4]),
        plots.show_history(history, axes[5]),
        plots.show_cloud(start.points, rendered.image, axes[6]),
    ]


def sizes_of_text(figure):
    figure.canvas.draw()
    texts = figure.findobj(Text)
    return [text.get_size() for text in texts if text.get_text().strip()]


def test_text_is_legible_at_half_size_in_whatever_axes(start, rendered):
    with plt.rc_context({"font.size": 6}):
        given = plt.subplots(1, 7, figsize=(30, 5))[1]
    drawn = [*one_of_each(start, rendered), *one_of_each(start, rendered, given)]
    assert drawn[7:] == list(given)
    for ax in [*drawn, plots.overview(result_of(start)).axes[0]]:
        sizes = sizes_of_text(ax.figure)
        assert len(sizes) > 2
        assert min(sizes) >= 12  # 17 px at 100 dpi, 8 at half size
    for ax in drawn[:6]:  # the last one has a scale bar
        assert ax.get_xlabel().endswith("]") or ax.get_xlabel() == "iteration"
        assert ax.get_ylabel().endswith("]")


@pytest.mark.parametrize("theirs", ["default", "dark_background"])
def test_figures_are_opaque_white_on_a_dark_page(start, rendered, theirs):
    """A picture file shown on a dark page, whatever style the user has chosen."""
    with plt.style.context(theirs):
        for ax in [
            *one_of_each(start, rendered),
            plots.overview(result_of(start)).axes[0],
        ]:
            canvas = FigureCanvasAgg(ax.figure)
            canvas.draw()
            page = np.asarray(canvas.buffer_rgba()) / 255.0
            assert (page[..., 3] == 1).all()
            assert np.allclose(page[[0, 0, -1, -1], [0, -1, 0, -1], :3], 1)
            outside = [ax.xaxis.label, ax.yaxis.label, ax.title]
            assert all(np.mean(to_rgb(text.get_color())) < 0.3 for text in outside)


def test_the_style_is_not_left_behind_and_can_be_used():
    before = dict(plt.rcParams)
    plots.show_picture(np.zeros((4, 5)))
    assert dict(plt.rcParams) == before
    with plt.rc_context():
        style.use(14)
        assert plt.rcParams["font.size"] == 14


def test_common_limits_are_those_of_all(rng):
    maps = [rng.uniform(20, 40, (30, 40)), rng.uniform(60, 90, (30, 40))]
    maps[0][0] = np.nan
    everything = np.concatenate([m[np.isfinite(m)] for m in maps])
    assert plots.common_limits(maps) == pytest.approx(
        np.percentile(everything, [1, 99])
    )
    expected = np.percentile(np.abs(everything - 50), 98)
    assert plots.common_limit([m - 50 for m in maps]) == pytest.approx(expected)
    assert plots.common_limits([]) == (0, 1)
    assert plots.common_limit([np.zeros(3), np.full(2, np.nan)]) == 1
