"""Videos as folders of results: what is done stays, the next call goes on, other settings are refused."""

import csv
import json
import sys

import numpy as np
import pytest

import endolab as el
from endolab.batch.video import reconstruct_video
from endolab.io.images import write_image
from endolab.io.video import write_video
from tests.tools.films import UNKNOWN, filmed, moved_tube
from tests.tools.recorded import Recorded

COUNT = 5
QUICK = {"solver": "facing", "width": 48}
OUTPUTS = ["endoscope.json", "frames", "frames.csv", "recording.rrd", "report.json"]


@pytest.fixture(scope="module")
def shots():
    """A camera that goes into a tube while the gain rises, with 1 grey level of noise."""
    return filmed(map(moved_tube, range(COUNT)), range(900, 900 + 50 * COUNT, 50))


@pytest.fixture
def film(tmp_path, shots):
    folder = tmp_path / "film"
    folder.mkdir()
    for k, one in enumerate(shots):
        write_image(folder / f"frame_{k}.png", one.frame.image)
    return folder


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out"


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def table(out):
    with open(out / "frames.csv", newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def distances(out, frame):
    with np.load(out / f"frames/{frame}/depth.npz", allow_pickle=False) as depth:
        return depth["distance"]


def recorded(out):
    numbers = Recorded(out / "recording.rrd").numbers("/plots/energy", "scalars")
    return list(numbers.values())


def test_a_folder_becomes_a_folder(film, out):
    (film / "frame_2.png").write_bytes(b"broken")
    write_image(film / "frame_3.png", np.full((8, 9), 0.4))
    calls = []
    found = reconstruct_video(
        film, UNKNOWN, out, progress=lambda *each: calls.append(each)
    )
    assert calls == [(k + 1, COUNT, row) for k, row in enumerate(found.rows)]
    assert names(out) == OUTPUTS
    assert names(out / "frames") == ["frame_0", "frame_1", "frame_4"]
    assert [row["frame"] for row in table(out)] == [f"frame_{k}.png" for k in range(5)]
    broken = [bool(row["error"]) for row in found.rows]
    assert broken == [False, False, True, True, False]
    expected = [row["energy"] for row in found.rows if not row["error"]]
    stored = [float(row["energy"]) for row in table(out) if not row["error"]]
    assert stored == pytest.approx(expected)
    assert recorded(out) == expected
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert (report["done"], report["unit"]) == (3, found.rows[0]["unit"])
    assert report["field"]["px"] == [96, 72]
    middle = np.nanmedian(distances(out, "frame_4"))
    assert found.rows[4]["median_distance"] == pytest.approx(middle, rel=1e-5)


@pytest.mark.parametrize("failure", [KeyboardInterrupt, MemoryError])
@pytest.mark.parametrize("lost", [None, "frame_1"])
def test_an_interrupted_video_goes_on_where_it_was(film, out, failure, lost):
    """And comes to the same surfaces, to 0.1 %, and to a recording of all frames."""
    whole = out.with_name("whole")
    reconstruct_video(film, UNKNOWN, whole, limit=4)

    def stop(done, total, row):
        if done == 2:
            raise failure

    with pytest.raises(failure):
        reconstruct_video(film, UNKNOWN, out, limit=4, progress=stop)
    assert "recording.rrd" not in names(out)
    if lost:
        (out / f"frames/{lost}/depth.npz").unlink()
    found = reconstruct_video(film, UNKNOWN, out, limit=4)
    assert found.done_before == (1 if lost else 2)
    assert [row["error"] for row in table(out)] == [""] * 4
    for name in names(out / "frames"):
        expected = distances(whole, name)
        np.testing.assert_allclose(distances(out, name), expected, rtol=1e-3)
    assert len(recorded(out)) == 4
    written = (out / "recording.rrd").stat().st_mtime_ns
    again = reconstruct_video(film, UNKNOWN, out, limit=4)  # nothing is left to do
    assert again.done_before == 4
    np.testing.assert_equal(again.rows, found.rows)
    assert (out / "recording.rrd").stat().st_mtime_ns == written


def test_what_cannot_be_recorded_costs_no_frame(film, out, monkeypatch):
    with monkeypatch.context() as patch:
        patch.delattr("endolab.workbench.recording.recorder.paint_surface")
        found = reconstruct_video(film, UNKNOWN, out, limit=2)
    assert "recording.rrd" not in names(out)
    assert [path.name for path in found.paths] == names(out)
    warnings = json.loads((out / "report.json").read_text())["warnings"]
    assert "recording.rrd could not be drawn" in " ".join(warnings)
    again = reconstruct_video(film, UNKNOWN, out, limit=2)
    assert again.done_before == 2
    assert len(recorded(out)) == 2
    assert json.loads((out / "report.json").read_text())["warnings"] == []


def test_every_nth_frame_of_a_video_and_only_what_is_inside_the_mask(
    out, tmp_path, shots, monkeypatch
):
    """Without Rerun there is no recording."""
    monkeypatch.setitem(sys.modules, "rerun", None)
    write_video(tmp_path / "v.mkv", [one.frame.image for one in shots])
    write_image(tmp_path / "mask.png", np.arange(96) < np.full((72, 1), 48))
    how = {"mask": tmp_path / "mask.png", "every": 2, "limit": 2, "solver": "facing"}
    reconstruct_video(tmp_path / "v.mkv", UNKNOWN, out, **how)
    assert names(out) == [name for name in OUTPUTS if name != "recording.rrd"]
    assert names(out / "frames") == ["000000", "000002"]
    known = np.isfinite(distances(out, "000002"))
    assert known[:, :46].mean() > 0.8
    assert not known[:, 50:].any()


@pytest.mark.parametrize("change", ["lam", "mask", "calibration", "source"])
def test_other_settings_want_another_folder(film, out, shots, change):
    before = {"source": film, "calibration": UNKNOWN, "mask": None, "lam": 1.0} | QUICK
    other = {
        "source": film.with_name("v.mkv"),
        "calibration": el.load_calibration("simple", 96),
    }
    other |= {"mask": film.with_name("m.png"), "lam": 2.0}
    write_image(other["mask"], np.ones((72, 96)))
    write_video(other["source"], [shots[1].frame.image])
    reconstruct_video(**before, out=out, limit=2)
    written = (out / "frames.csv").read_bytes()
    now = before | {change: other[change]}
    with pytest.raises(ValueError, match=r"settings.*overwrite"):
        reconstruct_video(**now, out=out, limit=1)
    assert (out / "frames.csv").read_bytes() == written
    assert reconstruct_video(**now, out=out, limit=1, overwrite=True).done_before == 0
