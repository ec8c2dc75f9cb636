"""Figures: what they say, what they leave out, and that they leave nothing behind."""

import io
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest

from endolab import plots
from endolab.brdf import Lambertian
from endolab.cameras import KannalaBrandt
from endolab.depth.energy import Problem
from endolab.iteration import Iterate, Result, Status
from endolab.photometry import Photometry
from endolab.rendering import Rendered, render
from endolab.scenes import SCENES

PAPER = KannalaBrandt(
    1440, 1080, 717.21, 717.48, 735.37, 552.80, (-0.13893, -0.0012396, 0.00091258, -0.000040716)
)


@pytest.fixture(scope="module")
def rendered() -> Rendered:
    return render(SCENES["colon"], PAPER.resize(80, 60), Photometry(brdf=Lambertian((0.75, 0.38, 0.30))))


@pytest.fixture(scope="module")
def start(rendered: Rendered) -> Iterate:
    green = rendered.image[..., 1]
    problem = Problem(
        image=green,
        mask=rendered.mask & (green > 1.5 / 255),
        camera=rendered.camera,
        photometry=rendered.photometry.channel("green"),
        picture=rendered.image,
    )
    return Iterate.of(problem, problem.log_facing)


@pytest.fixture(autouse=True)
def _no_figure_stays():
    yield
    plt.close("all")


def pixels(figure) -> np.ndarray:
    """Draw a figure and read it back, (H, W, 3) in [0, 1]."""
    file = io.BytesIO()
    figure.savefig(file, format="png")
    file.seek(0)
    return plt.imread(file)[..., :3]


def test_a_depth_map_has_units_limits_and_neutral_holes():
    distance = np.linspace(10.0, 110.0, 1200).reshape(30, 40)
    distance[:10, :10] = np.nan
    ax = plots.show_depth(distance)
    image = ax.images[0]
    assert image.get_clim() == pytest.approx(tuple(np.nanpercentile(distance, [1, 99])))
    assert image.colorbar.ax.get_ylabel() == "distance from the camera [mm]"
    assert image.colorbar.extend == "both"
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("column u [px]", "row v [px]")
    assert image.get_array().mask.sum() == 100
    drawn = pixels(ax.figure)
    holes = np.isclose(drawn, plots.LEFT_OUT, atol=0.01).all(axis=-1).sum()
    assert holes > 0.02 * drawn[..., 0].size

    ax = plots.show_depth(distance, unit="relative units", limits=(0.0, 200.0))
    assert ax.images[0].get_clim() == (0.0, 200.0)
    assert "relative units" in ax.images[0].colorbar.ax.get_ylabel()
    assert ax.images[0].colorbar.extend == "neither"


def test_a_depth_map_without_a_value_is_drawn():
    pixels(plots.show_depth(np.full((4, 5), np.nan)).figure)


@pytest.mark.parametrize("shape", [(6, 8), (6, 8, 3)])
def test_a_picture_keeps_its_values(rng, shape):
    picture = rng.uniform(-0.2, 1.2, shape)
    shown = plots.show_picture(picture).images[0]
    assert np.array_equal(shown.get_array(), picture.clip(0, 1))
    assert len(shape) == 3 or shown.get_clim() == (0, 1)


def test_normals_are_halved_and_shifted():
    normals = np.zeros((2, 2, 3))
    normals[..., 2] = -1
    normals[0, 0] = np.nan
    shown = np.asarray(plots.show_normals(normals).images[0].get_array())
    assert np.allclose(shown[1, 1], [0.5, 0.5, 0.0])
    assert np.allclose(shown[0, 0], plots.LEFT_OUT)


def test_an_error_is_signed_and_centred():
    truth = np.full((4, 4), 50.0)
    estimate = truth + np.linspace(-1, 4, 16).reshape(4, 4)
    estimate[0, 0] = np.nan
    image = plots.show_error(estimate, truth).images[0]
    assert image.get_array()[3, 3] == pytest.approx(8.0)
    assert image.get_clim()[0] == -image.get_clim()[1]
    assert image.get_clim()[1] == pytest.approx(8.0, rel=0.1)
    assert image.colorbar.ax.get_ylabel().endswith("[%]")
    image = plots.show_error(estimate, truth, relative=False, unit="mm", limit=2.0).images[0]
    assert image.get_clim() == (-2.0, 2.0)
    assert image.colorbar.ax.get_ylabel().endswith("[mm]")
    pixels(plots.show_error(truth, truth).figure)  # no error at all


def test_a_section_lies_on_the_surface(rendered):
    field = rendered.camera.field
    ax = plots.show_section({"truth": rendered.distance, "mine": 2 * rendered.distance}, field)
    z, y = ax.lines[0].get_data()
    points = rendered.distance[..., None] * field.rays
    assert np.array_equal(z, points[:, 40, 2], equal_nan=True)
    assert np.array_equal(y, points[:, 40, 1], equal_nan=True)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("z [mm]", "y [mm]")
    assert ax.yaxis_inverted()
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["truth", "mine"]

    ax = plots.show_section({"truth": rendered.distance}, field, row=7, unit="relative units")
    assert np.array_equal(ax.lines[0].get_ydata(), points[7, :, 0], equal_nan=True)
    assert ax.get_ylabel() == "x [relative units]"
    with pytest.raises(ValueError, match="row or a column"):
        plots.show_section({}, field, row=1, column=1)


def test_a_history_is_logarithmic_and_bears_zeros():
    history = [{"k": k, "energy": 0.5**k, "data": 0.5**k, "regulariser": 0.0} for k in range(5)]
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
    middle = np.mean([path.vertices[:4].mean(axis=0) for path in ax.collections[0].get_paths()], axis=0)
    assert middle == pytest.approx([-50 * np.sin(np.deg2rad(30)), 0.0], abs=0.5)
    assert len(plots.show_cloud(wall, np.full(x.shape, 0.5), angle=120).collections) == 0  # its back
    pixels(plots.show_cloud(np.full((5, 6, 3), np.nan), np.zeros((5, 6))).figure)


@pytest.mark.parametrize("grey", [False, True])
def test_an_overview_says_everything_and_leaves_no_figure(start, rendered, grey):
    iterate = replace(start, problem=replace(start.problem, picture=None)) if grey else start
    result = Result(iterate, Status.CONVERGED, [{"k": 0, "energy": iterate.energy}], 0.1)
    open_figures = plt.get_fignums()
    figure = plots.overview(result, truth=rendered.distance)
    assert plt.get_fignums() == open_figures
    titles = [ax.get_title() for ax in figure.axes if ax.get_title()]
    assert len(titles) == 6
    assert "reached its goal" in figure.get_suptitle()
    assert "relative" not in figure.get_suptitle()
    section = next(ax for ax in figure.axes if ax.get_title().startswith("Section"))
    assert [text.get_text() for text in section.get_legend().get_texts()] == ["truth", "start", "estimate"]
    assert pixels(figure).shape == (900, 1600, 3)


def test_an_overview_without_a_gain_says_relative(start, rendered):
    iterate = replace(start, problem=replace(start.problem, metric=False))
    figure = plots.overview(iterate, truth=7 * rendered.distance)
    assert "relative units" in figure.get_suptitle()
    section = next(ax for ax in figure.axes if ax.get_title().startswith("Section"))
    truth, estimate = section.lines[0].get_xdata(), section.lines[2].get_xdata()
    assert 0.5 < np.nanmedian(estimate / truth) < 2
    assert not any("mm" in ax.get_ylabel() or "mm" in ax.get_xlabel() for ax in figure.axes)
