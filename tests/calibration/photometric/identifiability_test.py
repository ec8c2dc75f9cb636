"""What the samples can tell: accepted where they can, refused by name where they can't, said in words."""

from dataclasses import replace

import numpy as np
import pytest

from endolab.calibration.photometric.fit import calibrate_light
from endolab.calibration.refusals import Doubt, NotIdentifiableError
from tests.tools import shooting
from tests.tools.shooting import TRUTH


def video(*given, **how):
    return shooting.video(*given, **how)[0]


def disturbed(samples, seed):
    """Samples whose places are wrong, each in its own way, by 0.3 % and 0.1°."""
    rng = np.random.default_rng(seed)
    points = samples.points * np.exp(0.003 * rng.normal(size=(len(samples), 1)))
    normals = samples.normals + np.deg2rad(0.07) * rng.normal(
        size=samples.normals.shape
    )
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return replace(samples, points=points, normals=normals)


def refused(unknown, samples, word=None, **options):
    """Check that this unknown is refused, for a reason that has the word."""
    with pytest.raises(NotIdentifiableError, match=word) as caught:
        calibrate_light(samples, **options)
    assert caught.value.unknown == unknown


@pytest.mark.parametrize("seed", range(5))
def test_one_flat_sheet_never_gives_gamma(seed):
    samples = video(count=200, seed=seed)
    for known in (samples, disturbed(samples, seed)):
        refused("gamma", known, "fold the sheet", gamma="free")


@pytest.mark.parametrize(("fold", "seed"), [(3, 0), (5, 1), (5, 2), (10, 3)])
def test_a_folded_sheet_gives_gamma(fold, seed):
    samples = video("vicalib_folded", 300, fold=np.deg2rad(fold), seed=seed)
    fit = calibrate_light(samples, gamma="free")
    assert abs(fit.photometry.gamma - 2.2) < 3.5 * fit.standard_errors["gamma"]


@pytest.mark.parametrize("ratio", [None, (0.5, 0.3)])
def test_patches_of_unknown_ratio_do_not_give_gamma(ratio):
    refused("gamma", video("vicalib_grey"), gamma="free", reflectance=(ratio,))


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
    errors = fit.standard_errors
    np.testing.assert_allclose(errors["gamma"], 0.1, rtol=1e-3)
    np.testing.assert_allclose(errors["k"], 0.1 * given.ratio, rtol=0.02)
    expected = given.standard_errors["k/gamma"]
    np.testing.assert_allclose(errors["k/gamma"], expected, rtol=0.1)


def test_a_prior_on_gamma_joins_what_the_samples_know():
    samples = video("vicalib_folded", 100, fold=np.deg2rad(20))
    free = calibrate_light(samples, gamma="free")
    own = free.standard_errors["gamma"]
    fit = calibrate_light(samples, gamma=(2.2, own))
    assert fit.standard_errors["gamma"] == pytest.approx(own / np.sqrt(2), rel=0.03)
    middle = (free.photometry.gamma + 2.2) / 2
    assert fit.photometry.gamma == pytest.approx(middle, abs=0.1 * own)


def test_frontal_frames_do_not_give_k_unless_the_sheet_is_matt_but_one_distance_does():
    samples = video(tilt=0.0)
    refused("k", samples, "tilt the sheet")
    refused("k", video(tilt=np.deg2rad(1)))
    calibrate_light(samples, brdf="lambertian")
    for enough in (video(count=300, tilt=np.deg2rad(5)), video(distance=(50.0, 50.0))):
        fit = calibrate_light(enough)
        assert abs(fit.k - 2.5) < 4 * fit.standard_errors["k"] < 0.16


def test_too_few_samples_are_refused_by_name():
    refused("k", video(count=3, per_frame=8, seed=3), "24 samples", nodes=4)


def test_unknowns_at_their_bounds_are_refused():
    samples = video(
        "vicalib_folded", fold=0.6, outliers=0.0, light=replace(TRUTH, k=0.5)
    )
    brighter = replace(samples, level=samples.level * samples.cos_alpha ** (-0.8 / 2.2))
    refused("k", brighter, "it is -")
    steep = video("vicalib_folded", fold=0.6, light=replace(TRUTH, gamma=6.0))
    refused("gamma", steep, "ran to 5|ran to 6", gamma="free")


def shine(samples, lamp):
    """Samples lit otherwise, each frame well exposed: `lamp` gives the linear light of some."""
    light = lamp(samples)
    rng = np.random.default_rng(0)
    frames = [light[samples.frame == n] for n in range(samples.frame.max() + 1)]
    bright = np.array([np.percentile(one, 80) for one in frames])
    level = (0.5 * light / bright[samples.frame]) ** (1 / 2.2)
    level = level + rng.normal(0, 3 / 255, len(samples))
    return replace(samples, level=np.clip(level, 0.0, 1.0))


def torch(*place, k=0.0):
    """A lamp at a place beside the lens, mm, of a beam cosᵏ α."""

    def lamp(samples):
        offset = samples.points - place
        reach = np.linalg.norm(offset, axis=1)
        facing = -np.einsum("ni,ni->n", offset, samples.normals) / reach
        return np.maximum(facing, 0.02) / reach**2 * samples.cos_alpha**k

    return lamp


def window(samples):
    return np.maximum(samples.normals @ [0.5, -0.6, -0.62], 0.05)


def room(share, k=2.5):
    """An endoscope's lamp, and so much of its light from elsewhere."""

    def lamp(samples):
        own = torch(0, 0, 0, k=k)(samples)
        return own + share * np.median(own)

    return lamp


ROOMS = {
    "even light": lambda samples: np.ones(len(samples)),
    "even light, a lens that darkens its rim": lambda samples: samples.cos_alpha**3,
    "a window": window,
    "a lamp in the room": torch(300, -250, -100),
    "as much of the room as of the lamp": room(1.0),
    "a torch": torch(0, 40, 0),
}


@pytest.mark.parametrize("brdf", ["tabulated", "lambertian"])
@pytest.mark.parametrize("target", ["vicalib_big", "vicalib_folded"])
@pytest.mark.parametrize("name", ROOMS)
def test_light_that_is_no_endoscopes_is_refused(name, target, brdf):
    fold = {"fold": np.deg2rad(20)} if target == "vicalib_folded" else {}
    refused("light", shine(video(target, 40, **fold), ROOMS[name]), "lamp", brdf=brdf)


@pytest.mark.parametrize(
    ("k", "share"), [(0.1, 0.0), (1.0, 0.0), (4.0, 0.0), (2.5, 0.3)]
)
def test_a_lamp_at_the_lens_is_accepted_and_some_light_of_the_room_is_named(k, share):
    fit = calibrate_light(shine(video(), room(share, k)))
    assert (Doubt.OTHER_LIGHT in fit.doubts) is (share > 0)
    assert share or abs(fit.k - k) < 4 * fit.standard_errors["k"]


def test_residuals_that_no_lamp_at_the_lens_leaves_are_refused():
    samples = video(count=100)
    stains = np.random.default_rng(1).normal(0, 25 / 255, len(samples))
    refused("light", replace(samples, level=samples.level + stains), r"2\d grey levels")
