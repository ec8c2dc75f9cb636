"""Figures of a calibration: what they show is what was found."""

from dataclasses import replace

import numpy as np
import pytest

from endolab.calibration import summary
from endolab.calibration.photometric.result import AngleErrors
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


def test_the_field_ends_at_the_farthest_feature(session):
    ax = plots.show_coverage(session.geometry)
    assert (ax.get_xlim(), ax.get_ylim()) == ((-0.5, 159.5), (119.5, -0.5))
    (path,) = (path for path in ax.collections[-1].get_paths() if len(path))
    cosine = session.camera.unproject(path.vertices)[:, 2]
    angle = session.geometry.max_angle_seen
    assert np.arccos(cosine) == pytest.approx(angle, abs=0.004)


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
