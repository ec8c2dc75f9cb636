"""The photometric fit: derivatives, recovery, gauges, saturation, materials, lights, known geometry."""

from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab.calibration.photometric.fit import calibrate_light
from endolab.calibration.photometric.model import (
    GREY_LEVELS,
    LightModel,
    place_nodes,
)
from endolab.calibration.photometric.samples import Samples
from endolab.calibration.refusals import Doubt, NotIdentifiableError
from endolab.calibration.simulation.video import PAPER_SHEET
from tests.tools.shooting import TRUTH, video


@pytest.mark.parametrize("lamps", [0, 1, 2])
def test_every_derivative_agrees_with_finite_differences(rng, lamps):
    """Of a model with every kind of unknown."""
    samples, _ = video("vicalib_grey", 6, per_frame=40, noise=0.0)
    nodes = place_nodes(np.arccos(samples.cos_theta), 5)
    brdf = rng.normal(-1.0, 0.3, len(nodes))
    mean = np.concatenate([[2.0, 2.0], brdf, [0.0, np.log(0.5)]])
    sd = np.array([np.inf, 0.2, *[np.inf] * len(nodes), 0.0, 0.2])
    sd[4] = 0.0
    model = LightModel(samples.frame, mean, sd, samples, nodes, [])
    own = rng.normal(8, 0.3, (6, 1))
    model = model.with_lamps(lamps)
    vector = model.mean + 0.1 * (model.sd > 0)
    vector[model.of_lamps] = rng.uniform(-5, 5, 2 * lamps)
    _, by_vector, by_own = model.linearise(vector, own)
    for _ in range(10):
        step, own_step = rng.normal(size=len(vector)), rng.normal(size=own.shape)
        slopes = by_vector[:, 0] @ step
        slopes += np.sum(by_own[:, 0] * own_step[samples.frame], axis=1)
        after, before = (
            model.linearise(vector + size * step, own + size * own_step)[0][:, 0]
            for size in (1e-6, -1e-6)
        )
        expected = (after - before) / 2e-6
        np.testing.assert_allclose(slopes, expected, rtol=2e-5, atol=1e-3)


def check_residuals(fit, samples):
    """They are what the calibration does not expect, grey levels."""
    level = replace(fit.photometry, gain=1.0).intensity(samples.points, samples.normals)
    light = fit.gains[np.searchsorted(fit.frames, samples.frame)]
    light = light * fit.reflectance[samples.material]
    left = samples.level - level * light ** (1 / fit.photometry.gamma)
    np.testing.assert_allclose(GREY_LEVELS * left, fit.residuals, atol=1e-9)


def test_a_flat_sheet_gives_k_and_the_brdf_when_gamma_is_given():
    samples, gains = video(count=200, seed=3)
    fit = calibrate_light(samples)
    assert fit.status is el.Status.CONVERGED
    assert abs(fit.k - 2.5) < 0.01
    assert fit.ratio == fit.k / 2.2
    assert abs(fit.sigma - np.hypot(3, 12**-0.5)) < 0.05
    assert abs(fit.residuals[fit.used].mean()) < 0.03
    cosine = np.cos(np.linspace(0.1, 1.2, 50))
    brdf = fit.photometry.brdf.value(cosine, cosine) / PAPER_SHEET.value(cosine, cosine)
    assert np.std(brdf / brdf.mean()) < 0.006
    scale = fit.gains / gains
    assert np.std(scale / scale.mean()) < 0.008
    np.testing.assert_allclose(scale.mean() * brdf.mean(), 1.0, atol=0.01)


@pytest.mark.parametrize("size", [0.0, 0.004])
def test_standard_errors_are_honest(size):
    """Also where the planes of the sheet are off, as wide as `size` of their distance."""
    pulls = []
    for seed in range(15):
        rng = np.random.default_rng(seed)
        how = {"fold": np.deg2rad(35), "seed": seed, "outliers": 0.0}
        samples, _ = video("vicalib_folded", 60, **how)
        planes, plane = np.unique(
            np.column_stack([samples.frame, samples.normals]),
            axis=0,
            return_inverse=True,
        )
        normals = planes[:, 1:] + size * rng.normal(size=(len(planes), 3))
        rise = np.vecdot(samples.points, samples.normals)
        rise *= 1 / np.vecdot(samples.points, normals[plane])
        samples = replace(
            samples,
            points=samples.points * rise[:, None],
            normals=normals[plane] / np.linalg.norm(normals[plane], axis=1)[:, None],
        )
        fit = calibrate_light(samples, gamma="free", nodes=8, lamps="centre")
        off = {"k": fit.k - 2.5, "gamma": fit.photometry.gamma - 2.2}
        pulls.append([error / fit.standard_errors[name] for name, error in off.items()])
    pulls = np.sqrt(np.mean(np.square(pulls), axis=0))
    assert np.all((pulls > 0.55) & (pulls < 1.45)), pulls  # 15 draws: ± 18 %


def test_saturation_is_told_by_the_predicted_level():
    """What is stored between two levels is a choice that looks at the noise."""
    errors = []
    for seed in range(4):
        how = {"fold": 0.7, "outliers": 0.0, "noise": 6.0, "seed": seed}
        samples, _ = video("vicalib_folded", **how)
        chosen = samples[(samples.level > 24 / 255) & (samples.level < 225 / 255)]
        fits = [calibrate_light(one, lamps="centre") for one in (samples, chosen)]
        errors.append([fit.k - 2.5 for fit in fits])
    by_predicted, by_measured = np.transpose(errors)
    assert abs(by_predicted.mean()) < 0.008
    assert np.all(by_measured < by_predicted - 0.003)


@pytest.fixture(scope="module")
def flat():
    return video(count=60, seed=4)[0]


@pytest.fixture(scope="module")
def flat_fit(flat):
    return calibrate_light(flat)


def test_units_of_length_only_scale_the_gains_and_the_order_of_frames_plays_no_part(
    flat, flat_fit
):
    rows = [flat.frame, flat.level, flat.points / 1000, flat.normals, flat.material]
    rows[0] = 1000 - 7 * flat.frame
    fit = calibrate_light(Samples(*(row[::-1] for row in rows)), lamps="centre")
    np.testing.assert_allclose(fit.k, flat_fit.k, rtol=1e-7)
    np.testing.assert_allclose(fit.gains[::-1], flat_fit.gains / 1e6, rtol=1e-6)
    np.testing.assert_array_equal(fit.frames[::-1], 1000 - 7 * flat_fit.frames)


def test_a_locked_gain_is_one_number_and_gives_gamma():
    samples, _ = video(count=80, locked=True)
    fit = calibrate_light(samples, gamma="free", gain="locked")
    assert abs(fit.photometry.gamma - 2.2) < 0.01
    assert abs(fit.k - 2.5) < 0.02
    assert set(fit.gains) == {fit.photometry.gain}
    check_residuals(fit, samples)


def test_grey_patches_of_known_ratio_give_gamma_and_a_given_gamma_measures_them():
    samples, _ = video("vicalib_grey", 150)
    fit = calibrate_light(samples, gamma="free", reflectance=(0.5,))
    assert abs(fit.photometry.gamma - 2.2) < 0.015
    check_residuals(fit, samples)
    samples, _ = video("vicalib_grey", 60)
    for known in (None, (0.51, 0.01)):
        fit = calibrate_light(samples, reflectance=(known,))
        error = fit.standard_errors["reflectance 1"]
        assert abs(fit.reflectance[1] - 0.5) < min(0.003, 4 * error)


def test_a_fall_off_of_another_shape_shows_by_angle(flat, flat_fit):
    errors = flat_fit.errors_by_angle(flat)
    assert errors.count.sum() == flat_fit.used.sum()
    assert np.all(np.abs(errors.error[1:6]) < 0.01)
    beyond = np.arccos(flat.cos_alpha) > np.deg2rad(50)
    brighter = replace(flat, level=flat.level * np.where(beyond, 1.1, 1) ** (1 / 2.2))
    error = calibrate_light(brighter).errors_by_angle(brighter).error
    assert 0.05 < error[5] - error[4] < 0.12


def test_a_frame_without_usable_samples_has_a_gain_of_no_weight(flat, flat_fit):
    level = np.where(flat.frame == 7, 1.0, flat.level)
    fit = calibrate_light(replace(flat, level=level))
    np.testing.assert_array_equal(np.isinf(fit.gain_errors), fit.frames == 7)
    assert abs(fit.k - flat_fit.k) < 3 * flat_fit.standard_errors["k"]


def beside(*places, **how):
    """Samples of lamps at places, of the same joint exponent."""
    return video(count=120, light=TRUTH.with_lamps(places), **how)[0]


@pytest.mark.parametrize(
    ("places", "tolerance"), [([(4, -2)], 0.1), ([(3, 1), (-3, -1)], 0.25)]
)
def test_lamps_beside_the_lens_are_found_and_no_more_than_there_are(places, tolerance):
    """A lamp at the lens in their stead leaves what goes with the side of the picture, or k wrong."""
    samples = beside(*places)
    fit = calibrate_light(samples)
    found = sorted(light.position[:2] for light in fit.photometry.lights)
    off = np.ravel(found) - np.ravel(sorted(places))
    errors = [fit.standard_errors[name] for name in fit.names if "lamp" in name]
    assert np.abs(off).max() < tolerance
    assert np.sqrt(np.mean((off / errors) ** 2)) < 2
    assert abs(fit.k - 2.5) < 0.01
    assert not fit.doubts
    check_residuals(fit, samples)
    centred = calibrate_light(samples, lamps="centre")
    assert abs(centred.k - 2.5) > 0.01
    assert (Doubt.OTHER_PLACE in centred.doubts) is (len(places) == 1)


def test_a_lamp_at_the_lens_stays_there_as_it_was(flat, flat_fit):
    """Two that are sought about it change k by less than the ± that it then has."""
    centred, two = (calibrate_light(flat, lamps=lamps) for lamps in ("centre", "two"))
    assert centred.photometry == flat_fit.photometry
    assert list(flat_fit.held_out)[:2] == ["centre", "one"]
    assert abs(two.k - centred.k) < two.standard_errors["k"]


def test_a_sheet_seen_from_afar_does_not_tell_where_the_lamp_is():
    samples = beside((4, -2), distance=(150.0, 200.0))
    fit, centred = (
        calibrate_light(samples, lamps=lamps) for lamps in ("auto", "centre")
    )
    assert (fit.photometry, Doubt.UNTOLD_PLACE in fit.doubts) == (
        centred.photometry,
        True,
    )
    with pytest.raises(NotIdentifiableError, match="nearer"):
        calibrate_light(samples, lamps="one")
