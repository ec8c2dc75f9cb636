"""A calibration in numbers and in words."""

from dataclasses import replace

import numpy as np
import pytest

from endolab.calibration.summary import (
    account,
    by_reason,
    evidence,
    light_errors,
    plus_minus,
    verdict,
)
from endolab.io.atomic import as_json
from tests.tools.simulated_session import COUNT, simulated


@pytest.fixture(scope="module")
def session():
    return simulated()[0]


def test_the_evidence_has_what_was_found_and_how_sure_it_is(session):
    known = evidence(session, "sheet.mkv", "green")
    camera = known["camera"]
    light = known["photometry"]
    frames = known["frames"]
    assert (known["source"], known["target"]["spacing"]) == ("sheet.mkv", 4.2238)
    points = sum(len(view.ids) for view in session.geometry.views)
    assert camera["points"] + camera["outliers"] == points
    steepest = -np.log(np.cos(session.light.alpha_range[1]))
    at_rim = 100 * steepest * session.light.standard_errors["k"]
    assert light["fall_off_percent"]["largest"] == pytest.approx(at_rim, rel=0.05)
    assert 0 < camera["rays_mrad"]["median"] < camera["rays_mrad"]["largest"]
    assert (
        light["gains"]["frame_4"] == session.light.gains[3]
    )  # frame_3 was not located
    assert (frames["dropped"], len(frames["used"])) == (session.dropped, COUNT)
    off = session.light.residuals[session.light.used & (session.samples.frame == 3)]
    assert frames["errors_grey"]["frame_4"] == pytest.approx(np.sqrt(np.mean(off**2)))
    assert (
        list(frames["errors_px"]) == list(light_errors(session)) == list(session.poses)
    )


def test_what_is_not_finite_is_null(session):
    light = replace(session.light, gain_errors=np.full(COUNT, np.inf))
    known = evidence(replace(session, light=light, scores=None))
    as_json(known)  # strict
    assert set(known["photometry"]["gain_errors"].values()) == {None}


def test_values_have_the_digits_of_their_error():
    assert plus_minus(2.49601, 0.00138) == "2.4960 ± 0.0014"
    assert plus_minus(716.2, 123.0) == "716 ± 123"
    assert plus_minus(2.2, 0.0) == "2.2 (given)"
    assert plus_minus(1.5, np.inf) == "1.5 ± ?"


def test_frames_are_grouped_by_reason_and_not_all_named():
    dropped = {f"{n:03d}.png": "too dark" for n in range(12)} | {"x.png": "blurred"}
    many, one = by_reason(dropped)
    assert many.startswith("12: too dark (000.png, 001.png")
    assert many.endswith("and 4 more)")
    assert one == "1: blurred (x.png)"


def test_the_account_says_it_all(session):
    text = "\n".join(account(session))
    camera = evidence(session)["camera"]
    for part in (
        "1: too dark (frame_3)",
        f"RMSE {session.geometry.rmse:.3f} px",
        f"{camera['rays_mrad']['median']:.2g} mrad in the median",
        "γ = 2.2 (given)",
        f"residuals: {session.light.sigma:.2f} grey levels",
        *session.light.verdict,
    ):
        assert part in text
    lost = replace(session.geometry, covariance=np.diag([np.inf] + 7 * [1e-4]))
    lines = account(replace(session, geometry=lost))
    assert any("a ray: not told by these frames" in line for line in lines)


def test_the_verdict_is_one_sentence_that_says_what_can_be_used(session):
    k = plus_minus(session.light.k, session.light.standard_errors["k"])
    assert f"k = {k}" in verdict(session)
    assert verdict(replace(session, light=None)).startswith("Use the camera alone")
    inliers = [
        good & (np.arange(len(good)) % 2 == 0) for good in session.geometry.inliers
    ]
    wrong = replace(session, geometry=replace(session.geometry, inliers=inliers))
    assert verdict(wrong).startswith("Do not use it")


def test_patches_have_rows():
    patches = simulated("vicalib_grey", reflectance=((0.5, 0.05),), gamma=(2.2, 0.1))[0]
    assert "reflectance 1 = 0.5" in "\n".join(account(patches))
