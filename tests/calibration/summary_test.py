"""A calibration in numbers and in words."""

from dataclasses import replace

import numpy as np
import pytest

from endolab.calibration.refusals import Verdict
from endolab.calibration.summary import evidence, plus_minus
from endolab.io.atomic import as_json
from tests.tools.simulated_session import COUNT, simulated


@pytest.fixture(scope="module")
def session():
    return simulated()[0]


def test_the_evidence_has_what_was_found_and_how_sure_it_is(session):
    known = evidence(session, "sheet.mkv", "green")
    camera, light, frames = (known[name] for name in ("camera", "photometry", "frames"))
    points = sum(len(view.ids) for view in session.geometry.views)
    assert camera["points"] + camera["outliers"] == points
    rows = {row["name"]: (row["value"], row["error"]) for row in known["table"]}
    error = session.light.standard_errors["k"]
    assert (rows["k"], rows["gamma"]) == ((session.light.k, error), (2.2, 0.0))
    assert rows["reprojection"] == (session.geometry.rmse, None)
    # frame_3 was not located
    assert light["gains"]["frame_4"] == session.light.gains[3]
    assert (frames["dropped"], len(frames["used"])) == (session.dropped, COUNT)


def test_what_is_not_finite_is_null(session):
    light = replace(session.light, gain_errors=np.full(COUNT, np.inf))
    known = evidence(replace(session, light=light))
    as_json(known)  # strict
    assert set(known["photometry"]["gain_errors"].values()) == {None}


def test_values_have_the_digits_of_their_error():
    assert plus_minus(2.49601, 0.00138) == "2.4960 ± 0.0014"
    assert plus_minus(716.2, 123.0) == "716 ± 123"
    assert plus_minus(2.2, 0.0) == "2.2 (given)"
    assert plus_minus(1.5, np.inf) == "1.5 ± ?"


def test_the_verdict_says_what_can_be_used(session):
    assert session.verdict is Verdict.USE
    assert replace(session, light=None).verdict is Verdict.CAMERA_ALONE
    inliers = [np.arange(len(good)) % 2 == 0 for good in session.geometry.inliers]
    wrong = replace(session, geometry=replace(session.geometry, inliers=inliers))
    assert wrong.verdict is Verdict.USELESS
