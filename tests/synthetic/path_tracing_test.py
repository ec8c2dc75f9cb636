"""Path tracing: against the renderer, against closed forms, and what it says without Mitsuba."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from endolab.model.brdf import Glossy, Lambertian
from endolab.model.cameras import KannalaBrandt, Pinhole
from endolab.model.lights import SpotLight
from endolab.model.photometry import Photometry
from endolab.synthetic.mucosa import film_radiance, rippled, tissue
from endolab.synthetic.path_tracing import trace
from endolab.synthetic.rendering import VEIL, render
from endolab.synthetic.scenes import SCENES, Bowl, Colon, Plane

CAMERA = Pinhole(40, 30, 20.0, 20.0, 19.5, 14.5)
TISSUE = Lambertian((0.75, 0.38, 0.30))
ONE = Photometry(k=2.5, gamma=2.2, gain=3000.0, brdf=TISSUE)
AROUND = [(3.5 * np.cos(a), 3.5 * np.sin(a), 0.0) for a in (0.0, 2.1, 4.2)]
THREE = replace(ONE, k=0.5, lights=tuple(SpotLight(place, exponent=2.0) for place in AROUND))


def averaged(scene, camera, photometry):
    """Direct light of the general model, averaged over 4x4 places in each pixel."""
    high, wide = camera.height, camera.width
    fine = render(scene, camera.resize(4 * wide, 4 * high), photometry).image ** photometry.gamma
    return fine.reshape(high, 4, wide, 4, 3).mean(axis=(1, 3))


@pytest.mark.parametrize("name", SCENES)
def test_direct_light_is_the_renderers(mitsuba, name):
    made = trace(SCENES[name], CAMERA, ONE, bounces=0, samples=16)
    expected = render(SCENES[name], CAMERA, ONE)
    ratio = made.direct[made.mask] / averaged(SCENES[name], CAMERA, ONE)[made.mask]
    assert np.median(ratio) == pytest.approx(1, abs=1e-3)
    # The colon's folds are edges of a mesh here, and throw shadows, which the general model does not know.
    assert np.mean(np.abs(ratio - 1) < 0.03) > (0.9 if name == "colon" else 0.97)
    assert not made.indirect.any()
    assert not made.mirrored.any()
    assert_array_equal(made.distance, expected.distance)
    assert_array_equal(made.normals, expected.normals)
    assert_allclose(made.image, np.clip(made.direct ** (1 / 2.2), 0, 1))


def test_direct_light_of_three_lights_with_vignetting_on_a_fisheye(mitsuba):
    fisheye = KannalaBrandt(48, 36, 23.9, 23.9, 24.0, 18.0, (-0.139, -1.2e-3, 9e-4, -4e-5))
    made = trace(Bowl(), fisheye, THREE, bounces=0, samples=16)
    expected = render(Bowl(), fisheye, THREE)
    assert_array_equal(made.mask, expected.mask)
    inside = made.mask & (fisheye.field.cos_alpha > np.cos(np.deg2rad(80)))  # whole pixels
    ratio = made.direct[inside] / averaged(Bowl(), fisheye, THREE)[inside]
    assert np.median(ratio) == pytest.approx(1, abs=1e-3)
    assert np.mean(np.abs(ratio - 1) < 0.03) > 0.97


def test_fog_takes_light_on_both_ways_and_leaves_a_veil(mitsuba):
    clear, foggy = (trace(Bowl(), CAMERA, ONE, bounces=0, samples=16, fog=fog) for fog in (0.0, 0.01))
    left = np.exp(-0.01 * clear.distance)[..., None]
    assert_allclose(foggy.direct, clear.direct * left**2, rtol=5e-3)
    assert_allclose(foggy.image**2.2, foggy.direct + VEIL * (1 - left), rtol=1e-6)


@pytest.mark.parametrize("albedo", [0.3, 0.7])
def test_an_integrating_sphere(mitsuba, albedo):
    """Inside a sphere the indirect irradiance is the same everywhere: E ρ/(1 - ρ), E the mean direct one."""
    lamp = Photometry(k=0.0, gamma=1.0, gain=1.0, brdf=Lambertian(albedo))  # lights the front half
    for centre in ((0.0, 0.0, 0.0), (30.0, -20.0, -40.0)):
        made = trace(Bowl(100.0, centre), CAMERA, lamp, bounces=60, samples=64, mesh_size=60)
        received = np.pi * made.indirect.mean() / albedo
        # A light of unit intensity sends 2π into the half space, over 4π R².
        expected = 2 * np.pi / (4 * np.pi * 100.0**2) * albedo / (1 - albedo)
        assert received == pytest.approx(expected, rel=0.01)
        assert made.indirect.std() < 0.12 * made.indirect.mean()  # 64 paths' noise


def test_each_bounce_adds_its_power_of_the_albedo(mitsuba):
    lamp = Photometry(k=0.0, gamma=1.0, gain=1.0, brdf=Lambertian(0.5))
    unit = 0.5 / np.pi / (2 * 100.0**2)
    sphere = Bowl(100.0, (0.0, 0.0, 0.0))
    for bounces, sum_of_powers in ((1, 0.5), (2, 0.75), (3, 0.875)):
        made = trace(sphere, CAMERA, lamp, bounces=bounces, samples=64, mesh_size=60)
        assert made.indirect.mean() == pytest.approx(unit * sum_of_powers, rel=0.01)


def test_a_plane_cannot_light_itself(mitsuba):
    assert not trace(Plane(), CAMERA, ONE, samples=16, mesh_size=60).indirect.any()


def test_in_a_colon_red_gains_most_and_nothing_gains_energy(mitsuba):
    made = trace(Colon(), CAMERA, ONE, samples=32, mesh_size=150)
    gained = np.nanmedian(made.indirect[made.mask] / made.direct[made.mask], axis=0)
    assert gained[0] > 2 * gained[1] > 2 * gained[2]
    # No wall of albedo ρ can hold more than the closed one does: what the lamp sends, ρ/(1 - ρ) times.
    assert np.all(gained < 1 / (1 - np.array(TISSUE.albedo)))
    assert_allclose(gained, np.expm1([0.78, 0.25, 0.19]), rtol=0.12)


def test_a_light_aside_throws_shadows_that_the_model_does_not_know(mitsuba):
    aside = replace(ONE, k=0.0, lights=(SpotLight((10.0, 0.0, 0.0)),))
    seen = Pinhole(80, 60, 40.0, 40.0, 39.5, 29.5)
    made, model = trace(Colon(), seen, aside, bounces=0, samples=16), render(Colon(), seen, aside)
    dark = made.mask & (made.direct[..., 1] == 0) & (model.image[..., 1] > 0)
    assert 0.01 < dark.mean() < 0.5
    assert np.all(made.direct.sum(axis=-1) <= 1.5 * model.image.sum(axis=-1).max() ** 2.2)
    from_points = made.distance[dark][:, None] * seen.field.rays[dark]
    way = np.array([10.0, 0.0, 0.0]) - from_points
    reach = np.linalg.norm(way, axis=-1)
    # The scene itself agrees: from the light, another wall comes first.
    steps = np.linspace(0.02, 0.98, 60)
    inside = [Colon()._inside(*(from_points + t * way + Colon._camera).T)[0] for t in steps]
    assert np.mean(np.min(inside, axis=0) < 1e-3 * reach) > 0.9


def test_film_mirrors_in_a_layer_of_its_own(mitsuba):
    dry, wet = (trace(Colon(), CAMERA, THREE, bounces=0, samples=16, film=film) for film in (0.0, 0.025))
    assert_array_equal(dry.direct, wet.direct)
    assert (wet.mirrored > 0.05).any()
    assert np.mean(wet.mirrored > 0.2 * wet.direct[..., 1]) < 0.5
    assert_allclose(wet.image, np.clip((wet.direct + wet.mirrored[..., None]) ** (1 / 2.2), 0, 1), atol=1e-12)


def mirrored_share(roughness, film=1.0):
    """What a wall sends one way, straight out, of light that comes alike from everywhere."""
    points, normals = np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 0.0, -1.0]])
    theta = np.pi / 2 * (np.arange(1000) + 0.5) ** 2 / 1000**2  # dense about the mirror's way
    sent = []
    for angle in theta:
        way = np.array([np.sin(angle), 0.0, -np.cos(angle)])
        lamp = SpotLight(tuple(points[0] + 1e3 * way), tuple(-way))
        sent.append(1e6 * film_radiance(points, normals, lamp, film, roughness)[0])
    return 2 * np.pi * np.trapezoid(np.array(sent) * np.sin(theta), theta)


def test_a_sheen_mirrors_the_lamps_without_highlights(mitsuba):
    how = {"bounces": 0, "samples": 16}
    wet, rough = (trace(Colon(), CAMERA, THREE, **how, **film) for film in ({"film": 0.04}, {"sheen": 0.04}))
    assert_array_equal(rough.direct, wet.direct)
    share = [(one.mirrored / np.maximum(one.direct[..., 1], 1e-9))[one.mask] for one in (wet, rough)]
    assert np.percentile(share[1], 99.9) < 0.2 * np.percentile(share[0], 99.9)
    # At most what a wall does that faces a lamp beside the lens: F / (4 α²) for the ρ that it scatters.
    assert 0.5 < share[1].max() / (0.04 / (4 * 0.5**4) / 0.38) < 1.1
    assert np.median(share[1]) > 0.002


@pytest.mark.parametrize("roughness", [0.4, 0.7])
def test_a_sheen_mirrors_other_walls(mitsuba, roughness):
    """In a sphere that is lit alike all over, so much of what it sends as of light from everywhere."""
    both = tuple(SpotLight(direction=(0.0, 0.0, way)) for way in (1.0, -1.0))
    lamps = Photometry(k=0.0, gamma=1.0, gain=1.0, brdf=Lambertian(0.5), lights=both)
    how = {"bounces": 40, "samples": 64, "mesh_size": 60, "roughness": roughness}
    matt, rough = (trace(Bowl(100.0, (0.0, 0.0, 0.0)), CAMERA, lamps, sheen=one, **how) for one in (0.0, 1.0))
    assert_array_equal(matt.direct, rough.direct)
    gained = (rough.indirect - matt.indirect).mean() / (matt.direct + matt.indirect).mean()
    assert gained == pytest.approx(mirrored_share(roughness), rel=0.02)


@pytest.mark.parametrize("roughness", [0.15, 0.4, 0.7])
def test_film_mirrors_no_more_than_arrives(roughness):
    """All that a film sends one way, over all ways the light may come, is at most 1."""
    # Facets steeper than 45° send it into the wall, and others hide one another.
    most = 1 / (1 + roughness**4)
    assert (0.97 if roughness < 0.5 else 0.85) * most < mirrored_share(roughness) <= most
    assert 0.025 < mirrored_share(roughness, 0.025) / mirrored_share(roughness) < 0.04


def test_ripples_and_tissue():
    points = np.random.default_rng(1).uniform(-40, 40, (5000, 3))
    normals = np.broadcast_to([0.0, 0.0, -1.0], points.shape)
    tilt = np.rad2deg(np.arccos(-rippled(points, normals)[:, 2]))
    assert 5 < np.median(tilt) < 15
    mean = np.array(TISSUE.albedo)
    plain, textured = tissue(points, mean, 0.0, 0.0), tissue(points, mean, 0.1, 0.0, seed=3)
    assert_array_equal(plain, np.broadcast_to(mean, points.shape))
    assert_allclose(np.log(textured / mean).std(axis=0), [0.06, 0.1, 0.1], rtol=0.25)
    veined = np.log(tissue(points, mean, 0.0, 0.35) / mean)
    assert veined.max() <= 0
    assert veined[:, 1].min() == pytest.approx(-0.35, abs=0.01)
    assert 0.02 < np.mean(veined[:, 1] < -0.1) < 0.4
    stained = np.log(tissue(points, mean, 0.0, 0.0, stains=0.5) / mean)
    assert_allclose(stained.min(axis=0), [-0.15, -0.35, -0.5], atol=1e-3)
    assert 0.03 < np.mean(stained[:, 2] < -0.25) < 0.25


def test_the_seed_decides_and_progress_is_told(mitsuba):
    told = []
    options = {"texture": 0.1, "noise": 2.0, "bits": 8, "samples": 4, "bounces": 2, "mesh_size": 60}
    first = trace(Colon(), CAMERA, ONE, seed=1, progress=told.append, **options)
    again, other = (trace(Colon(), CAMERA, ONE, seed=seed, **options) for seed in (1, 2))
    assert_array_equal(first.image, again.image)
    assert (first.image != other.image).any()
    assert_allclose(255 * first.image, np.round(255 * first.image), atol=1e-9)
    assert told == sorted(told)
    assert told[-1] == pytest.approx(1)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"fog": -1.0}, "fog must be finite and at least 0, got -1.0"),
        ({"film": np.nan}, "film must be finite"),
        ({"stains": -1.0}, "stains must be finite and at least 0"),
        ({"roughness": 0.1}, "roughness must be from 0.2 to 1, got 0.1"),
        ({"sheen": 1.5}, "sheen must be at most 1, got 1.5"),
        ({"bounces": -1}, "bounces must be finite and at least 0"),
        ({"samples": 0}, "samples must be from 1 to"),
        ({"bits": 0}, "bits must be from 1 to 16, got 0"),
        ({"seed": 1.5}, "seed must be a whole number of at least 0, got 1.5"),
        ({"bits": 17}, "bits must be from 1 to 16, got 17"),
    ],
)
def test_options_out_of_range(options, sentence):
    with pytest.raises(ValueError, match=sentence):
        trace(Colon(), CAMERA, ONE, **options)


@pytest.mark.parametrize("brdf", [Glossy(0.3, 0.02, 300.0), Lambertian(1.0), Lambertian((0.5, 1.0, 0.5))])
def test_surfaces_that_cannot_be_traced(brdf):
    with pytest.raises(ValueError, match="a Lambertian surface of albedos below 1"):
        trace(Colon(), CAMERA, replace(ONE, brdf=brdf))


def test_without_mitsuba_one_sentence_names_the_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    with pytest.raises(OSError, match=r"python -m pip install .mitsuba>=3\.9.") as caught:
        trace(Colon(), CAMERA, ONE)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("backend", "version"), [(False, (0, 0, 0)), (True, (15, 0, 6))])
def test_without_a_usable_llvm_one_sentence_names_the_command(mitsuba, monkeypatch, backend, version):
    import drjit

    monkeypatch.setattr(drjit, "has_backend", lambda kind: backend)
    monkeypatch.setattr(drjit.detail, "llvm_version", lambda: version)
    with pytest.raises(OSError, match="apt install libllvm19"):
        trace(Colon(), CAMERA, ONE)
