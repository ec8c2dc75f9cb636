"""What the samples can tell: accepted where they can, refused by name where they can't, said in words."""

from dataclasses import replace

import numpy as np
import pytest

from endolab.calibration.photometric.fit import calibrate_light
from endolab.calibration.photometric.identifiability import (
    NotIdentifiableError,
    gain_jumps,
)
from endolab.calibration.photometric.samples import Samples
from tests.tools import shooting
from tests.tools.shooting import TRUTH


def video(*given, **how):
    return shooting.video(*given, **how)[0]


def disturbed(samples, seed, distance=0.003, degrees=0.1):
    """Samples whose places are wrong, each in its own way."""
    rng = np.random.default_rng(seed)
    points = samples.points * np.exp(distance * rng.normal(size=(len(samples), 1)))
    normals = samples.normals + np.deg2rad(degrees) / np.sqrt(2) * rng.normal(
        size=samples.normals.shape
    )
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return replace(samples, points=points, normals=normals)


def refused(unknown, samples, *words, **options):
    """Check that this unknown is refused, for a reason that has these words."""
    with pytest.raises(NotIdentifiableError) as caught:
        calibrate_light(samples, **options)
    assert isinstance(caught.value, ValueError)
    assert caught.value.unknown == unknown
    for part in words:
        assert part in str(caught.value)


@pytest.mark.parametrize("seed", range(5))
def test_one_flat_sheet_never_gives_gamma(seed):
    samples = video(count=200, seed=seed)
    for known in (samples, disturbed(samples, seed)):
        refused("gamma", known, "only k/gamma", "fold the sheet", gamma="free")


@pytest.mark.parametrize(("fold", "seed"), [(3, 0), (5, 1), (5, 2), (10, 3)])
def test_a_folded_sheet_gives_gamma(fold, seed):
    samples = video("vicalib_folded", 300, fold=np.deg2rad(fold), seed=seed)
    fit = calibrate_light(samples, gamma="free")
    assert abs(fit.photometry.gamma - 2.2) < 3.5 * fit.standard_errors["gamma"]
    assert fit.verdict[0].startswith("γ = ")
    assert "measured, by the distance within each frame" in fit.verdict[0]
    # Disturbed places raise γ, about as the verdict says for 0.1 %.
    wrong = calibrate_light(disturbed(samples, seed, 0.001, 0.0), gamma="free")
    stated = float(fit.verdict[1].split("raise γ by ")[1].split(",")[0])
    rise = wrong.photometry.gamma - fit.photometry.gamma
    assert abs(rise - stated) < stated + 0.5 * fit.standard_errors["gamma"]


def test_patches_of_unknown_ratio_do_not_give_gamma():
    samples = video("vicalib_grey", 100)
    for ratio in (None, (0.5, 0.3)):
        refused("gamma", samples, gamma="free", reflectance=(ratio,))
    fit = calibrate_light(samples, gamma="free", reflectance=(0.5,))
    assert "the reflectances that are known" in fit.verdict[0]


def test_patches_of_roughly_known_ratio_leave_gamma_as_uncertain():
    """The ratio's error of 2 % is one of log 1.02 / log 0.5 in γ, and nothing else may hide it."""
    samples = video("vicalib_grey", 100)
    for ratio in (0.5, 0.51):
        fit = calibrate_light(samples, gamma="free", reflectance=((ratio, 0.01),))
        expected = fit.photometry.gamma * 0.01 / ratio / abs(np.log(ratio))
        assert abs(fit.standard_errors["gamma"] / expected - 1) < 0.05
        assert abs(fit.photometry.gamma - 2.2) < 1.5 * fit.standard_errors["gamma"]
        assert abs(fit.ratio - 2.5 / 2.2) < 4 * fit.standard_errors["k/gamma"] < 0.02
        assert abs(fit.reflectance[1] - ratio) < 1e-4


def test_a_prior_on_gamma_stays_as_wide_where_the_samples_know_nothing():
    samples = video()
    given = calibrate_light(samples, gamma=2.1)
    fit = calibrate_light(samples, gamma=(2.1, 0.1))
    assert abs(fit.photometry.gamma - 2.1) < 1e-3
    np.testing.assert_allclose(fit.standard_errors["gamma"], 0.1, rtol=1e-3)
    np.testing.assert_allclose(fit.standard_errors["k"], 0.1 * given.ratio, rtol=0.02)
    np.testing.assert_allclose(
        fit.standard_errors["k/gamma"], given.standard_errors["k/gamma"], rtol=0.1
    )
    assert fit.correlation[fit.names.index("gamma"), 0] > 0.99
    assert "the samples add nothing to that" in fit.verdict[0]


def test_a_prior_on_gamma_joins_what_the_samples_know():
    samples = video("vicalib_folded", 100, fold=np.deg2rad(20))
    free = calibrate_light(samples, gamma="free")
    own = free.standard_errors["gamma"]
    fit = calibrate_light(samples, gamma=(2.2, own))
    np.testing.assert_allclose(
        fit.standard_errors["gamma"], own / np.sqrt(2), rtol=0.03
    )
    np.testing.assert_allclose(
        fit.photometry.gamma, (free.photometry.gamma + 2.2) / 2, atol=0.1 * own
    )


def test_frontal_frames_do_not_give_k_unless_the_sheet_is_matt_but_one_distance_does():
    samples = video(tilt=0.0)
    refused("k", samples, "tilt the sheet")
    refused("k", video(tilt=np.deg2rad(1)))
    fit = calibrate_light(samples, brdf="lambertian")
    assert any("taken to be matt" in sentence for sentence in fit.verdict)
    assert (
        calibrate_light(video(count=300, tilt=np.deg2rad(5))).standard_errors["k"]
        < 0.04
    )
    fit = calibrate_light(video(distance=(50.0, 50.0)))
    assert abs(fit.photometry.k - 2.5) < 4 * fit.standard_errors["k"] < 0.03


def test_a_single_frame_and_too_few_samples_are_refused_by_name():
    samples = video()
    refused("k", samples[samples.frame == 10], "single frame")
    refused(
        "k", video(count=3, per_frame=12, seed=1), "36 samples of 3 frames", nodes=4
    )


def test_one_incidence_angle_does_not_give_a_brdf(rng):
    rays = rng.normal(size=(300, 3)) * [0.4, 0.4, 0.0] + [0, 0, 1]
    points = 40 * rays / np.linalg.norm(rays, axis=1, keepdims=True)
    level = TRUTH.intensity(points, -points / 40) * 3000 ** (1 / 2.2)
    samples = Samples(
        np.repeat(np.arange(3), 100), level, points, -points / 40, np.zeros(300, int)
    )
    refused("brdf", samples)


def test_unknowns_at_their_bounds_are_refused():
    samples = video(
        "vicalib_folded", fold=0.6, outliers=0.0, light=replace(TRUTH, k=0.5)
    )
    brighter = replace(samples, level=samples.level * samples.cos_alpha ** (-0.8 / 2.2))
    refused("k", brighter, "below 0")
    steep = video("vicalib_folded", fold=0.6, light=replace(TRUTH, gamma=6.0))
    refused("gamma", steep, "out of 0.5 to 5", gamma="free")


def shine(samples, lamp, exposed="each"):
    """Samples lit otherwise: `lamp` gives the linear light of some; each frame, or all, well exposed."""
    light = lamp(samples)
    rng = np.random.default_rng(0)
    groups = samples.frame if exposed == "each" else np.zeros(len(samples), int)
    bright = np.array(
        [np.percentile(light[groups == group], 80) for group in range(groups.max() + 1)]
    )
    level = (0.5 * light / bright[groups]) ** (1 / 2.2) + rng.normal(
        0, 3 / 255, len(samples)
    )
    return replace(samples, level=np.clip(level, 0.0, 1.0))


def torch(*place):
    """A lamp at a place beside the lens, mm."""

    def lamp(samples):
        offset = samples.points - place
        reach = np.linalg.norm(offset, axis=1)
        facing = -np.einsum("ni,ni->n", offset, samples.normals) / reach
        return np.maximum(facing, 0.02) / reach**2

    return lamp


def window(samples):
    return np.maximum(samples.normals @ [0.5, -0.6, -0.62], 0.05)


def half_a_room(samples):
    lamp = torch(0, 0, 0)(samples) * samples.cos_alpha**2.5
    return lamp + np.median(lamp)


ROOMS = {
    "even light": lambda samples: np.ones(len(samples)),
    "even light, a lens that darkens its rim": lambda samples: samples.cos_alpha**3,
    "a window": window,
    "a lamp in the room": torch(300, -250, -100),
    "as much of the room as of the lamp": half_a_room,
    "a torch": torch(0, 40, 0),
}


@pytest.mark.parametrize("brdf", ["tabulated", "lambertian"])
@pytest.mark.parametrize("target", ["vicalib_big", "vicalib_folded"])
@pytest.mark.parametrize("name", ROOMS)
def test_light_that_is_no_endoscopes_is_refused(name, target, brdf):
    fold = {"fold": np.deg2rad(20)} if target == "vicalib_folded" else {}
    samples = shine(video(target, 40, **fold), ROOMS[name])
    refused("light", samples, "lamp at the lens", brdf=brdf)


def test_light_of_a_room_under_a_locked_exposure_is_refused():
    refused("light", shine(video(count=40), ROOMS["even light"], "all"), "lit room")


@pytest.mark.parametrize("k", [0.1, 1.0, 4.0])
def test_a_lamp_at_the_lens_is_accepted_whatever_its_beam(k):
    fit = calibrate_light(
        shine(video(), lambda seen: torch(0, 0, 0)(seen) * seen.cos_alpha**k)
    )
    assert abs(fit.k - k) < 4 * fit.standard_errors["k"]


def test_some_light_of_the_room_is_named():
    def lamp(samples):
        own = torch(0, 0, 0)(samples) * samples.cos_alpha**2.5
        return own + 0.3 * np.median(own)

    fit = calibrate_light(shine(video(count=40), lamp))
    assert any("another light" in sentence for sentence in fit.verdict)
    assert not any(
        "another light" in sentence
        for sentence in calibrate_light(video(count=40)).verdict
    )


def test_residuals_that_no_lamp_at_the_lens_leaves_are_refused():
    samples = video(count=100)
    stains = np.random.default_rng(1).normal(0, 25 / 255, len(samples))
    refused("light", replace(samples, level=samples.level + stains), "25 grey levels")


def test_jumps_stand_out_from_fast_but_smooth_motion():
    frames = np.arange(0, 200, 2)
    gains = np.exp(1.2 * np.sin(frames / 9))
    assert gain_jumps(frames, gains) == []
    gains = gains * np.where(frames >= 120, 1.9, 1.0) * np.where(frames == 40, 3.0, 1.0)
    found = gain_jumps(frames, gains)
    assert {frame for frame, _ in found} == {40, 42, 120}
    assert found[-1][0] == 120
    assert abs(found[-1][1] / 1.9 - 1) < 0.3
    assert gain_jumps(frames[:4], gains[:4]) == []
