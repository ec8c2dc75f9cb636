"""The light of an endoscope, measured over surfaces that are known, with the bounced light in the model."""

import numpy as np
import pytest

import endolab as el
from endolab import datasets
from tests.benchmarks.known_surface import measure_light


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


def test_the_light_of_c3vd_is_what_its_frames_tell(data):
    samples = [datasets.read_c3vd(data / "c3vd_trans_t1_a", index) for index in (1, 6)]
    shipped = datasets.load_calibration("c3vd")
    frames = [one.frame for one in samples]
    distances = [one.distance for one in samples]
    light, errors, misfit = measure_light(frames, shipped.camera, distances)
    assert light == shipped.photometry
    evidence = shipped.evidence
    known = evidence["photometry"]["standard_errors"]
    assert errors == pytest.approx(known, abs=6e-4)
    assert misfit == pytest.approx(
        evidence["known_surface"]["misfit_grey_levels"], abs=6e-3
    )
