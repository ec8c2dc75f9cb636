"""Path tracing: against the renderer, and against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from endolab.model.brdf import Lambertian
from endolab.model.cameras import Pinhole
from endolab.model.lights import SpotLight
from endolab.model.photometry import Photometry
from endolab.synthetic.rendering import render
from endolab.synthetic.scenes import Bowl, Colon, Plane
from tests.tools.mucosa import film_radiance
from tests.tools.path_tracing import trace

CAMERA = Pinhole(40, 30, 20.0, 20.0, 19.5, 14.5)
ONE = Photometry(k=2.5, gamma=2.2, gain=3000.0, brdf=Lambertian((0.75, 0.38, 0.30)))
AROUND = [(3.5 * np.cos(a), 3.5 * np.sin(a), 0.0) for a in (0.0, 2.1, 4.2)]
THREE = replace(
    ONE, k=0.5, lights=tuple(SpotLight(place, exponent=2.0) for place in AROUND)
)
SPHERE = Bowl(100.0, (0.0, 0.0, 0.0))


@pytest.mark.parametrize("light", [ONE, THREE])
@pytest.mark.parametrize("scene", [Bowl(), Colon()])
def test_direct_light_is_the_renderers(mitsuba, scene, light):
    made = trace(scene, CAMERA, light, bounces=0, samples=16)
    fine = render(scene, CAMERA.resize(160, 120), light).image ** light.gamma
    ratio = (made.direct / fine.reshape(30, 4, 40, 4, 3).mean(axis=(1, 3)))[made.mask]
    assert np.median(ratio) == pytest.approx(1, abs=1e-3)
    # The colon's folds are edges of a mesh here, and throw shadows, which the general model does not know.
    assert np.mean(np.abs(ratio - 1) < 0.03) > (0.85 if isinstance(scene, Colon) else 0.97)
    assert not made.indirect.any()
    assert not made.mirrored.any()


@pytest.mark.parametrize("albedo", [0.3, 0.7])
def test_an_integrating_sphere(mitsuba, albedo):
    """Inside a sphere the indirect irradiance is the same everywhere: E ρ/(1 - ρ), E the mean direct one."""
    # Lights the front half.
    lamp = Photometry(k=0.0, gamma=1.0, gain=1.0, brdf=Lambertian(albedo))
    made = trace(SPHERE, CAMERA, lamp, bounces=60, samples=64, mesh_size=60)
    expected = 2 * np.pi / (4 * np.pi * 100.0**2) * albedo / (1 - albedo)
    assert np.pi * made.indirect.mean() / albedo == pytest.approx(expected, rel=0.01)


def test_a_plane_cannot_light_itself(mitsuba):
    assert not trace(Plane(), CAMERA, ONE, samples=16, mesh_size=60).indirect.any()


def mirrored_share(roughness):
    """What a wall sends one way, straight out, of light that comes alike from everywhere."""
    points = np.array([[0.0, 0.0, 1.0]])
    normals = np.array([[0.0, 0.0, -1.0]])
    # Dense about the mirror's way.
    theta = np.pi / 2 * (np.arange(1000) + 0.5) ** 2 / 1000**2
    sent = []
    for angle in theta:
        way = np.array([np.sin(angle), 0.0, -np.cos(angle)])
        lamp = SpotLight(tuple(points[0] + 1e3 * way), tuple(-way))
        sent.append(1e6 * film_radiance(points, normals, lamp, 1.0, roughness)[0])
    return 2 * np.pi * np.trapezoid(np.array(sent) * np.sin(theta), theta)


@pytest.mark.parametrize("roughness", [0.4, 0.7])
def test_a_sheen_mirrors_other_walls(mitsuba, roughness):
    """In a sphere that is lit alike all over, so much of what it sends as of light from everywhere."""
    both = tuple(SpotLight(direction=(0.0, 0.0, way)) for way in (1.0, -1.0))
    lamps = Photometry(k=0.0, gamma=1.0, gain=1.0, brdf=Lambertian(0.5), lights=both)
    how = {"bounces": 40, "samples": 64, "mesh_size": 60, "roughness": roughness}
    matt, rough = (trace(SPHERE, CAMERA, lamps, sheen=one, **how) for one in (0.0, 1.0))
    assert_array_equal(matt.direct, rough.direct)
    gained = (rough.indirect - matt.indirect).mean() / (matt.direct + matt.indirect).mean()
    assert gained == pytest.approx(mirrored_share(roughness), rel=0.02)
    assert mirrored_share(roughness) < 1
