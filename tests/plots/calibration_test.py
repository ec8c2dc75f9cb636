"""Figures of a calibration: what they say, what they leave out, and that they leave nothing behind."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest

import endolab as el
from endolab.calibration import summary
from endolab.calibration.detection.detect import Detection
from endolab.calibration.photometric.result import HeldOut
from endolab.plots import calibration as plots
from endolab.plots import light as light_module
from tests.tools.simulated_session import LOST, NOISE, refused, simulated


@pytest.fixture(autouse=True)
def _no_figure_stays():
    yield
    plt.close("all")


def labels(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def drawn(ax):
    ax.figure.canvas.draw()
    return ax


def test_a_detection_is_joined_along_the_rows_of_the_target():
    session, frames, _ = simulated()
    name, image = frames[0]
    detection, target = session.detections[name], session.target
    ax = drawn(plots.show_detection(image, detection, target))
    assert f"{len(detection.ids)} of 190" in ax.get_title()
    place = {tuple(pixel): number for number, pixel in zip(detection.ids, detection.pixels, strict=True)}
    joined, colours = [], {}
    for line in ax.lines[:-2]:  # the last two mark the first feature
        ids = [place[tuple(point)] for point in line.get_xydata()]
        assert len({number // target.columns for number in ids}) == 1
        assert np.all(np.isin(np.diff(ids), [1, 2]))
        joined += ids
        colours[ids[0] // target.columns] = line.get_color()
    assert sorted(joined) == list(detection.ids)
    assert colours[4] != colours[5]
    assert ax.texts[0].get_text() == f"id {detection.ids.min()}"
    assert np.array_equal(ax.lines[-1].get_xydata()[0], detection.pixels[0])


def test_a_wrong_id_makes_a_line_that_leaves_its_row():
    session, frames, _ = simulated()
    name, image = frames[0]
    detection = session.detections[name]
    ids = detection.ids.copy()
    ids[[10, 60]] = ids[[60, 10]]

    def longest(which):
        ax = plots.show_detection(image, Detection(which, detection.pixels), session.target)
        steps = (np.linalg.norm(np.diff(line.get_xydata(), axis=0), axis=1) for line in ax.lines)
        return max(step.max(initial=0) for step in steps)

    assert longest(ids) > 2 * longest(detection.ids)


def test_a_frame_without_a_target_says_why_and_circles_and_corners_are_joined_too():
    session, frames, _ = simulated()
    ax = drawn(plots.show_detection(frames[3][1], session.detections[LOST[0]], session.target))
    assert ax.get_title() == "Detection: none (too dark)"
    for target in (el.TARGETS["circles"], el.TARGETS["charuco"]):
        pixels = target.points[:, :2] + 20
        ax = plots.show_detection(np.zeros((100, 120)), Detection(np.arange(len(pixels)), pixels), target)
        assert len(ax.lines) == len(np.unique(target.points[:, 1])) + 2


def test_arrows_are_the_residuals_and_outliers_end_early():
    geometry = simulated()[0].geometry
    ax = drawn(plots.show_reprojection(geometry, magnify=100))
    inliers, outliers = ax.collections
    assert inliers.scale == outliers.scale == 0.01
    residuals, good = np.concatenate(geometry.residuals), np.concatenate(geometry.inliers)
    assert len(inliers.U) == min(good.sum(), plots.MOST_ARROWS)
    assert np.isin(inliers.U, residuals[good, 0]).mean() > 0.99
    length = np.hypot(outliers.U, outliers.V)
    assert length.max() == pytest.approx(plots.LONGEST * NOISE)
    assert labels(ax) == [f"{good.sum()} inliers", f"{np.sum(~good)} outliers"]
    assert "× 100" in ax.get_title()
    assert ax.get_ylim()[0] > ax.get_ylim()[1]


def test_the_histogram_of_residuals_is_a_density_of_the_inliers():
    geometry = simulated()[0].geometry
    ax = drawn(plots.show_reprojection_histogram(geometry))
    assert f"RMSE {geometry.rmse:.3f} px" in ax.get_title()
    heights, edges, _ = ax.patches[0].get_data()
    assert np.sum(heights * np.diff(edges)) == pytest.approx(1, abs=0.01)
    x, curve = ax.lines[0].get_data()
    assert np.trapezoid(curve, x) == pytest.approx(1, abs=0.001)
    assert np.sqrt(np.trapezoid(curve * x**2, x)) == pytest.approx(NOISE, rel=0.03)  # the fit takes its share
    assert ax.get_xlabel().endswith("[px]")


def test_the_field_has_circles_of_equal_angle():
    geometry = simulated()[0].geometry
    ax = drawn(plots.show_coverage(geometry))
    seen = np.rad2deg(geometry.max_angle_seen)
    assert f"to {seen:.0f}° off the axis" in ax.get_title()
    rings = [line for line in ax.lines if len(line.get_xdata()) > 200 and line.get_linestyle() == "-"]
    for ring, angle in zip(rings, range(10, 90, 10), strict=False):
        rays = geometry.camera.unproject(ring.get_xydata())
        assert np.allclose(np.rad2deg(np.arccos(rays[:, 2])), angle, atol=1e-6)
    assert "10°" in [text.get_text() for text in ax.texts]


def test_samples_lie_where_they_were_read():
    session, frames, _ = simulated()
    here = plots.samples_of(session, "frame_4")
    assert 0 < here.sum() <= 60
    assert not plots.samples_of(session, LOST[0]).any()
    samples = session.samples[here]
    used = np.arange(len(samples)) % 4 > 0
    grey = replace(samples, material=(np.arange(len(samples)) % 2).astype(int))
    ax = drawn(light_module.show_sampling(frames[4][1], grey, session.camera, used=used))
    assert labels(ax) == ["bare paper", "grey patch", "left out"]
    shown = np.concatenate([line.get_xydata() for line in ax.lines])
    expected = session.camera.project(samples.points)
    assert np.allclose(np.sort(shown, axis=0), np.sort(expected, axis=0))


def test_residuals_of_the_light_name_mean_and_deviation():
    light = simulated()[0].light
    ax = drawn(light_module.show_light_residuals(light))
    assert f"{light.sigma:.2f} grey levels" in ax.get_title()
    assert f"{np.sum(light.used)} samples" in labels(ax)
    assert ax.texts[0].get_text() == f"{np.sum(~light.used)} left out"
    assert "-0.00" not in light_module.show_light_residuals(replace(light, mean=-0.001)).get_title()


def test_the_fall_off_is_a_power_of_the_cosine_about_the_lights_own_direction():
    light = simulated()[0].light
    k, error = light.photometry.k, light.standard_errors["k"]
    ax = drawn(light_module.show_fall_off(light))
    assert labels(ax)[0] == f"cosᵏ α, k = {k:.3f} ± {error:.3f}"
    assert "not sampled" in labels(ax)
    fourth, curve = ax.lines
    alpha = np.deg2rad(curve.get_xdata())
    assert np.allclose(curve.get_ydata(), np.cos(alpha) ** k, atol=1e-6)
    assert np.allclose(fourth.get_ydata(), np.cos(alpha) ** 4, atol=1e-6)
    unseen = [patch.get_extents().transformed(ax.transData.inverted()) for patch in ax.patches]
    low, high = np.rad2deg(light.alpha_range)
    assert [(box.x0, box.x1) for box in unseen] == [pytest.approx((0, low)), pytest.approx((high, 90))]
    spot = replace(light.photometry, k=0.0, lights=(el.SpotLight((1.0, 0, 0), (0, 0, 1.0), 2.6),))
    ax = light_module.show_fall_off(replace(light, photometry=spot))
    assert "ψ" in ax.get_xlabel()
    assert "k = 2.600" in labels(ax)[0]


def test_gains_stand_beside_the_distance():
    session = simulated()[0]
    light = session.light
    numbers = plots.video_frames(session)
    assert len(numbers) == 20
    assert not {3, 9} & set(numbers)
    distance = summary.mean_distances(session.samples, light.frames)
    assert distance[2] == pytest.approx(session.samples.distance[session.samples.frame == 2].mean())
    ax = drawn(light_module.show_gains(light, frames=numbers, distance=distance))
    assert np.array_equal(ax.lines[0].get_xdata(), numbers)
    assert np.array_equal(ax.lines[0].get_ydata(), light.gains)
    other = next(axes for axes in ax.figure.axes if axes is not ax)
    assert np.array_equal(other.lines[0].get_ydata(), distance)
    assert "[mm²]" in ax.get_ylabel()
    assert "[mm]" in other.get_ylabel()
    unknown = replace(light, gain_errors=np.where(np.arange(20) == 5, np.inf, light.gain_errors))
    ax = drawn(light_module.show_gains(unknown))
    assert np.isnan(ax.lines[0].get_ydata()[5])
    assert np.array_equal(ax.lines[0].get_xdata(), light.frames)


def test_the_brdf_is_relative_to_its_pinned_node():
    session = simulated()[0]
    light = session.light
    theta, relative, errors = summary.brdf_of(light)
    pinned = np.flatnonzero(errors == 0)
    assert len(pinned) == 1
    assert relative[pinned] == 1
    assert np.allclose(relative, np.array(light.photometry.brdf.values) * np.pi)  # paper_albedo is 1
    ax = drawn(light_module.show_brdf(light, samples=session.samples))
    assert {"Lambertian", "fitted ± 1 s.e.", "samples", "not sampled"} == set(labels(ax))
    heights = np.array([bar.get_height() for bar in ax.containers[-1]])
    cosine = session.samples.cos_theta[light.used]
    expected = np.histogram(np.rad2deg(np.arccos(np.minimum(cosine, 1))), np.arange(0, 91, 3))[0]
    assert np.allclose(heights / heights.max(), expected / expected.max())
    assert np.allclose(theta, light.photometry.brdf.theta)
    matt = replace(light, photometry=replace(light.photometry, brdf=el.Lambertian(1.0)))
    ax = drawn(light_module.show_brdf(matt))
    assert "taken to be Lambertian" in labels(ax)


def test_a_score_shows_its_bins_and_how_many_samples_they_hold():
    scores = HeldOut(
        edges=np.deg2rad([0, 10, 20, 30, 40, 50]),
        error=np.array([0.001, -0.001, 0.001, -0.002, np.nan]),
        standard_error=np.array([0.001, 0.001, 0.001, 0.5, np.nan]),
        count=np.array([30, 30, 30, 1, 0]),
        residuals=np.zeros(91),
        used=np.ones(91, bool),
        sigma=3.0,
    )
    ax = drawn(light_module.show_scores(scores))
    points = ax.containers[0].lines[0].get_xydata()
    assert np.allclose(points, [[5, 0.1], [15, -0.1], [25, 0.1], [35, -0.2]])
    assert [text.get_text() for text in ax.texts] == ["30", "30", "30", "1", "samples"]
    assert 0.2 < ax.get_ylim()[1] < 5  # nothing is lost, and the wide bar does not rule
    drawn(light_module.show_scores(replace(scores, count=np.zeros(5, int))))


def test_a_ridge_shows_residual_and_k():
    gammas = np.linspace(2.0, 2.4, 5)
    ax = drawn(light_module.show_ridge(gammas, np.full(5, 3.0), 1.13 * gammas))
    other = next(axes for axes in ax.figure.axes if axes is not ax)
    assert np.allclose(other.lines[0].get_ydata(), 1.13 * gammas)
    assert labels(ax) == ["residuals", "k"]


@pytest.mark.parametrize("name", ["vicalib_small", "vicalib_folded"])
def test_pages_are_whole_and_leave_no_figure(name):
    session, frames, _ = simulated(name)
    assert plots.best_frame(session) in session.poses
    image = dict(frames)[plots.best_frame(session)]
    before = plt.get_fignums()
    geometry, light = plots.geometry_figure(session, image), plots.light_figure(session, image)
    for figure, panels in ((geometry, 4), (light, 6)):
        figure.canvas.draw()
        assert sum(bool(ax.get_title()) for ax in figure.axes) == panels
    plots.light_figure(replace(session, scores=None), image, "frame_4").canvas.draw()
    assert plt.get_fignums() == before


def test_pages_of_what_is_not_there_are_refused():
    session, frames, _ = simulated()
    with pytest.raises(ValueError, match="camera was given"):
        plots.geometry_figure(replace(session, geometry=None), frames[0][1])
    with pytest.raises(ValueError, match="cannot be told"):
        plots.light_figure(refused(session), frames[0][1])
