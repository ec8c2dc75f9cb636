"""Maps of a calibration's uncertainty: their values, where they end, and what is refused."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest

from endolab.calibration.uncertainty import fall_off_uncertainty, ray_uncertainty
from endolab.workbench.plots.uncertainty import (
    show_fall_off_uncertainty,
    show_ray_uncertainty,
    uncertainty_figure,
)
from tests.tools.simulated_session import refused, simulated


@pytest.fixture(autouse=True)
def _no_figure_stays():
    yield
    plt.close("all")


def test_the_map_of_rays_shows_their_values_on_the_whole_picture():
    geometry = simulated()[0].geometry
    ax = show_ray_uncertainty(geometry)
    farthest_angle = geometry.max_angle_seen
    known = ray_uncertainty(
        geometry.camera, geometry.covariance, max_angle=farthest_angle
    )
    (shown,) = ax.images
    values = shown.get_array().filled(np.nan)
    assert np.array_equal(values, known.mrad_shape, equal_nan=True)
    assert shown.get_extent() == [-0.5, 159.5, 119.5, -0.5]
    rim = geometry.camera.unproject(ax.lines[0].get_xydata())
    angle = np.arccos(rim[np.isfinite(rim).all(axis=-1), 2])
    assert angle == pytest.approx(farthest_angle)


def test_the_map_of_the_light_shows_its_values_and_nothing_known_has_a_scale_too():
    session = simulated()[0]
    light = session.light
    ax = show_fall_off_uncertainty(light, session.camera)
    expected = fall_off_uncertainty(light, session.camera)
    assert np.array_equal(
        ax.images[0].get_array().filled(np.nan), expected, equal_nan=True
    )
    assert 0 < ax.images[0].get_clim()[1] < np.nanmax(expected)


def test_the_page_shows_what_there_is():
    session = simulated()[0]
    before = plt.get_fignums()
    for made, panels in (
        (session, 2),
        (refused(session), 1),
        (replace(session, geometry=None), 1),
    ):
        figure = uncertainty_figure(made)
        figure.canvas.draw()
        assert sum(bool(ax.get_title()) for ax in figure.axes) == panels
    assert plt.get_fignums() == before
