"""The photometric model: its two forms against one another, scaling laws."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

import endolab as el
from endolab.model.brdf import Glossy, Lambertian, TabulatedBRDF
from endolab.model.lights import SpotLight

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


def surface(rng, max_slant=70.0):
    """Random points in front of the camera and normals, with distance, slant angle and cos α."""
    points = rng.uniform([-40, -40, 20], [40, 40, 90], (60, 3))
    distance = np.linalg.norm(points, axis=-1)
    view = -points / distance[:, None]
    side = np.cross(view, rng.normal(size=(60, 3)))
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    theta = np.deg2rad(rng.uniform(3, max_slant, 60))
    normals = np.cos(theta)[:, None] * view + np.sin(theta)[:, None] * side
    return points, normals, distance, theta, points[:, 2] / distance


def model(brdf=BRDFS["matt"], lights=(), k=2.5):
    return el.Photometry(k, 2.2, 3000.0, brdf, lights)


@pytest.mark.parametrize("brdf", BRDFS.values(), ids=BRDFS)
def test_simplified_is_the_general_model_with_the_light_at_the_centre(rng, brdf):
    points, normals, distance, theta, cos_alpha = surface(rng)
    f = brdf.value(np.cos(theta), np.cos(theta))
    by_hand = (cos_alpha**2.5 / distance**2 * f * np.cos(theta) * 3000) ** (1 / 2.2)
    seen = model(brdf).attenuation(cos_alpha)
    simplified = model(brdf).brightness(np.log(distance), np.tan(theta) ** 2, seen)
    assert_allclose(simplified, by_hand, rtol=1e-12)
    split = model(brdf, (SpotLight(exponent=1.6),), k=0.9)
    for general in (model(brdf), split):  # the exponent can be the light's or the lens'
        assert_allclose(general.intensity(points, normals), by_hand, rtol=1e-12)
    assert split.simplify().k == pytest.approx(2.5)


def test_far_away_the_lights_become_one(rng):
    """The error falls like offset/distance: ten times as far, about a tenth."""
    same = {"direction": (0, 0, 1), "exponent": 1.4}
    general = model(lights=tuple(replace(light, **same) for light in THREE_LIGHTS))
    simplified = general.simplify()
    assert simplified.lights == ()
    assert simplified.gain == pytest.approx(3000 * 1.2)
    points, normals, distance, _, _ = surface(rng, max_slant=50.0)
    errors = []
    for far in (50.0, 500.0, 5000.0):
        x = far * points / distance[:, None]
        ratio = general.intensity(x, normals) / simplified.intensity(x, normals)
        errors.append(np.abs(np.log(ratio)).max())
    assert np.all(np.diff(np.log(errors)) < -np.log(8))
    assert errors[2] < 1e-3


def test_the_grey_channel_is_the_grey_of_the_channels(rng):
    """As OpenCV mixes it; on the stored values, whatever the geometry."""
    colour = model(Lambertian((0.75, 0.38, 0.30)))
    place = surface(rng)[:2]
    rgb = [colour.channel(name).intensity(*place) for name in ("red", "green", "blue")]
    rgb = np.stack(rgb, axis=-1)[None].astype(np.float32)
    expected = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)[0]
    assert_allclose(colour.channel("grey").intensity(*place), expected, rtol=1e-5)


@pytest.mark.parametrize("name", ["table", "glossy"])
def test_the_slant_table_inverts_the_brightness(name):
    brdf = BRDFS[name]
    log_c, log_slant = model(brdf).slant_table()
    cosine = np.cos(np.deg2rad(np.linspace(0, 88, 500)))
    c = cosine * brdf.value(cosine, cosine) / brdf.value(1.0, 1.0)
    found = np.interp(np.log(c), log_c, log_slant)
    assert_allclose(found, -2 * np.log(cosine), rtol=0, atol=1e-4)


def test_one_brightness_must_not_have_two_slants():
    rising = TabulatedBRDF((0.0, 0.5, 0.6, 1.5), (0.2, 0.2, 0.4, 0.4))
    with pytest.raises(ValueError, match=r"(29|30|31|32|33|34)°"):
        model(rising).slant_table()
