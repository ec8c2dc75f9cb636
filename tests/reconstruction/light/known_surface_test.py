"""The light of an endoscope, measured over surfaces that are known, with the bounced light in the model."""

import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.io.datasets import load_calibration


@pytest.mark.parametrize("name", ["matt", "diffuse-2", "diffuse-3"])
def test_path_traced_frames_tell_their_light(name):
    """Measured, true 2.5, 2.2 and (.75, .38, .30): k 2.37, 2.33, 2.47, γ 2.35, 2.28, 2.16."""
    sample = el.load_traced(name)
    found = el.measure_light(
        [sample.frame], sample.calibration.camera, [sample.distance]
    )
    light = found.photometry
    error = found.standard_errors
    assert light.k == pytest.approx(2.5, abs=min(2 * error["k"], 0.3))
    assert light.gamma == pytest.approx(2.2, abs=min(2 * error["gamma"], 0.2))
    np.testing.assert_allclose(light.brdf.albedo, (0.75, 0.38, 0.30), atol=0.1)
    assert light.gain is None
    assert found.misfit < 4  # grey levels


def test_a_lamp_that_is_twice_as_bright_has_the_same_light():
    sample = el.load_traced("matt")
    dim = el.Frame(sample.frame.image * 0.8, sample.frame.mask, "dim")
    known = sample.calibration.camera, [sample.distance]
    one, other = (
        el.measure_light([frame], *known).photometry for frame in (sample.frame, dim)
    )
    assert other.k == pytest.approx(one.k, abs=0.1)
    assert other.gamma == pytest.approx(one.gamma, abs=0.1)


def test_the_light_of_c3vd_is_what_its_frames_tell():
    folder = datasets.find_dataset("c3vd")
    if folder is None:
        pytest.skip("C3VD is not here")
    samples = [folder[f"{index:04d}_color.png"] for index in (1, 6)]
    shipped = load_calibration("c3vd")
    errors = shipped.evidence["photometry"]["standard_errors"]
    frames = [one.frame for one in samples]
    distances = [one.distance for one in samples]
    both = el.measure_light(frames, shipped.camera, distances)
    assert both.evidence == shipped.evidence
    assert both.photometry == shipped.photometry
    # The other frame is not needed.
    alone = el.measure_light(frames[:1], shipped.camera, distances[:1])
    assert alone.photometry.k == pytest.approx(shipped.photometry.k, abs=errors["k"])


def test_what_cannot_be_measured_is_one_sentence():
    sample = el.load_traced("matt")
    frame = sample.frame
    distance = sample.distance
    grey = el.Frame(frame.image[..., 0], frame.mask, "one.png")
    for frames, distances, named in (
        ([], [], "frames"),
        ([grey], [distance], "one.png"),
        ([frame], [distance[1:]], "distance"),
        ([frame], [np.full(distance.shape, np.nan)], frame.name),
    ):
        with pytest.raises(ValueError, match=named):
            el.measure_light(frames, sample.calibration.camera, distances)
