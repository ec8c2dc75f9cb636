"""Path tracing: against the renderer, and against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab.synthetic.scenes import Bowl, Colon, Plane

CAMERA = el.Pinhole(40, 30, 20.0, 20.0, 19.5, 14.5)
ONE = el.Photometry(
    k=2.5, gamma=2.2, gain=3000.0, brdf=el.Lambertian((0.75, 0.38, 0.30))
)
AROUND = [(3.5 * np.cos(a), 3.5 * np.sin(a), 0.0) for a in (0.0, 2.1, 4.2)]
THREE = replace(
    ONE, k=0.5, lights=tuple(el.SpotLight(place, exponent=2.0) for place in AROUND)
)
SPHERE = Bowl(100.0, (0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def trace():
    """The path tracer; it needs Mitsuba, an optional extra, and an LLVM that is new enough."""
    missing = (ImportError, OSError)
    return pytest.importorskip("tests.research.path_tracing", exc_type=missing).trace


@pytest.mark.parametrize("light", [ONE, THREE])
@pytest.mark.parametrize("scene", [Bowl(), Colon()])
def test_direct_light_is_the_renderers(trace, scene, light):
    made = trace(scene, CAMERA, light, bounces=0, samples=16)
    fine = el.render(scene, CAMERA.resize(160, 120), light).image ** light.gamma
    ratio = (made.direct / fine.reshape(30, 4, 40, 4, 3).mean(axis=(1, 3)))[made.mask]
    assert np.median(ratio) == pytest.approx(1, abs=1e-3)
    # The colon's folds are edges of a mesh here, and throw shadows, which the general model does not know.
    assert np.mean(np.abs(ratio - 1) < 0.03) > (
        0.85 if isinstance(scene, Colon) else 0.97
    )
    assert not made.indirect.any()
    assert not made.mirrored.any()


@pytest.mark.parametrize("albedo", [0.3, 0.7])
def test_an_integrating_sphere(trace, albedo):
    """Inside a sphere the indirect irradiance is the same everywhere: E ρ/(1 - ρ), E the mean direct one."""
    # Lights the front half.
    lamp = el.Photometry(k=0.0, gamma=1.0, gain=1.0, brdf=el.Lambertian(albedo))
    made = trace(SPHERE, CAMERA, lamp, bounces=60, samples=64, mesh_size=60)
    expected = 2 * np.pi / (4 * np.pi * 100.0**2) * albedo / (1 - albedo)
    assert np.pi * made.indirect.mean() / albedo == pytest.approx(expected, rel=0.01)


def test_a_plane_cannot_light_itself(trace):
    assert not trace(Plane(), CAMERA, ONE, samples=16, mesh_size=60).indirect.any()
