"""Every figure: axes with units, white paper and legible text, in whatever axes; nothing is left behind."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.text import Text

import endolab as el
from endolab import plots
from endolab.calibration.photometric.fit import calibrate_light
from tests.tools.simulated_session import refused, simulated

PAGES = {"overview": 6, "prepare_figure": 4, "geometry_figure": 4, "light_figure": 6}
PAGES |= {"uncertainty_figure": 2}  # panels of each
FIGURES = [name for name in dir(plots) if name.startswith("show_")]
WITHOUT_UNIT = {"", "located frame", "$f_r$ relative to the pinned node", "γ"}
WITHOUT_UNIT |= {"share of the light on the axis"}


@pytest.fixture(scope="module")
def drawn(colon):
    """What each figure is drawn of."""
    start, seen = colon
    problem = start.problem
    session, frames = simulated()
    geometry = session.geometry
    light = session.light
    samples = session.samples
    name, image = frames[0]
    detection = session.detections[name]
    result = el.Result(start, el.Status.CONVERGED, [], 0.1)
    return {
        "show_picture": (seen.image,),
        "show_depth": (start,),
        "show_map": (start.distance,),
        "show_normals": (start.normals,),
        "show_error": (start.distance, seen.distance),
        "show_dominant_source": (1 * problem.mask,),
        "show_section": ({"truth": seen.distance, "start": start}, problem.field),
        "show_cloud": (start.points, seen.image),
        "show_detection": (image, detection, session.target),
        "show_reprojection": (geometry,),
        "show_reprojection_histogram": (geometry,),
        "show_coverage": (geometry,),
        "show_ray_uncertainty": (geometry,),
        "show_sampling": (image, samples[samples.frame == 0], session.camera),
        "show_light_residuals": (light,),
        "show_fall_off": (light,),
        "show_gains": (light,),
        "show_brdf": (light,),
        "show_scores": (light.errors_by_angle(samples),),
        "show_ridge": ([calibrate_light(samples, gamma=g) for g in (2.0, 2.4)],),
        "overview": (result,),
        "prepare_figure": (result,),
        "geometry_figure": (session, image),
        "light_figure": (session, image),
        "uncertainty_figure": (session,),
    }


def draw(name, given, **ax):
    needs = {"show_map": {"label": "d [mm]"}, "show_gains": {"distance": np.arange(20)}}
    return getattr(plots, name)(*given, **needs.get(name, {}), **ax)


def check(figure):
    """Text that can be read, units, and opaque white paper under dark words."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    words = [text for text in figure.findobj(Text) if text.get_text().strip()]
    assert min(text.get_size() for text in words) > 9.9
    for ax in figure.axes:
        for label in (ax.get_xlabel(), ax.get_ylabel()):
            assert label in WITHOUT_UNIT or label.endswith("]"), label
        assert np.mean(to_rgb(ax.title.get_color())) < 0.3
    page = np.asarray(canvas.buffer_rgba()) / 255.0
    assert (page[..., 3] == 1).all()
    assert np.allclose(page[[0, 0, -1, -1], [0, -1, 0, -1], :3], 1)


@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_has_units_legible_text_and_white_paper_in_whatever_style(name, drawn):
    before = dict(plt.rcParams)
    with plt.style.context("dark_background"):
        check(draw(name, drawn[name]).figure)
    assert dict(plt.rcParams) == before
    with plt.rc_context({"font.size": 6}):
        given = plt.subplots()[1]
    assert draw(name, drawn[name], ax=given) is given
    assert given.xaxis.label.get_size() >= 12


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_whole_and_none_of_pyplots(name, drawn):
    figure = draw(name, drawn[name])
    check(figure)
    assert sum(bool(ax.get_title()) for ax in figure.axes) == PAGES[name]
    assert plt.get_fignums() == []


def test_a_page_shows_what_there_is(drawn):
    figure = plots.uncertainty_figure(refused(*drawn["uncertainty_figure"]))
    assert sum(bool(ax.get_title()) for ax in figure.axes) == 1


def test_the_style_can_be_used():
    with plt.rc_context():
        plots.style.use()
        assert plt.rcParams["font.size"] == 12
