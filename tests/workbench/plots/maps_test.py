"""Figures: what they say, what they leave out, and that they leave nothing behind."""

import io
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.text import Text
from skimage.color import rgb2lab

import endolab as el
from endolab import plots
from endolab.workbench.plots import style
from endolab.workbench.plots.scales import SOURCE_COLOURS
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


def test_trust_is_shown_in_percent_and_by_who_decided():
    percent = np.full((4, 5), np.nan)
    percent[1:] = 10.0
    percent[3, 4] = 1000.0
    ax = plots.show_sigma(percent)
    assert ax.images[0].get_clim()[0] == 0
    assert ax.images[0].colorbar.ax.get_ylabel() == "σ of the distance [%]"
    assert plots.show_sigma(percent, limit=25).images[0].get_clim() == (0, 25)
    assert plots.show_sigma(np.full((2, 2), np.nan)).images[0].get_clim() == (0, 1)
    decided = np.array([[0, 1, 1, 2], [0, 3, 1, 1]], np.uint8)
    ax = plots.show_dominant_source(decided)
    assert [text.get_text() for text in ax.get_legend().get_texts()] == [
        *("data\n67 %", "border\nor contour\n17 %", "prior\n17 %")
    ]
    shown = np.asarray(ax.images[0].get_array())
    np.testing.assert_allclose(shown[0, 0], to_rgb(style.HOUSE.left_out))
    for k, colour in enumerate(SOURCE_COLOURS.values(), 1):
        np.testing.assert_allclose(
            shown[decided == k] * 255, np.broadcast_to(colour, ((decided == k).sum(), 3))
        )


@pytest.fixture(autouse=True)
def _no_figure_stays():
    yield
    plt.close("all")


def pixels(figure):
    """Draw a figure and read it back, (H, W, 3) in [0, 1]."""
    figure.savefig(file := io.BytesIO(), format="png")
    file.seek(0)
    return plt.imread(file)[..., :3]


def test_a_depth_map_has_units_limits_and_neutral_holes():
    distance = np.linspace(10.0, 110.0, 1200).reshape(30, 40)
    distance[:10, :10] = np.nan
    ax = plots.show_depth(distance)
    image = ax.images[0]
    assert image.get_clim() == pytest.approx(tuple(np.nanpercentile(distance, [1, 99])))
    assert (image.colorbar.ax.get_ylabel(), image.colorbar.extend) == (
        "distance [mm]",
        "both",
    )
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("column u [px]", "row v [px]")
    assert image.get_array().mask.sum() == 100
    drawn = pixels(ax.figure)
    holes = np.isclose(drawn, style.HOUSE.left_out, atol=0.01).all(axis=-1).sum()
    assert holes > 0.02 * drawn[..., 0].size
    ax = plots.show_depth(distance, unit="relative units", limits=(0.0, 200.0))
    assert ax.images[0].get_clim() == (0.0, 200.0)
    assert "relative units" in ax.images[0].colorbar.ax.get_ylabel()
    assert ax.images[0].colorbar.extend == "neither"


def test_an_error_is_signed_and_centred():
    truth = np.full((4, 4), 50.0)
    estimate = truth + np.linspace(-1, 4, 16).reshape(4, 4)
    estimate[0, 0] = np.nan
    image = plots.show_error(estimate, truth).images[0]
    assert image.get_array()[3, 3] == pytest.approx(8.0)
    assert image.get_clim()[0] == -image.get_clim()[1]
    assert image.get_clim()[1] == pytest.approx(8.0, rel=0.1)
    assert image.colorbar.ax.get_ylabel().endswith("[%]")
    assert plots.show_error(estimate, truth, limit=2.0).images[0].get_clim() == (-2.0, 2.0)
    pixels(plots.show_error(truth, truth).figure)  # no error at all
    pixels(plots.show_depth(truth * np.nan).figure)
    with pytest.raises(ValueError, match="limit"):
        plots.show_error(truth, truth, limit=0.0)


def test_a_section_lies_on_the_surface(rendered):
    field = rendered.camera.field
    ax = plots.show_section(
        {"truth": rendered.distance, "mine": 2 * rendered.distance}, field
    )
    z, y = ax.lines[0].get_data()
    points = rendered.distance[..., None] * field.rays
    assert np.array_equal(z, points[:, 40, 2], equal_nan=True)
    assert np.array_equal(y, points[:, 40, 1], equal_nan=True)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("z [mm]", "y [mm]")
    assert ax.yaxis_inverted()
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["truth", "mine"]
    ax = plots.show_section(
        {"truth": rendered.distance}, field, row=7, unit="relative units"
    )
    assert np.array_equal(ax.lines[0].get_ydata(), points[7, :, 0], equal_nan=True)
    assert ax.get_ylabel() == "x [relative units]"
    with pytest.raises(ValueError, match="row or a column"):
        plots.show_section({}, field, row=1, column=1)


def test_a_start_with_spikes_does_not_widen_a_section(rendered):
    field = rendered.camera.field
    truth = rendered.distance
    spiky = truth.copy()
    spiky[28:32, 38:42] *= 20
    limits = {}
    for name, curve in (("start", spiky), ("mine", spiky), ("smooth", truth)):
        ax = plots.show_section({"truth": truth, name: curve}, field)
        ax.figure.canvas.draw()
        limits[name] = ax.get_xlim(), ax.get_ylim()
    assert limits["start"] == limits["smooth"]
    assert limits["mine"][0][1] > 5 * limits["start"][0][1]
    points = truth[..., None] * field.rays
    line = points[:, 40]
    assert (
        np.nanmax(line[:, 2]) > 0.7 * limits["start"][0][1]
    )  # the estimate fills the axes
    alone = plots.show_section({"start": spiky}, field)
    alone.figure.canvas.draw()
    assert (
        alone.get_xlim()[1] > 5 * limits["start"][0][1]
    )  # there is nothing else to follow


def test_a_history_is_logarithmic_and_bears_zeros():
    history = [
        {"k": k, "energy": 0.5**k, "data": 0.5**k, "regulariser": 0.0} for k in range(5)
    ]
    ax = plots.show_history(history)
    assert ax.get_yscale() == "log"
    assert {line.get_label() for line in ax.lines} == {"energy", "data"}
    assert np.allclose(ax.lines[0].get_ydata(), 0.5 ** np.arange(5))
    pixels(ax.figure)


@pytest.mark.parametrize("grey", [False, True])
def test_a_surface_from_the_side_shows_its_colours_and_a_scale(start, grey):
    colours = start.problem.image if grey else start.problem.picture
    ax = plots.show_cloud(start.points, colours)
    patches = ax.collections[0]
    assert 0.2 * start.mask.sum() < len(patches.get_paths()) < start.mask.sum()
    red, green, blue = patches.get_facecolor()[:, :3].T
    assert np.array_equal(red, blue) if grey else (red >= green).all()
    assert ax.artists[0].txt_label.get_text().endswith(" mm")
    pixels(ax.figure)


def test_a_surface_from_the_side_is_seen_from_the_left_and_above():
    x, y = np.meshgrid(np.linspace(-10, 10, 30), np.linspace(-8, 8, 24))
    wall = np.stack([x, y, np.full_like(x, 50.0)], axis=-1)
    ax = plots.show_cloud(wall, np.full(x.shape, 0.5), angle=30, elevation=0)
    middle = np.mean(
        [path.vertices[:4].mean(axis=0) for path in ax.collections[0].get_paths()], axis=0
    )
    assert middle == pytest.approx([-50 * np.sin(np.deg2rad(30)), 0.0], abs=0.5)
    assert (
        len(plots.show_cloud(wall, np.full(x.shape, 0.5), angle=120).collections) == 0
    )  # its back
    pixels(plots.show_cloud(np.full((5, 6, 3), np.nan), np.zeros((5, 6))).figure)


@pytest.mark.parametrize("grey", [False, True])
def test_an_overview_says_everything_and_leaves_no_figure(start, rendered, grey):
    iterate = (
        replace(start, problem=replace(start.problem, picture=None)) if grey else start
    )
    result = el.Result(
        iterate, el.Status.CONVERGED, [{"k": 0, "energy": iterate.energy}], 0.1
    )
    open_figures = plt.get_fignums()
    figure = plots.overview(result, truth=rendered.distance)
    assert plt.get_fignums() == open_figures
    titles = [ax.get_title() for ax in figure.axes if ax.get_title()]
    assert len(titles) == 6
    assert "reached its goal" in figure.get_suptitle()
    assert "relative" not in figure.get_suptitle()
    section = next(ax for ax in figure.axes if ax.get_title().startswith("Section"))
    assert [text.get_text() for text in section.get_legend().get_texts()] == [
        "truth",
        "start",
        "estimate",
    ]
    assert pixels(figure).shape == (900, 1600, 3)


def test_an_overview_without_a_gain_says_relative(start, rendered):
    iterate = replace(start, problem=replace(start.problem, metric=False))
    figure = plots.overview(iterate, truth=7 * rendered.distance)
    assert "relative units" in figure.get_suptitle()
    section = next(ax for ax in figure.axes if ax.get_title().startswith("Section"))
    truth = section.lines[0].get_xdata()
    estimate = section.lines[2].get_xdata()
    assert 0.5 < np.nanmedian(estimate / truth) < 2
    assert not any("mm" in ax.get_ylabel() or "mm" in ax.get_xlabel() for ax in figure.axes)


WAYS_TO_SEE = {  # Machado et al. 2009, linear RGB, severity 1; rows sum to 1
    "normal": ((1, 0), (0, 1), (0, 0)),
    "deuteranopia": ((0.367322, 0.860646), (0.280085, 0.672501), (-0.011820, 0.042940)),
    "protanopia": ((0.152286, 1.052583), (0.114503, 0.786281), (-0.003882, -0.048116)),
}


@pytest.mark.parametrize("eyes", WAYS_TO_SEE)
def test_colours_of_lines_are_told_apart(eyes):
    lines = [
        "black",
        style.HOUSE.sky,
        style.HOUSE.vermilion,
        style.HOUSE.green,
        style.HOUSE.purple,
        style.HOUSE.orange,
        style.HOUSE.blue,
    ]
    stored = np.array([to_rgb(colour) for colour in lines])
    light = np.where(stored <= 0.04045, stored / 12.92, ((stored + 0.055) / 1.055) ** 2.4)
    way = np.array([[red, green, 1 - red - green] for red, green in WAYS_TO_SEE[eyes]])
    seen = (light @ way.T).clip(0, 1)
    seen = np.where(seen <= 0.0031308, 12.92 * seen, 1.055 * seen ** (1 / 2.4) - 0.055)
    lab = rgb2lab(seen)
    apart = np.linalg.norm(lab[:, None] - lab, axis=-1)[np.triu_indices(len(lines), 1)]
    assert apart.min() > 10  # about 2 can be seen side by side
    assert (lab[:, 0] < 80).all()  # and on white paper


def one_of_each(start, rendered, axes=(None,) * 7):
    """Every plot function that draws on axes, in `axes` or its own."""
    field = rendered.camera.field
    history = [
        {"k": k, "energy": 0.5**k, "data": 0.4**k, "regulariser": 0.3**k} for k in range(5)
    ]
    return [
        plots.show_picture(rendered.image, axes[0]),
        plots.show_depth(start.distance, axes[1]),
        plots.show_normals(start.normals, axes[2]),
        plots.show_error(start.distance, rendered.distance, axes[3]),
        plots.show_section(
            {"truth": rendered.distance, "start": start.distance}, field, axes[4]
        ),
        plots.show_history(history, axes[5]),
        plots.show_cloud(start.points, rendered.image, axes[6]),
    ]


def shown_texts(figure):
    figure.canvas.draw()
    return [
        text
        for text in figure.findobj(Text)
        if text.get_text().strip() and text.get_visible()
    ]


def test_text_is_legible_at_half_size_in_whatever_axes(start, rendered):
    with plt.rc_context({"font.size": 6}):
        given = plt.subplots(1, 7, figsize=(30, 5))[1]
    drawn = [*one_of_each(start, rendered), *one_of_each(start, rendered, given)]
    assert all(ax is mine for ax, mine in zip(drawn[7:], given, strict=True))
    for ax in drawn:
        texts = shown_texts(ax.figure)
        assert len(texts) > 2
        assert not [
            str(text) for text in texts if text.get_size() < 12
        ]  # 17 px at 100 dpi, 8 at half size
    for ax in drawn[:6]:  # the last one has a scale bar
        assert ax.get_xlabel().endswith("]") or ax.get_xlabel() == "iteration"
        assert ax.get_ylabel().endswith("]")
    page = plots.overview(start, truth=rendered.distance)
    assert min(text.get_size() for text in shown_texts(page)) >= 12


@pytest.mark.parametrize("theirs", ["default", "dark_background"])
def test_figures_are_opaque_white_on_a_dark_page(start, rendered, theirs):
    """A picture file shown on a dark page, whatever style the user has chosen."""
    with plt.style.context(theirs):
        for ax in [*one_of_each(start, rendered), plots.overview(start).axes[0]]:
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
    with style.house(15):
        title = plots.show_picture(np.zeros((4, 5))).title
        assert title.get_size() == pytest.approx(15 * 1.2)
    assert dict(plt.rcParams) == before


def test_common_limits_are_those_of_all(rng):
    maps = [rng.uniform(20, 40, (30, 40)), rng.uniform(60, 90, (30, 40))]
    maps[0][0] = np.nan
    everything = np.concatenate([m[np.isfinite(m)] for m in maps])
    assert plots.common_limits(maps) == pytest.approx(np.percentile(everything, [1, 99]))
    expected = np.percentile(np.abs(everything - 50), 98)
    assert plots.common_limit([m - 50 for m in maps]) == pytest.approx(expected)
    assert (
        plots.common_limits([]),
        plots.common_limit([np.zeros(3), np.full(2, np.nan)]),
    ) == ((0, 1), 1)
