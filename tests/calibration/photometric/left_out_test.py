"""Every sample that does not count has one reason, and every place of the sheet one fate."""

import numpy as np
import pytest

import endolab as el
from endolab.calibration.photometric.left_out import (
    BRIGHTER,
    BY_HAND,
    COUNTS,
    DARK,
    DARKER,
    SATURATED,
    places_by_fate,
    reasons,
    why_left_out,
)
from endolab.calibration.photometric.samples import sample_sheet
from endolab.calibration.simulation.video import PAPER_SHEET, simulate_samples
from endolab.datasets import load_calibration
from tests.tools.simulated_session import simulated

CAMERA = load_calibration("paper", width=480).camera


@pytest.mark.parametrize(
    ("measured", "expected", "used", "reason"),
    [
        (100, 101, True, COUNTS),
        (255, 300, False, SATURATED),
        (20, 300, False, SATURATED),  # what it should be decides, whatever it is
        (3, 5, False, DARK),
        (200, 5, False, DARK),
        (150, 100, False, BRIGHTER),
        (50, 100, False, DARKER),
        (100, np.nan, False, BY_HAND),
        (239, 239.9, False, SATURATED),  # on the border when the fit chose
        (111.4, 101, False, BRIGHTER),
    ],
)
def test_a_sample_has_the_reason_that_holds_first(measured, expected, used, reason):
    found = why_left_out(np.array([measured / 255]), np.array([expected / 255]), np.array([used]), 3.0)
    assert found.tolist() == [reason]


def test_the_reasons_of_a_fit_add_up_and_are_true():
    light = el.Photometry(k=2.5, gamma=2.2, brdf=PAPER_SHEET)
    samples, gains = simulate_samples(el.TARGETS["vicalib_small"], CAMERA, light, 60, outliers=0.03, seed=3)
    fit = el.calibrate_light(samples)
    why = why_left_out(samples.level, fit.predict(samples), fit.used, fit.sigma)
    counts = np.bincount(why, minlength=len(reasons()))
    assert counts.sum() == len(samples)
    assert counts[COUNTS] == fit.used.sum()
    assert counts[BY_HAND] == 0
    assert np.all(counts[[SATURATED, BRIGHTER, DARKER]] > 0)
    truth = light.brdf.value(samples.cos_theta, samples.cos_theta) * samples.cos_theta * gains[samples.frame]
    level = 255 * (truth * samples.cos_alpha**2.5 / samples.distance**2) ** (1 / 2.2)
    assert level[why == SATURATED].min() > 238
    assert level[why == COUNTS].max() < 242
    off = 255 * samples.level - level
    assert off[why == BRIGHTER].min() > 8  # 3.5 σ of 3 grey levels are 10.5
    assert off[why == DARKER].max() < -8


def test_a_frame_that_was_left_out_has_that_reason():
    shown = np.array([False, True, True])
    why = why_left_out(np.full(3, 0.5), np.array([0.5, 0.5, 1.2]), np.zeros(3, bool), 3.0, by_hand=shown)
    assert why.tolist()[1:] == [BY_HAND, BY_HAND]
    assert why[0] in (BRIGHTER, DARKER)


def test_every_place_of_every_frame_has_a_fate():
    session, _, _ = simulated("vicalib_folded")
    camera, target = session.camera, session.target
    size = camera.width, camera.height
    black, number = np.zeros((camera.height, camera.width)), len(session.poses) * len(target.white_places())
    for most in (1, 200):
        told = places_by_fate(target, session.poses, camera, size, most)
        read = [len(sample_sheet(black, target, pose, camera, most=most)) for pose in session.poses.values()]
        assert told["read"] == sum(read)
        assert sum(told.values()) == number
    nowhere = places_by_fate(target, {"a": (None, None)}, camera, size)
    assert nowhere["its panel was not located"] == len(target.white_places())
