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
from endolab.calibration.simulation.video import PAPER_SHEET
from tests.tools.shooting import video


def everything_free(rng):
    """A model with every kind of unknown, and a place to look at it."""
    samples, _ = video("vicalib_grey", 6, per_frame=40, noise=0.0)
    samples = replace(samples, slack=rng.normal(0, 0.01, (len(samples), 2)))
    nodes = place_nodes(np.arccos(samples.cos_theta), 5)
    known = [None, (2.0, 0.2), *[None] * len(nodes), 0.0, (np.log(0.5), 0.2)]
    known[4] = -1.2
    model = LightModel(samples, samples.frame, nodes, tuple(known), (0.05, 0.9))
    brdf = rng.normal(-1.0, 0.3, len(nodes))
    vector = np.concatenate([[2.1, 1.9], brdf, [0.0, -0.6]])
    own = np.column_stack([rng.normal(8, 0.3, 6), rng.normal(size=(6, 2))])
    return model, model.unknowns(vector, own)


def test_every_derivative_agrees_with_finite_differences(rng):
    model, unknowns = everything_free(rng)
    lin = model.linearise(unknowns)
    assert lin.by_common.shape == (len(model.samples), 1, model.free.sum())
    still = np.zeros(model.free.sum()), np.zeros((6, 3))

    def slopes(number, index):
        """Of residuals and priors, by one of the common or of the own unknowns."""
        ends = []
        for step in (-1e-6, 1e-6):
            moved = [steps.copy() for steps in still]
            moved[number][index] = step
            ends.append(model.linearise(model.take_step(unknowns, *moved)))
        before, after = ends
        return (
            (after.residual - before.residual) / 2e-6,
            (after.prior - before.prior) / 2e-6,
        )

    close = {"rtol": 2e-5, "atol": 2e-5}
    for i in range(model.free.sum()):
        by_residual, by_prior = slopes(0, i)
        np.testing.assert_allclose(lin.by_common[..., i], by_residual, **close)
        np.testing.assert_allclose(lin.prior_by_common[:, i], by_prior, 1e-6, 1e-8)
    for frame, own in np.ndindex(6, 3):
        by_residual, _ = slopes(1, (frame, own))
        expected = np.where(model.group[:, None] == frame, lin.by_own[..., own], 0.0)
        np.testing.assert_allclose(expected, by_residual, **close)


def test_the_model_is_that_of_photometry(rng):
    model, unknowns = everything_free(rng)
    surface = el.TabulatedBRDF(tuple(model.nodes), tuple(np.exp(unknowns.log_brdf)))
    photometry = el.Photometry(unknowns.k, unknowns.gamma, 1.0, surface)
    samples = model.samples
    factor = np.sum(model.own_columns * unknowns.own[samples.frame], axis=1)
    factor += unknowns.log_reflectance[samples.material]
    level = photometry.intensity(samples.points, samples.normals)
    level = level * np.exp(factor / unknowns.gamma)
    np.testing.assert_allclose(model.predict(unknowns), GREY_LEVELS * level, rtol=1e-12)


def predicted(fit, samples):
    """Grey levels that a calibration expects."""
    level = replace(fit.photometry, gain=1.0).intensity(samples.points, samples.normals)
    light = fit.gains[np.searchsorted(fit.frames, samples.frame)]
    light = light * fit.reflectance[samples.material]
    return GREY_LEVELS * level * light ** (1 / fit.photometry.gamma)


def test_a_flat_sheet_gives_k_and_the_brdf_when_gamma_is_given():
    samples, gains = video(count=200, seed=3)
    fit = calibrate_light(samples)
    assert fit.status is el.Status.CONVERGED
    assert abs(fit.k - 2.5) < 0.01
    assert fit.ratio == fit.k / 2.2
    assert abs(fit.sigma - np.hypot(3, 12**-0.5)) < 0.05
    assert abs(fit.mean) < 0.03
    cosine = np.cos(np.linspace(0.1, 1.2, 50))
    brdf = fit.photometry.brdf.value(cosine, cosine) / PAPER_SHEET.value(cosine, cosine)
    assert np.std(brdf / brdf.mean()) < 0.006
    scale = fit.gains / gains
    assert np.std(scale / scale.mean()) < 0.008
    np.testing.assert_allclose(scale.mean() * brdf.mean(), 1.0, atol=0.01)


def pulls_of(fit):
    """Errors of k and γ, in standard errors."""
    off = {"k": fit.k - 2.5, "gamma": fit.photometry.gamma - 2.2}
    off["k/gamma"] = fit.ratio - 2.5 / 2.2
    return [value / fit.standard_errors[name] for name, value in off.items()]


def test_standard_errors_are_honest():
    draws = []
    for seed in range(30):
        samples, _ = video("vicalib_folded", 30, fold=np.deg2rad(40), seed=seed)
        draws.append(pulls_of(calibrate_light(samples, gamma="free", nodes=8)))
    pulls = np.sqrt(np.mean(np.square(draws), axis=0))
    assert np.all((pulls > 0.65) & (pulls < 1.4)), pulls  # 30 draws: ± 13 %


def moved_planes(samples, size, rng):
    """Samples on planes that are a little wrong, of each panel in each frame, with how wrong they may be."""
    points = samples.points.copy()
    normals = samples.normals.copy()
    slack = np.zeros((len(samples), 6))
    for frame in np.unique(samples.frame):
        for panel, normal in enumerate(
            np.unique(samples.normals[samples.frame == frame], axis=0)
        ):
            on = (samples.frame == frame) & np.all(samples.normals == normal, axis=1)
            plane = normal / np.mean(samples.points[on] @ normal)
            errors = size * np.linalg.norm(plane) * np.eye(3)
            plane = plane + errors @ rng.normal(size=3)
            points[on] /= (points[on] @ plane)[:, None]
            normals[on] = -plane / np.linalg.norm(plane)
            change = 3 * points[on] @ errors - plane @ errors / (plane @ plane)
            slack[on, 3 * panel : 3 * panel + 3] = change
    return replace(samples, points=points, normals=normals, slack=slack)


def test_errors_of_the_poses_count_in_the_standard_errors():
    draws = []
    for seed in range(12):
        samples, _ = video(
            "vicalib_folded", 60, fold=np.deg2rad(30), seed=seed, outliers=0.0
        )
        wrong = moved_planes(samples, 0.004, np.random.default_rng(seed))
        blind = replace(wrong, slack=np.zeros((0, 0)))
        fits = [
            calibrate_light(known, gamma="free", nodes=8) for known in (wrong, blind)
        ]
        draws.append([pulls_of(fit)[:2] for fit in fits])
    honest, proud = np.sqrt(np.mean(np.square(draws), axis=0))
    assert np.all((honest > 0.5) & (honest < 1.5)), honest  # 12 draws: ± 20 %
    assert np.all(proud > 1.4 * honest), (honest, proud)


def test_outliers_change_next_to_nothing():
    clean, _ = video(count=60, outliers=0.0)
    wild = np.random.default_rng(5).random(len(clean)) < 0.1
    level = np.where(wild, np.random.default_rng(6).random(len(clean)), clean.level)
    fits = [calibrate_light(replace(clean, level=level)), calibrate_light(clean)]
    assert abs(fits[0].k - fits[1].k) < 2 * fits[1].standard_errors["k"]
    assert abs(fits[0].sigma / fits[1].sigma - 1) < 0.03
    assert not fits[0].used[wild & (np.abs(level - clean.level) > 0.1)].any()


def test_saturation_is_told_by_the_predicted_level():
    errors = []
    levels = (24 / 255, 225 / 255)
    for seed in range(4):
        samples, _ = video(
            "vicalib_folded", fold=0.7, outliers=0.0, noise=6.0, seed=seed
        )
        measured = samples[(samples.level > levels[0]) & (samples.level < levels[1])]
        ways = (samples, levels), (measured, (1e-3, 2.0)), (samples, (1e-3, 2.0))
        errors.append(
            [calibrate_light(chosen, levels=ends).k - 2.5 for chosen, ends in ways]
        )
    by_predicted, by_measured, by_none = np.mean(errors, axis=0)
    assert abs(by_predicted) < 0.006
    assert by_measured < -0.009
    assert by_none < -0.03


@pytest.fixture(scope="module")
def flat():
    return video(count=60, seed=4)[0]


@pytest.fixture(scope="module")
def flat_fit(flat):
    return calibrate_light(flat)


def test_units_of_length_only_scale_the_gains_and_the_order_of_frames_plays_no_part(
    flat, flat_fit
):
    fit = calibrate_light(replace(flat, points=flat.points / 1000))
    np.testing.assert_allclose(fit.gains, flat_fit.gains / 1e6, rtol=1e-6)
    np.testing.assert_allclose(fit.k, flat_fit.k, rtol=1e-7)
    others = (
        getattr(flat, name)[::-1] for name in ("level", "points", "normals", "material")
    )
    fit = calibrate_light(Samples((1000 - 7 * flat.frame)[::-1], *others))
    np.testing.assert_allclose(fit.k, flat_fit.k, rtol=1e-7)
    np.testing.assert_allclose(fit.gains[::-1], flat_fit.gains, rtol=1e-6)
    np.testing.assert_array_equal(fit.frames[::-1], 1000 - 7 * flat_fit.frames)


def test_prediction_and_residuals_belong_together(flat, flat_fit):
    residuals = GREY_LEVELS * flat.level - predicted(flat_fit, flat)
    np.testing.assert_allclose(residuals, flat_fit.residuals, rtol=0, atol=1e-9)
    errors = flat_fit.standard_errors
    np.testing.assert_allclose(errors["k"] ** 2, flat_fit.covariance[0, 0])
    np.testing.assert_allclose(errors["k/gamma"], errors["k"] / 2.2)


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"gamma": 0.2}, "gamma"),
        ({"gamma": (2.2, 0.0)}, "gamma"),
        ({"brdf": "shiny"}, "brdf"),
        ({"levels": (0.9, 0.1)}, "levels"),
        ({"reflectance": (0.5,)}, "reflectance"),
    ],
)
def test_bad_options_and_samples_are_refused(flat, options, name):
    with pytest.raises(ValueError, match=name):
        calibrate_light(flat, **options)
    with pytest.raises(ValueError, match="samples"):
        calibrate_light(replace(flat, level=np.full(len(flat), np.nan)))


def test_a_locked_gain_is_one_number_and_gives_gamma():
    samples, _ = video(count=80, locked=True)
    fit = calibrate_light(samples, gamma="free", gain="locked")
    assert abs(fit.photometry.gamma - 2.2) < 0.01
    assert abs(fit.k - 2.5) < 0.02
    np.testing.assert_array_equal(
        fit.gains, np.full(len(fit.frames), fit.photometry.gain)
    )
    expected = GREY_LEVELS * samples.level - predicted(fit, samples)
    np.testing.assert_allclose(expected, fit.residuals, atol=1e-9)
    assert "One gain was fitted for all frames." in fit.verdict


def test_grey_patches_of_known_ratio_give_gamma_and_a_given_gamma_measures_them():
    samples, _ = video("vicalib_grey", 150)
    fit = calibrate_light(samples, gamma="free", reflectance=(0.5,))
    assert abs(fit.photometry.gamma - 2.2) < 0.015
    expected = GREY_LEVELS * samples.level - predicted(fit, samples)
    np.testing.assert_allclose(expected, fit.residuals, atol=1e-9)
    samples, _ = video("vicalib_grey", 60)
    for known in (None, (0.51, 0.01)):
        fit = calibrate_light(samples, reflectance=(known,))
        error = fit.standard_errors["reflectance 1"]
        assert abs(fit.reflectance[1] - 0.5) < min(0.003, 4 * error)


def test_held_out_frames_are_predicted(flat_fit):
    other, _ = video(count=100, seed=77)
    score = flat_fit.score_held_out(other)
    assert score.error.shape == score.standard_error.shape == score.count.shape == (9,)
    assert 0.9 * len(other) < score.count.sum() < len(other)
    assert abs(score.sigma - 3.01) < 0.1
    assert np.all(np.abs(score.error[1:6]) < 0.01)
    # A wrong fall-off shows: k is 0.2 too large, so μ′ is cos^-0.2 α too small.
    wrong = replace(
        flat_fit, photometry=replace(flat_fit.photometry, k=flat_fit.k + 0.2)
    )
    error = wrong.score_held_out(other).error
    step = np.log1p(error[5]) - np.log1p(error[0])
    assert 0.04 < step < -0.2 * np.log(np.cos(np.deg2rad(60)))
    with pytest.raises(ValueError, match="some within the range"):
        flat_fit.score_held_out(other[:0])


def test_a_frame_without_usable_samples_has_a_gain_of_no_weight(flat, flat_fit):
    level = np.where(flat.frame == 7, 1.0, flat.level)
    fit = calibrate_light(replace(flat, level=level))
    np.testing.assert_array_equal(np.isinf(fit.gain_errors), fit.frames == 7)
    assert abs(fit.k - flat_fit.k) < 3 * flat_fit.standard_errors["k"]
