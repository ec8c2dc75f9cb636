"""The photometric model: derivatives, its two forms against one another, scaling laws."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from endolab.model.brdf import Glossy, Lambertian, TabulatedBRDF
from endolab.model.lights import SpotLight
from endolab.model.photometry import Photometry

BRDFS = {
    "matt": Lambertian(0.6),
    "table": TabulatedBRDF((0.0, 0.31, 0.77, 1.1, 1.5), (0.33, 0.30, 0.24, 0.20, 0.11)),
    "glossy": Glossy(0.6, 0.05, 30.0),
}
THREE_LIGHTS = (
    SpotLight((4.0, 1.0, -0.5), (0.1, 0.0, 1.0), 1.2, 0.5),
    SpotLight((-3.0, 2.0, 0.0), (0.0, -0.2, 1.0), 0.8, 0.3),
    SpotLight((0.5, -4.0, 0.3), (0.0, 0.1, 1.0), 2.0, 0.4),
)
every_brdf = pytest.mark.parametrize("brdf", BRDFS.values(), ids=BRDFS.keys())
every_light = pytest.mark.parametrize(
    "lights", [(), THREE_LIGHTS], ids=["centred", "three lights"]
)


def surface(rng, count=60, max_slant=70.0):
    """Random points in front of the camera and normals, with distance, slant angle and cos α."""
    points = rng.uniform([-40, -40, 20], [40, 40, 90], (count, 3))
    distance = np.linalg.norm(points, axis=-1)
    view = -points / distance[:, None]
    side = np.cross(view, rng.normal(size=(count, 3)))
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    theta = np.deg2rad(rng.uniform(3, max_slant, count))
    normals = np.cos(theta)[:, None] * view + np.sin(theta)[:, None] * side
    return points, normals, distance, theta, points[:, 2] / distance


def slope(function, h):
    """Central difference at 0."""
    return (function(h) - function(-h)) / (2 * h)


def model(brdf=BRDFS["matt"], lights=(), k=2.5, gamma=2.2, gain=3000.0):
    return Photometry(k, gamma, gain, brdf, lights)


@every_brdf
def test_derivatives_of_the_simplified_model(rng, brdf):
    photometry = model(brdf)
    _, _, distance, theta, cos_alpha = surface(rng)
    v = np.log(distance)
    p = np.tan(theta) ** 2
    stored, by_v, by_p = photometry.shade(v, p, cos_alpha)
    assert_array_equal(
        photometry.brightness(v, p, photometry.attenuation(cos_alpha)), stored
    )
    assert_allclose(
        by_v, slope(lambda h: photometry.shade(v + h, p, cos_alpha)[0], 1e-6), rtol=1e-7
    )
    steps = 1e-6 * (1 + p)
    assert_allclose(
        by_p,
        slope(lambda h: photometry.shade(v, p + h, cos_alpha)[0], steps),
        rtol=2e-5,
    )


@every_brdf
def test_simplified_is_the_general_model_with_the_light_at_the_centre(rng, brdf):
    points, normals, distance, theta, cos_alpha = surface(rng)
    general = model(brdf).intensity(points, normals)
    simplified = model(brdf).shade(np.log(distance), np.tan(theta) ** 2, cos_alpha)[0]
    f = brdf.value(np.cos(theta), np.cos(theta))
    by_hand = (cos_alpha**2.5 / distance**2 * f * np.cos(theta) * 3000) ** (1 / 2.2)
    assert_allclose(general, by_hand, rtol=1e-12)
    assert_allclose(simplified, by_hand, rtol=1e-12)


@every_brdf
def test_the_exponent_can_be_the_lights_or_the_lens(rng, brdf):
    points, normals, *_ = surface(rng)
    joint = model(brdf, k=2.5)
    split = model(brdf, (SpotLight(exponent=1.6),), k=0.9)
    assert_allclose(
        split.intensity(points, normals), joint.intensity(points, normals), rtol=1e-12
    )
    assert split.simplify().k == pytest.approx(2.5)


def test_far_away_the_lights_become_one(rng):
    """The error falls like offset/distance: ten times as far, about a tenth."""
    lights = tuple(
        replace(light, direction=(0, 0, 1), exponent=1.4) for light in THREE_LIGHTS
    )
    general = model(lights=lights)
    simplified = general.simplify()
    assert simplified.lights == ()
    assert simplified.gain == pytest.approx(3000 * 1.2)
    points, normals, distance, _, _ = surface(rng, max_slant=50.0)
    far = [d * points / distance[:, None] for d in (50.0, 500.0, 5000.0)]
    errors = [
        np.log(general.intensity(x, normals) / simplified.intensity(x, normals))
        for x in far
    ]
    errors = np.abs(errors).max(axis=1)
    assert np.all(errors[1:] < errors[:-1] / 8)
    assert errors[2] < 1e-3


@every_brdf
@every_light
def test_inverse_squares(rng, brdf, lights):
    """Everything twice as large, lights included: a quarter of the light, before the response."""
    points, normals, *_ = surface(rng)
    grown = tuple(
        replace(light, position=tuple(2 * np.array(light.position))) for light in lights
    )
    small = model(brdf, lights)
    large = model(brdf, grown)
    ratio = large.intensity(2 * points, normals) / small.intensity(points, normals)
    assert_allclose(ratio, 2 ** (-2 / 2.2), rtol=1e-12)


def test_canonical_intensity_is_cosine_over_square(rng):
    points, normals, distance, theta, cos_alpha = surface(rng)
    canonical = model().canonical(model().intensity(points, normals), cos_alpha)
    assert_allclose(canonical, np.cos(theta) / distance**2, rtol=1e-12)


def test_the_grey_channel_is_the_grey_of_the_channels(rng):
    """BT.601, as OpenCV mixes it; on the stored values, whatever the geometry."""
    colour = model(Lambertian((0.75, 0.38, 0.30)))
    points, normals, *_ = surface(rng)
    rgb = [
        colour.channel(name).intensity(points, normals)
        for name in ("red", "green", "blue")
    ]
    expected = 0.299 * rgb[0] + 0.587 * rgb[1] + 0.114 * rgb[2]
    grey = colour.channel("grey").intensity(points, normals)
    assert_allclose(grey, expected, rtol=1e-12)
    by_opencv = cv2.cvtColor(
        np.stack(rgb, axis=-1)[None].astype(np.float32), cv2.COLOR_RGB2GRAY
    )[0]
    assert_allclose(grey, by_opencv, rtol=1e-5)


@pytest.mark.parametrize(
    "brdf", [BRDFS["table"], BRDFS["glossy"]], ids=["table", "glossy"]
)
def test_the_slant_table_inverts_the_brightness(brdf):
    log_c, log_slant = model(brdf).slant_table()
    theta = np.deg2rad(np.linspace(0, 88, 500))
    cosine = np.cos(theta)
    c = cosine * brdf.value(cosine, cosine) / brdf.value(1.0, 1.0)
    assert_allclose(
        np.interp(np.log(c), log_c, log_slant), -2 * np.log(cosine), rtol=0, atol=1e-4
    )


def test_a_matt_surface_needs_no_table_and_one_brightness_must_not_have_two_slants():
    assert model().slant_table() is None
    rising = TabulatedBRDF((0.0, 0.5, 0.6, 1.5), (0.2, 0.2, 0.4, 0.4))
    with pytest.raises(ValueError, match=r"(29|30|31|32|33|34)°"):
        model(rising).slant_table()
