"""The light of an endoscope, measured over surfaces that are known, with the bounced light in the model."""

from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from tests.research.known_surface import measure_light
from tests.tools.cases import drawn

DARK = (0.06, 0.05, 0.04)  # albedos of a wall from which hardly anything bounces


@pytest.mark.parametrize("name", ["matt", "diffuse-2", "diffuse-3"])
def test_path_traced_frames_tell_their_light(name):
    """Measured, true 2.5, 2.2 and (.75, .38, .30): k 2.37, 2.33, 2.47, γ 2.35, 2.28, 2.16."""
    sample = el.load_traced(name)
    camera = sample.calibration.camera
    light, error, misfit = measure_light([sample.frame], camera, [sample.distance])
    assert light.k == pytest.approx(2.5, abs=min(2 * error["k"], 0.3))
    assert light.gamma == pytest.approx(2.2, abs=min(2 * error["gamma"], 0.2))
    np.testing.assert_allclose(light.brdf.albedo, (0.75, 0.38, 0.30), atol=0.1)
    assert misfit < 4  # grey levels
    light, error, misfit = measure_light([sample.frame], camera, [sample.distance], 1)
    x, y, _ = light.lights[0].position  # true: the lens
    assert abs(x) < 2 * error["lamp 1 x"]
    assert abs(y) < 2 * error["lamp 1 y"]
    assert light.simplify().k == pytest.approx(2.5, abs=0.3)


def test_a_lamp_beside_the_lens_is_found():
    """Measured, true (4, -2) mm and 1.5: (3.9, -1.9) and 1.51; with one at the lens k is 2.6 for 2.5."""
    light = el.Photometry(2.5, brdf=el.Lambertian(DARK)).with_lamps([(4, -2)])
    tube = drawn("tube", "simple", 320, light)
    camera = tube.calibration.camera
    found, _, misfit = measure_light([tube.frame], camera, [tube.distance], 1)
    np.testing.assert_allclose(found.lights[0].position, (4, -2, 0), atol=0.3)
    assert found.k == pytest.approx(1.5, abs=0.1)
    assert misfit < 1  # grey level


def test_the_light_of_c3vd_is_what_its_frames_tell(data):
    samples = list(el.datasets.open_dataset(data / "c3vd_trans_t1_a"))
    shipped = el.load_calibration("c3vd")
    frames = [one.frame for one in samples]
    distances = [one.distance for one in samples]
    light, errors, misfit = measure_light(frames, shipped.camera, distances, 1)
    assert light.k == pytest.approx(shipped.photometry.k, abs=1e-9)
    assert replace(light, k=shipped.photometry.k) == shipped.photometry
    evidence = shipped.evidence
    known = evidence["photometry"]["standard_errors"]
    assert errors == pytest.approx(known, abs=6e-4)
    assert misfit == pytest.approx(
        evidence["known_surface"]["misfit_grey_levels"], abs=6e-3
    )
    usual = np.nanmedian(np.concatenate([part.ravel() for part in distances]))
    assert round(usual, 1) == evidence["photometry"]["usual_distance"]
    of_the_second = el.load_calibration("c3vd_v2")
    assert of_the_second.photometry == shipped.photometry
