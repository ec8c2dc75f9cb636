"""Numbers that no endoscope has are refused where they come in."""

from dataclasses import replace

import pytest

import endolab as el
from endolab.model.brdf import Glossy, Lambertian, TabulatedBRDF
from endolab.model.lights import SpotLight

PAPER = el.load_calibration("paper")
C3VD = el.load_calibration("c3vd").camera


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: Lambertian((0.5, 1e-300, 0.5)), "albedo"),
        (lambda: el.Photometry(k=1e300), "k"),
        (lambda: el.Photometry(gamma=1e-300), "gamma"),
        (lambda: el.Photometry(gain=1e-320), "gain"),
        (lambda: TabulatedBRDF((0, 1), (0.3, 1e-300)), "value"),
        (lambda: Glossy(0.5, 1e300), "specular"),
        (lambda: SpotLight(position=(0, 1e300, 0)), "position"),
        (lambda: SpotLight(direction=(0, 0, 1e-320)), "direction"),
        (lambda: SpotLight(weight=1e-320), "weight"),
        (lambda: el.Pinhole(9, 9, 1e-320, 5, 4, 4), "fx"),
        (lambda: replace(PAPER.camera, k=(1e300, 0, 0, 0)), "distortion"),
        (lambda: replace(C3VD, a=(769, 0, 1e300, 0, 0)), "a"),
        (lambda: replace(C3VD, c=1e-320, d=0.0), "c - d·e"),
    ],
)
def test_absurd_numbers_are_refused_without_a_warning(make, name):
    with pytest.raises(ValueError, match=rf"^{name} must"):
        make()
