"""The report of a calibration: its page, its numbers, and what becomes of its files."""

import json
import re
from dataclasses import replace
from html import unescape

import pytest

import endolab as el
from endolab.calibration.summary import plus_minus
from endolab.io.cameras.formats import read_camera
from endolab.io.descriptions import make_calibration
from endolab.model.photometry import NOMINAL
from endolab.workbench.reports.calibration_page import write_report
from tests.tools.simulated_session import LOST, refused, simulated


def test_a_calibration_survives_its_file_and_a_refused_light_is_nominal(tmp_path):
    session = simulated()[0]
    made = make_calibration(session, "sheet.mkv", "green")
    el.write_calibration(made, tmp_path / "endoscope.json")
    assert el.load_calibration(tmp_path / "endoscope.json") == made
    assert (made.camera, made.photometry) == (session.camera, session.light.photometry)
    without = make_calibration(refused(session))
    assert without.evidence["photometry"]["nominal"]
    assert without.photometry == NOMINAL


@pytest.fixture
def report(tmp_path):
    """Write a report; the pictures on its page, and its words."""

    def report(session, frames):
        write_report(session, frames, tmp_path)
        content = (tmp_path / "report.html").read_text(encoding="utf-8")
        return re.findall(r'<img src="([^"]+)"', content), unescape(content)

    return report


def test_the_page_is_whole_and_its_pictures_are_there(tmp_path, report):
    session, frames = simulated()
    pictures, words = report(session, frames)
    assert pictures == ["camera.png", "light.png", "uncertainty.png"]
    of_frames = [f"frame_{number}.jpg" for number in range(len(frames))]
    assert all((tmp_path / name).is_file() for name in pictures + of_frames)
    k = plus_minus(session.light.k, session.light.standard_errors["k"])
    for part in (
        session.verdict.value,
        "frame_9",
        "too few points",
        "1 (pinned)",
        k,
    ):
        assert part in words
    facts = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert facts["verdict"] == session.verdict.value
    assert facts["frames"]["errors_px"] == session.errors
    assert read_camera(tmp_path / "camera.json") == session.camera


def test_a_page_or_a_figure_that_cannot_be_drawn_costs_no_number(tmp_path, monkeypatch):
    page = "endolab.workbench.reports.calibration_page"
    for name in ("figures.light_figure", "_small", "_frames_of"):
        monkeypatch.setattr(f"{page}.{name}", lambda *given: 1 / 0)
    session, frames = simulated()
    write_report(session, frames[:1], tmp_path)
    written = {path.name for path in tmp_path.iterdir()}
    assert written == {"camera.png", "uncertainty.png", "report.json", "camera.json"}
    facts = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert facts["verdict"] == session.verdict.value
    lost = [sentence.split()[0] for sentence in facts["warnings"]]
    assert lost == ["frame_0.jpg", "light.png", "report.html"]


def test_without_light_and_with_a_given_camera_the_page_says_so_and_no_html_is_taken_in(
    report,
):
    session, frames = simulated()
    dropped = dict.fromkeys(LOST, "a <b> & c")
    session = replace(refused(session), geometry=None, dropped=dropped)
    pictures, words = report(session, frames)
    assert pictures == ["camera.png"]
    assert "a <b> & c" in words
    assert session.refused in words
