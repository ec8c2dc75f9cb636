"""A calibration in numbers and in words."""

import re
from dataclasses import replace

import numpy as np
import pytest

from endolab.calibration.summary import account, by_reason, evidence, plus_minus
from endolab.io.atomic import as_json
from endolab.model.lights import SpotLight
from tests.tools.simulated_session import COUNT, simulated


def test_the_evidence_has_what_was_found_and_how_sure_it_is():
    session = simulated()[0]
    known = evidence(session, "sheet.mkv", "green")
    assert (known["source"], known["target"]["spacing"]) == ("sheet.mkv", 4.2238)
    assert "19 x 10 dots" in known["target"]["description"]
    camera, light = known["camera"], known["photometry"]
    assert camera["rmse_px"] == pytest.approx(0.0707, abs=1e-4)
    assert (camera["standard_errors"]["fx"], camera["views"]) == (0.012, COUNT)
    assert camera["points"] + camera["outliers"] == sum(len(view.ids) for view in session.geometry.views)
    assert 30 < camera["max_angle_deg"] < 90
    assert light["standard_errors"]["gamma"] == 0
    at_rim = -100 * np.log(np.cos(session.light.alpha_range[1])) * session.light.standard_errors["k"]
    assert light["fall_off_percent"]["largest"] == pytest.approx(at_rim, rel=0.05)
    assert 0 < light["fall_off_percent"]["median"] < at_rim / 2
    assert 0 < camera["rays_mrad"]["median"] < camera["rays_mrad"]["largest"]
    centre = replace(session.geometry, covariance=np.diag([0, 0, 1, 1, 0, 0, 0, 0]) * 0.012**2)
    turn = evidence(replace(session, geometry=centre))["camera"]["rays_turn_mrad"]
    # As much as on the axis at least; farther off, a pixel is a larger angle.
    assert 1 < turn / (1e3 * 0.012 * np.sqrt(2) / session.camera.fx) < 1.5
    assert light["k/gamma"] == pytest.approx(session.light.photometry.k / 2.2)
    assert np.shape(light["correlation"]["matrix"]) == (len(light["correlation"]["names"]),) * 2
    assert list(light["gains"]) == list(session.poses)
    assert light["gains"]["frame_4"] == session.light.gains[3]  # frame_3 was not located
    assert light["alpha_range_deg"] == pytest.approx(np.rad2deg(session.light.alpha_range))
    assert light["verdict"] == session.light.verdict
    assert light["held_out"]["error"][-1] is None  # no sample there
    assert (light["channel"], light["brdf_of"]) == ("green", "the calibration sheet")
    assert (known["frames"]["dropped"], len(known["frames"]["used"])) == (session.dropped, COUNT)


def test_what_is_not_finite_is_null():
    session = simulated()[0]
    light = replace(session.light, gain_errors=np.full(COUNT, np.inf), correlation=np.full((2, 2), np.nan))
    known = evidence(replace(session, light=light, scores=None))
    as_json(known)  # strict
    assert set(known["photometry"]["gain_errors"].values()) == {None}
    assert known["photometry"]["correlation"]["matrix"] == [[None, None]] * 2
    assert known["photometry"]["held_out"] is None


@pytest.mark.parametrize(
    ("value", "error", "written"),
    [
        (2.49601, 0.00138, "2.4960 ± 0.0014"),
        (358.2379, 0.0298, "358.238 ± 0.030"),
        (716.2, 12.3, "716 ± 12"),
        (716.2, 123.0, "716 ± 123"),
        (2.2, 0.0, "2.2 (given)"),
        (1.5, np.inf, "1.5 ± ?"),
    ],
)
def test_values_have_the_digits_of_their_error(value, error, written):
    assert plus_minus(value, error) == written


def test_frames_are_grouped_by_reason_and_not_all_named():
    dropped = {f"{n:03d}.png": "too dark" for n in range(12)} | {"x.png": "blurred"}
    assert by_reason(dropped) == [
        "12: too dark (000.png, 001.png, 002.png, 003.png, 004.png, 005.png, 006.png, 007.png and 4 more)",
        "1: blurred (x.png)",
    ]


def test_the_account_says_it_all():
    session = simulated()[0]
    lines = account(session)
    text = "\n".join(lines)
    assert lines[0] == "22 frames: the target was found in 21 and located in 20; 2 dropped"
    for part in (
        "  1: too dark (frame_3)",
        "fx 79.690 ± 0.012",
        "RMSE 0.071 px",
        "1: its points are mirrored (frame_5)",
        "γ = 2.2 (given)",
        f"residuals: {session.light.sigma:.2f} grey levels",
        "frames held out: their light is as predicted within",
        *session.light.verdict,
    ):
        assert part in text


def test_the_account_says_how_well_rays_and_light_are_known():
    """The numbers of the evidence, over what was seen; and that they are not known, if so."""
    session = simulated()[0]
    known, text = evidence(session), "\n".join(account(session))
    camera, light = known["camera"], known["photometry"]
    rays, fall_off = camera["rays_mrad"], light["fall_off_percent"]
    assert float(re.search(r"a ray: (\S+) mrad", text)[1]) == pytest.approx(rays["median"], rel=0.05)
    assert float(re.search(r"(\S+) mrad at worst", text)[1]) == pytest.approx(rays["largest"], rel=0.05)
    assert f"at worst, to {camera['max_angle_deg']:.0f}° off the axis; beside a turn of" in text
    turn = float(re.search(r"turn of (\S+) mrad", text)[1])
    assert turn == pytest.approx(camera["rays_turn_mrad"], rel=0.05)
    assert float(re.search(r"μ′: (\S+) %", text)[1]) == pytest.approx(fall_off["median"], rel=0.05)
    assert float(re.search(r"(\S+) % at worst", text)[1]) == pytest.approx(fall_off["largest"], rel=0.05)
    lost = replace(session.geometry, covariance=np.diag([np.inf] + 7 * [1e-4]))
    assert "a ray: not told by these frames" in "\n".join(account(replace(session, geometry=lost)))


def test_a_light_that_is_free_and_patches_have_rows():
    session = simulated("vicalib_grey", reflectance=((0.5, 0.05),), gamma=(2.2, 0.1))[0]
    text = "\n".join(account(session))
    assert "reflectance 1 = 0.5" in text
    session = simulated("vicalib_folded", gamma="free")[0]
    free = "\n".join(account(session))
    assert "(given)" not in free
    assert "γ = 2." in free
    names = ["light x", "light y", "light z", "light tilt x", "light tilt y"]
    spot = SpotLight((1.0, -0.5, 0.2), (0.1, 0.2, 1.0), 2.61)
    light = replace(
        session.light,
        photometry=replace(session.light.photometry, k=0.0, lights=(spot,)),
        standard_errors=session.light.standard_errors | dict.fromkeys(names, 0.01),
    )
    text = "\n".join(account(replace(session, light=light)))
    assert "k = 2.61" in text
    assert "light y = -0.500 ± 0.010 mm" in text
    assert "light tilt x = 0.100 ± 0.010" in text
