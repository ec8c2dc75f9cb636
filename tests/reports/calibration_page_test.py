"""The report of a calibration: its page, and what becomes of its files."""

import json
import sys
from dataclasses import replace
from html.parser import HTMLParser

import pytest

from endolab.calibration.summary import account, evidence
from endolab.io.descriptions import Calibration, make_calibration, read_camera
from endolab.io.images import write_image
from endolab.io.video import open_frames
from endolab.reports.calibration_page import write_report
from tests.tools.simulated_session import LOST, refused, simulated


class Page(HTMLParser):
    """Words and pictures of a page; complains of tags that do not match."""

    def __init__(self, content):
        super().__init__()
        self.words, self.pictures, self.open = [], [], []
        self.feed(content)
        assert not self.open

    def handle_starttag(self, tag, attributes):
        if tag == "img":
            self.pictures.append(dict(attributes)["src"])
        elif tag not in ("meta", "link", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open[-1:] != ["style"]:
            self.words.append(data)

    @property
    def text(self):
        return " ".join(self.words)


def test_a_calibration_survives_its_file(tmp_path):
    session = simulated()[0]
    made = make_calibration(session, "sheet.mkv", "green")
    made.save(tmp_path / "endoscope.json")
    read = Calibration.load(tmp_path / "endoscope.json")
    assert (read.camera, read.photometry) == (session.camera, session.light.photometry)
    assert (read.photometry.gain, read.evidence) == (None, made.evidence)


def test_a_refused_light_has_reasons_and_no_file():
    session = refused(simulated()[0])
    assert evidence(session)["photometry"] == {"refused": session.refused}
    with pytest.raises(ValueError, match="no light to save: γ cannot be told"):
        make_calibration(session)
    assert f"light: refused: {session.refused}" in account(session)


def test_the_page_is_whole_and_its_pictures_are_there(tmp_path):
    session, frames, _ = simulated()
    write_report(session, frames, tmp_path / "report")
    files = {file.name for file in (tmp_path / "report").iterdir()}
    pictures = ["camera.png", "light.png", "uncertainty.png"]
    assert files == {"report.html", "report.json", "camera.json", *pictures}
    page = Page((tmp_path / "report" / "report.html").read_text(encoding="utf-8"))
    assert page.pictures == pictures
    for part in (*session.light.verdict, "frame_9", "too few points", "79.690 ± 0.012 px", "1 (pinned)"):
        assert part in page.text
    facts = json.loads((tmp_path / "report" / "report.json").read_text(encoding="utf-8"))
    assert (facts["account"], facts["photometry"]["verdict"]) == (account(session), session.light.verdict)
    assert read_camera(tmp_path / "report" / "camera.json") == session.camera


def test_a_page_without_light_and_with_a_given_camera_says_so_at_the_top(tmp_path):
    session, frames, _ = simulated()
    session = replace(refused(session), geometry=None, dropped=dict.fromkeys(LOST, "a <b> & c"))
    write_report(session, frames, tmp_path)
    files = {file.name for file in tmp_path.iterdir()}
    assert files == {"report.html", "report.json", "camera.json", "detection.png"}
    content = (tmp_path / "report.html").read_text(encoding="utf-8")
    page = Page(content)
    assert "<one>" not in content
    assert "a <b> & c" in page.text
    assert session.refused in page.text
    assert page.text.index("was not calibrated") < page.text.index("Camera")


def test_the_frame_is_read_from_its_file(tmp_path):
    session, frames, _ = simulated()
    (tmp_path / "video").mkdir()
    renamed = {  # in files
        part: {f"{name}.png": value for name, value in getattr(session, part).items()}
        for part in ("detections", "poses")
    }
    session = replace(refused(session), geometry=None, **renamed)
    for name, image in frames:
        write_image(tmp_path / "video" / f"{name}.png", image)
    source = open_frames(tmp_path / "video")
    write_report(session, source, tmp_path / "report")
    assert str(source.path) in (tmp_path / "report" / "report.html").read_text(encoding="utf-8")


def test_without_jinja_there_is_all_but_the_page(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "jinja2", None)
    session, frames, _ = simulated()
    write_report(refused(session), frames, tmp_path)
    files = {file.name for file in tmp_path.iterdir()}
    assert files == {"report.json", "camera.json", "camera.png", "uncertainty.png"}


def test_a_report_that_cannot_be_written_leaves_nothing(tmp_path):
    session, frames, _ = simulated()
    (tmp_path / "report.json").mkdir()
    with pytest.raises(OSError, match=r"report\.json: it is a folder"):
        write_report(refused(session), frames, tmp_path, overwrite=True)
    assert [file.name for file in tmp_path.iterdir()] == ["report.json"]
