"""k of a light that is not known: found on scenes that obey the model and on a traced one, or not found."""

from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab.reconstruction.estimate_light import estimate_light
from tests.tools.cases import drawn

FISHEYE = el.load_calibration("paper", width=120).camera
NARROW = el.Pinhole(120, 90, 400.0, 400.0, 59.5, 44.5)  # 9° to the side
TISSUE = el.Lambertian((0.75, 0.38, 0.30))
SCENES = ("curved", "tube", "colon")


def frame_of(scene, k, camera=FISHEYE):
    known = el.Calibration(camera, el.Photometry(k, 2.2, None, TISSUE))
    return drawn(scene, known, noise=1, bits=8).frame


@pytest.fixture(scope="module")
def tube():
    return frame_of("tube", 2.5)


@pytest.fixture(scope="module")
def of_tube(tube):
    return estimate_light([tube], FISHEYE)


@pytest.mark.parametrize("k", [1.0, 2.5])
def test_scenes_of_the_model_tell_k(k):
    """Cavities, seen by a fisheye: each has its least within a half, together they are within 0.3."""
    found = estimate_light([frame_of(scene, k) for scene in SCENES], FISHEYE)
    assert found.k == pytest.approx(k, abs=0.3)
    assert found.photometry == el.Photometry(round(found.k, 2), 2.2, None)
    assert found.interval[0] < k < found.interval[1]
    assert (found.outcome, found.standard_error < 0.45) == ("found", True)
    least = found.exponents[np.argmin(found.costs, axis=1)]
    np.testing.assert_allclose(least, k, atol=0.5)


def test_a_traced_frame_tells_k_though_its_light_bounced():
    sample = el.load_traced("wet-2")
    found = estimate_light([sample.frame], sample.calibration.camera)
    truth = sample.calibration.photometry.simplify()
    assert abs(found.k - truth.k) < 0.6
    assert found.outcome in ("found", "roughly")


def test_a_camera_that_sees_no_fall_finds_nothing():
    frames = [frame_of("colon", 2.5, NARROW)]
    found = estimate_light(frames, NARROW, gamma=2.0)
    assert (found.outcome, found.standard_error > 1) == ("not found", True)
    assert (found.photometry.k, found.photometry.gamma) == (2.5, 2.0)


def test_what_ends_at_the_bound_is_not_found():
    found = estimate_light([frame_of("tube", 6.5)], FISHEYE)
    assert found.costs[0].argmin() == len(found.exponents) - 1
    assert found.outcome == "not found"


def test_a_frame_that_is_given_again_tells_nothing_new(tube, of_tube):
    found = estimate_light([tube] * 2, FISHEYE)
    assert (found.places, of_tube.places) == pytest.approx((1, 1))
    assert (found.k, found.standard_error) == pytest.approx(
        (of_tube.k, of_tube.standard_error)
    )


def test_frames_that_cannot_be_used_are_named(tube, of_tube):
    small = el.Frame(tube.image[:50], tube.mask[:50], "small")
    dark = replace(tube, image=np.zeros_like(tube.image), name="dark")
    grey = replace(tube, image=tube.image[..., 1], name="grey")
    white = np.repeat(tube.image[..., 1:2], 3, axis=2)
    white = replace(tube, image=white, name="white")
    found = estimate_light([small, tube, dark, grey, white], FISHEYE)
    assert list(found.refused) == ["small", "dark", "grey", "white"]
    assert (found.names, found.k) == (("tube",), of_tube.k)
