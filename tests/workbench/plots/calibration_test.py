"""Figures of a calibration: what they show is what was found."""

from dataclasses import replace

import numpy as np
import pytest

from endolab.calibration import summary
from endolab.calibration.photometric.result import AngleErrors
from endolab.calibration.uncertainty import fall_off_uncertainty, ray_uncertainty
from endolab.workbench.plots import calibration as plots
from tests.tools.simulated_session import simulated


@pytest.fixture(scope="module")
def session():
    return simulated()[0]


def test_arrows_are_the_residuals(session):
    geometry = session.geometry
    ax = plots.show_reprojection(geometry)
    (arrows,) = ax.collections
    magnify = float(ax.get_title().split("× ")[1])
    assert arrows.scale == pytest.approx(1 / magnify)
    assert 0.4 < magnify * geometry.sigma / (0.02 * geometry.camera.width) <= 1
    assert np.isin(arrows.U, np.concatenate(geometry.residuals)[:, 0]).all()


def angle_of(lines, camera):
    (path,) = (path for path in lines.get_paths() if len(path))
    return np.rad2deg(np.arccos(camera.unproject(path.vertices)[:, 2]))


def test_the_field_ends_at_the_farthest_feature(session):
    ax = plots.show_coverage(session.geometry)
    assert (ax.get_xlim(), ax.get_ylim()) == ((-0.5, 159.5), (119.5, -0.5))
    farthest = np.rad2deg(session.geometry.max_angle_seen)
    assert angle_of(ax.collections[-1], session.camera) == pytest.approx(
        farthest, abs=0.2
    )


def test_gains_stand_beside_the_distance_and_what_is_unknown_is_left_out(session):
    distance = summary.mean_distances(session.samples, session.light.frames)
    unknown = np.where(np.arange(20) == 5, np.inf, session.light.gain_errors)
    light = replace(session.light, gain_errors=unknown)
    ax = plots.show_gains(light, distance=distance)
    assert np.isnan(ax.lines[0].get_ydata()[5])
    assert np.array_equal(ax.figure.axes[1].lines[0].get_ydata(), distance)


def test_of_a_few_samples_no_score_is_shown():
    error = np.array([0.001, -0.001, -0.002])
    spread = np.array([0.001, 0.001, 0.5])
    edges = np.deg2rad([0, 10, 20, 30])
    ax = plots.show_scores(AngleErrors(edges, error, spread, np.array([30, 30, 1])))
    shown = ax.lines[1].get_ydata()
    assert np.allclose(shown, [0.1, -0.1, np.nan], equal_nan=True)
    assert ax.get_ylim()[1] < 5


def test_maps_of_uncertainty_show_their_values_on_the_whole_picture(session):
    geometry = session.geometry
    light = session.light
    camera = session.camera
    seen = geometry.max_angle_seen
    known = ray_uncertainty(geometry.camera, geometry.covariance, max_angle=seen)
    fall_off = plots.show_fall_off_uncertainty(light, camera)
    for ax, expected, angle in (
        (plots.show_ray_uncertainty(geometry), known, seen),
        (fall_off, fall_off_uncertainty(light, camera), light.alpha_range[1]),
    ):
        (shown,) = ax.images
        values = shown.get_array().filled(np.nan)
        assert np.array_equal(values, expected, equal_nan=True)
        assert shown.get_extent() == [-0.5, 159.5, 119.5, -0.5]
        assert angle_of(ax.collections[0], camera) == pytest.approx(
            np.rad2deg(angle), abs=0.2
        )
