"""Rendered frames: true to the model, and each imperfection does what it says and no more."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import endolab as el
from endolab.model.brdf import Lambertian, TabulatedBRDF
from endolab.synthetic.scenes import SCENES

CAMERA = el.Pinhole(160, 120, 100.0, 100.0, 79.5, 59.5)
WIDE = el.KannalaBrandt(101, 101, 25.0, 25.0, 50.0, 50.0, (0.01, 0.0, 0.0, 0.0))
GREY = el.Photometry(k=2.5, gamma=2.2, gain=700.0, brdf=Lambertian(0.5))
COLOUR = replace(GREY, brdf=Lambertian((0.75, 0.38, 0.30)))
LIGHTS = (
    el.SpotLight((3.0, 0.0, 0.0), exponent=1.0),
    el.SpotLight((-1.0, 2.0, 0.0), (0.1, 0.0, 1.0)),
)
TABLE = TabulatedBRDF((0.0, 0.5, 1.5), (0.3, 0.25, 0.1))


def curved(photometry=COLOUR, **options):
    return el.render(SCENES["curved"], CAMERA, photometry, **options)


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize(
    "changed",
    [{}, {"lights": LIGHTS}, {"brdf": TABLE}, {"gamma": 1.0, "gain": 100.0}],
    ids=["centred", "two lights", "table", "linear"],
)
def test_a_clean_frame_is_the_model_at_the_truth(name, changed):
    photometry = replace(GREY, **changed)
    frame = el.render(SCENES[name], CAMERA, photometry)
    points = frame.distance[..., None] * CAMERA.field.rays
    expected = np.minimum(photometry.intensity(points, frame.normals), 1.0)
    assert frame.photometry == photometry
    assert frame.mask.all()
    assert_allclose(frame.image, expected, rtol=1e-12)


def test_a_fisheye_sees_to_its_side_but_no_light_falls_behind():
    """Beyond 90° off the axis the model is dark: such pixels are not in the mask."""
    frame = el.render(SCENES["tube"], WIDE, COLOUR)
    assert 0.3 < frame.mask.mean() < 0.7
    assert_array_equal(frame.mask, WIDE.field.cos_alpha > 0)
    assert_array_equal(frame.mask, (frame.image > 0).all(axis=-1))
    assert not frame.image[~frame.mask].any()
    assert_array_equal(np.isfinite(frame.distance), frame.mask)
    assert np.isnan(frame.normals[~frame.mask]).all()


@pytest.mark.parametrize(
    "brdf", [Lambertian(0.5), Lambertian((0.3, 0.75, 0.38))], ids=["grey", "colour"]
)
@pytest.mark.parametrize(
    "options", [{}, {"texture": 0.2, "highlights": 0.02}], ids=["clean", "wet"]
)
def test_an_unknown_gain_exposes_the_frame_well(brdf, options):
    """The 99th percentile of the brightest channel is at 0.9, and the gain is told."""
    frame = curved(replace(GREY, brdf=brdf, gain=None), **options)
    brightest = np.atleast_3d(frame.image).max(axis=-1)
    assert np.percentile(brightest, 99) == pytest.approx(0.9, rel=1e-3)
    again = curved(frame.photometry, **options)
    assert_allclose(again.image, frame.image, rtol=1e-12)


@pytest.mark.parametrize("noise", [1.0, 4.0])
def test_noise_has_the_asked_for_strength(noise):
    clean = curved().image
    noisy = curved(noise=noise).image
    assert noisy.min() >= 0
    calm = ((clean > 0.1) & (clean < 0.9)).all(axis=-1)
    grey = 255 * (noisy - clean)[calm]
    assert grey.size > 15000
    assert grey.std() == pytest.approx(noise, rel=0.015)
    assert_allclose(np.corrcoef(grey.T), np.eye(3), atol=0.05)
    assert abs(grey.mean()) < 4 * noise / np.sqrt(grey.size)


def test_texture_is_a_mottled_albedo():
    """The logarithm of the light changes alike in all channels."""
    ratio = np.log(curved(texture=0.1).image / curved().image)
    assert_allclose(ratio, ratio[..., [1, 2, 0]], rtol=0, atol=1e-12)


def test_highlights_are_white_few_and_near_the_mirror_direction():
    clean = curved()
    wet = curved(highlights=0.02)
    added = wet.image**2.2 - clean.image**2.2
    assert added.min() > -1e-12
    unclipped = wet.image.max(axis=-1) < 1
    assert unclipped.mean() > 0.5
    white = added[unclipped]
    assert_allclose(white, white[:, [1, 2, 0]], rtol=1e-6, atol=1e-12)
    facing = -np.einsum("hwi,hwi->hw", clean.normals, CAMERA.field.rays)
    glint = added[..., 2] > 0.02
    assert 0.001 < glint.mean() < 0.3
    assert facing[glint].min() > 0.85
