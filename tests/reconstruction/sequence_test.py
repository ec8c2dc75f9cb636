"""Frames of a video: each from the last, their scales linked, broken ones skipped."""

import numpy as np
import pytest

import endolab as el
from endolab.reconstruction.sequence import reconstruct_sequence
from endolab.synthetic.scenes import Bowl, Colon, Plane
from tests.tools.films import UNKNOWN, filmed, moved_colon, moved_tube
from tests.tools.problems import relit

COUNT = 8
KNOWN = relit(UNKNOWN, gain=900.0)
WAYS = {
    "bowl": [Bowl(centre=(40 - 1.5 * t, -23 + t, -52 - 2 * t)) for t in range(COUNT)],
    "tube": [moved_tube(t) for t in range(COUNT)],
    "colon": [moved_colon(t) for t in range(COUNT)],
}


def named(seen):
    return [(f"f{k}", one.frame.image) for k, one in enumerate(seen)]


@pytest.mark.parametrize("way", WAYS)
def test_gains_that_double_are_told_from_a_camera_that_moves(way):
    """Alone, the frames' scales would differ by up to √2 or more; linked they agree within 6 %."""
    gains = 900 * 2 ** (0.5 - 0.5 * np.cos(np.pi * np.arange(COUNT) / (COUNT - 1)))
    seen = filmed(WAYS[way], gains)
    steps = list(reconstruct_sequence(named(seen), UNKNOWN))
    assert all(step.error == "" and not step.result.metric for step in steps)
    scales = [
        np.nanmedian(a.distance / b.result.distance)
        for a, b in zip(seen, steps, strict=True)
    ]
    np.testing.assert_allclose(scales / scales[0], 1, atol=0.06)
    found = np.array([step.result.problem.photometry.gain for step in steps])
    np.testing.assert_allclose(found / found[0], gains / gains[0], rtol=0.13)


def test_the_first_frames_median_fixes_the_scale_of_all():
    seen = filmed(WAYS["tube"], (900, 950, 1000))
    median = float(np.median(seen[0].distance))
    for calibration in (UNKNOWN, KNOWN):
        steps = list(
            reconstruct_sequence(named(seen), calibration, median_distance=median)
        )
        assert all(step.result.metric for step in steps)
        assert np.median(
            steps[0].result.distance[steps[0].result.mask]
        ) == pytest.approx(median, rel=0.01)
    moved = np.median(steps[2].result.distance) / median
    assert abs(moved - 1) > 1e-3  # and not each frame's own


def test_a_start_from_the_last_is_as_good_as_a_cold_one():
    seen = filmed(WAYS["colon"], [900] * COUNT)
    warm = list(reconstruct_sequence(named(seen), KNOWN))
    assert [step.warm for step in warm] == [False] + [True] * (COUNT - 1)
    for step, one in zip(warm, seen, strict=True):
        cold = one.solve()
        assert step.result.energy <= 1.05 * cold.energy
        assert step.result.status.is_done


def test_a_still_of_a_grey_endoscope_stays_where_it_is():
    """Three equal channels are one, for warm starts too; once the second came out 1.6 times as far."""
    sample = el.load_traced("diffuse-1")
    grey = sample.frame.channel("grey")[1]
    frames = [("1", grey), ("2", grey[..., None].repeat(3, axis=-1))]
    steps = reconstruct_sequence(frames, sample.calibration, width=160)
    first, second = (step.result.distance for step in steps)
    assert np.nanmedian(second / first) == pytest.approx(1, abs=1e-3)


def test_a_cut_in_the_film_is_begun_again():
    scenes = [Plane(85, 20), Plane(84, 20), Colon(), moved_colon(1)]
    seen = filmed(scenes, [900] * 4)
    steps = list(reconstruct_sequence(named(seen), KNOWN))
    assert steps[2].result.energy <= 1.001 * seen[2].solve().energy


def test_what_cannot_be_used_is_named_and_skipped():
    seen = named(filmed(WAYS["tube"], [900] * 3))
    small = np.full((10, 12), 0.5)
    lost = ValueError("lost: half of it is missing")
    frames = [("lost", lost), seen[0], ("small", small), seen[1]]
    steps = list(reconstruct_sequence(frames, KNOWN))
    assert [step.result is None for step in steps] == [True, False, True, False]
    assert steps[0].error == str(lost)
    assert "small is 12x10 px, but the calibration is for 96x72 px" in steps[2].error
    assert steps[3].warm


def test_a_stop_ends_it():
    seen = named(filmed(WAYS["tube"], [900] * 3))
    steps = list(reconstruct_sequence(seen, KNOWN, observers=[lambda iterate: True]))
    assert [(step.name, step.result.status) for step in steps] == [
        ("f0", el.Status.STOPPED)
    ]
