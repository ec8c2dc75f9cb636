"""Videos as folders of results: what is done stays, the next call goes on, other settings are refused."""

import csv
import json
import sys
from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.batch import video
from endolab.batch.video import SequenceFolder, reconstruct_video
from endolab.cli import main as cli
from endolab.io import surfaces
from endolab.io.images import write_image
from endolab.io.video import write_video
from endolab.reconstruction import sequence

COUNT = 5
BASE = datasets.load_calibration("simple", 96)
UNKNOWN = el.Calibration(BASE.camera, replace(BASE.photometry.channel("green"), gain=None))
QUICK = {"solver": "facing", "width": 48}
OUTPUTS = ["frames", "frames.csv", "recording.rrd", "report.json"]


@pytest.fixture(scope="module")
def shots():
    """A camera that goes into a tube while the gain rises, with 1 grey level of noise."""
    known = UNKNOWN.photometry
    return [
        el.render(
            el.Tube(length=130 - 3 * t, tilt=5 + 0.5 * t, offset=(3 - 0.5 * t, 1)),
            *(BASE.camera, replace(known, gain=900.0 + 50 * t)),
            **{"noise": 1.0, "bits": 8, "seed": t},
        )
        for t in range(COUNT)
    ]


@pytest.fixture
def film(tmp_path, shots):
    folder = tmp_path / "film"
    folder.mkdir()
    for k, one in enumerate(shots):
        write_image(folder / f"frame_{k}.png", one.image)
    UNKNOWN.save(tmp_path / "cal.json")
    return folder


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out"


@pytest.fixture
def call(film, out, capsys):
    """Run the command on the film; its exit code, and what it said on stdout and stderr."""

    def run(*options, source=film):
        command = ["reconstruct", source, "--calibration", film.parent / "cal.json", "--out", out, *options]
        return cli.main([str(word) for word in command]), *capsys.readouterr()

    return run


@pytest.fixture
def stopped(monkeypatch):
    """Make the folder fail at its third frame, once."""

    def after_two(failure):
        real, added = SequenceFolder.add, []

        def add(self, step):
            if len(added) == 2:
                monkeypatch.setattr(SequenceFolder, "add", real)
                raise failure
            added.append(step.name)
            real(self, step)

        monkeypatch.setattr(SequenceFolder, "add", add)

    return after_two


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def table(out):
    with open(out / "frames.csv", newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def report(out):
    return json.loads((out / "report.json").read_text(encoding="utf-8"))


def distances(out, k):
    with np.load(out / f"frames/frame_{k}/depth.npz", allow_pickle=False) as depth:
        return depth["distance"]


def test_a_folder_becomes_a_folder(film, out):
    (film / "frame_2.png").write_bytes(b"broken")
    write_image(film / "frame_3.png", np.full((8, 9), 0.4))
    told = []
    found = reconstruct_video(film, UNKNOWN, out, progress=lambda *each: told.append(each))
    expected = [(k + 1, COUNT, f"frame_{k}.png") for k in range(COUNT)]
    assert [(done, total, row["frame"]) for done, total, row in told] == expected
    assert found.done_before == 0
    assert [path.relative_to(out).as_posix() for path in found.paths] == names(out) == OUTPUTS
    assert names(out / "frames") == ["frame_0", "frame_1", "frame_4"]
    assert [row["index"] for row in table(out)] == list("01234")
    assert [bool(row["error"]) for row in found.rows] == [False, False, True, True, False]
    energies = [row["energy"] for row in found.rows]
    assert [float(row["energy"] or "nan") for row in table(out)] == pytest.approx(energies, nan_ok=True)
    assert report(out)["complete"]
    assert "The gain is unknown" in report(out)["meaning"][0]
    assert set(report(out)["broken"]) == {"frame_2.png", "frame_3.png"}
    assert found.rows[4]["median_distance"] == pytest.approx(np.nanmedian(distances(out, 4)), rel=1e-5)


@pytest.mark.parametrize(
    ("failure", "said"), [(KeyboardInterrupt(), "interrupted"), (MemoryError(), "out of")]
)
def test_an_interrupted_video_goes_on_where_it_was(film, out, shots, stopped, failure, said):
    stopped(failure)
    with pytest.raises(type(failure), match=f"{said}.*; 2 of 5 frames are done and stay, the same command"):
        reconstruct_video(film, UNKNOWN, out)
    assert not report(out)["complete"]
    old = (out / "frames/frame_1/depth.npz").read_bytes()
    told = []
    found = reconstruct_video(film, UNKNOWN, out, progress=lambda done, *rest: told.append(done))
    assert (found.done_before, told) == (2, [3, 4, 5])
    assert (out / "frames/frame_1/depth.npz").read_bytes() == old
    assert [row["error"] for row in table(out)] == [""] * COUNT
    assert all(row["iterations"].isdigit() and row["pixels"].isdigit() for row in table(out))
    lacks = np.array([np.nanmedian(one.distance / distances(out, k)) for k, one in enumerate(shots)])
    np.testing.assert_allclose(lacks / lacks[0], 1, atol=0.06)  # one scale for all, whoever did them
    assert el.read_recording(out / "recording.rrd") is not None  # of all frames, also the first call's
    kept = {name: (out / name).read_bytes() for name in ("report.json", "frames.csv")}
    stamp = (out / "recording.rrd").stat().st_mtime_ns
    again = reconstruct_video(film, UNKNOWN, out)  # there is nothing left to do
    assert (again.done_before, again.rows) == (COUNT, found.rows)
    assert {name: (out / name).read_bytes() for name in kept} == kept
    assert (out / "recording.rrd").stat().st_mtime_ns == stamp


def test_a_frame_between_takes_up_its_neighbours_scale(film, out, shots):
    content = (film / "frame_1.png").read_bytes()
    (film / "frame_1.png").write_bytes(b"broken")
    reconstruct_video(film, UNKNOWN, out, limit=3)
    (film / "frame_1.png").write_bytes(content)
    found = reconstruct_video(film, UNKNOWN, out, limit=3)
    assert found.done_before == 2
    lacks = np.array([np.nanmedian(shots[k].distance / distances(out, k)) for k in range(3)])
    np.testing.assert_allclose(lacks / lacks[0], 1, atol=0.06)


def test_a_solver_that_was_stopped_ends_it(film, out, monkeypatch):
    real, stopped = sequence.reconstruct, {"status": el.Status.STOPPED}
    monkeypatch.setattr(sequence, "reconstruct", lambda *a, **k: replace(real(*a, **k), **stopped))
    with pytest.raises(KeyboardInterrupt, match="interrupted"):
        reconstruct_video(film, UNKNOWN, out, **QUICK)
    assert not out.exists()


def test_only_what_is_inside_the_mask(film, out, tmp_path):
    write_image(tmp_path / "mask.png", np.arange(96) < np.full((72, 1), 48))
    reconstruct_video(film, UNKNOWN, out, mask=tmp_path / "mask.png", every=4, solver="facing")
    assert names(out / "frames") == ["frame_0", "frame_4"]
    known = np.isfinite(distances(out, 4))
    assert known[:, :46].mean() > 0.8
    assert not known[:, 50:].any()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lam": 2.0}, r"made with another lam \(1.0, not 2.0\)"),
        ({"mask": "m.png"}, r"made with another mask \(None, not .*m.png\)"),
        ({"calibration": BASE}, "made with another calibration;"),
        ({"source": "v.mkv"}, "holds the frames of .*film;"),
    ],
)
def test_other_settings_want_another_folder(film, out, tmp_path, shots, change, message):
    reconstruct_video(film, UNKNOWN, out, limit=1, lam=1.0, **QUICK)
    write_image(tmp_path / "m.png", np.ones((72, 96)))
    write_video(tmp_path / "v.mkv", [shots[0].image])
    kept = (out / "report.json").read_bytes()
    given = {"source": film, "calibration": UNKNOWN, "lam": 1.0} | QUICK | change
    given |= {name: tmp_path / given[name] for name in ("mask", "source") if name in change}
    with pytest.raises(ValueError, match=f"{message}.* choose another folder"):
        reconstruct_video(given.pop("source"), given.pop("calibration"), out, limit=1, **given)
    assert (out / "report.json").read_bytes() == kept


@pytest.mark.parametrize("content", ["{}", "[]", "no"])
def test_another_folder_is_left_alone_and_at_least_one_frame_asked_for(film, out, content):
    out.mkdir()
    (out / "report.json").write_text(content)
    with pytest.raises(ValueError, match="holds other results; choose another folder"):
        reconstruct_video(film, UNKNOWN, out)
    for option in ("every", "limit"):
        with pytest.raises(ValueError, match=f"{option} must be at least 1, got 0"):
            reconstruct_video(film, UNKNOWN, out, **{option: 0})
    assert names(out) == ["report.json"]


@pytest.mark.parametrize("name", ["frames.csv", "recording.rrd", "frames/frame_1/depth.npz", "report.json"])
def test_files_of_others_are_not_replaced_unasked(film, out, name, call):
    (out / name).parent.mkdir(parents=True)
    (out / name).write_text("mine")
    (out / "frames").mkdir(exist_ok=True)
    (out / "frames/notes.txt").write_text("mine too")  # in nobody's way
    status, _, said = call("--limit", 2, "--solver", "facing", "--width", 48)
    assert status == 2
    assert said.endswith("choose another folder, or replace it with --overwrite\n")
    assert (out / name).read_text() == "mine"
    assert len(list(out.rglob("*.*"))) == 2
    assert call("--limit", 2, "--solver", "facing", "--width", 48, "--overwrite")[0] == 0
    assert (out / name).read_bytes() != b"mine"
    assert (out / "frames/notes.txt").read_text() == "mine too"


def test_results_of_other_settings_are_replaced_whole_or_not(film, out, monkeypatch):
    reconstruct_video(film, UNKNOWN, out, limit=3, lam=1.0, **QUICK)
    before = {path: path.read_bytes() for path in out.rglob("*.*")}
    monkeypatch.setattr(video, "reconstruct_sequence", lambda *them, **how: (x for x in [1 / 0]))
    with pytest.raises(ZeroDivisionError):  # nothing is replaced before there is something new
        reconstruct_video(film, UNKNOWN, out, lam=2.0, overwrite=True, **QUICK)
    assert {path: path.read_bytes() for path in out.rglob("*.*")} == before
    monkeypatch.undo()
    found = reconstruct_video(film, UNKNOWN, out, limit=1, lam=2.0, overwrite=True, **QUICK)
    assert found.done_before == 0
    assert [path.parent.name for path in out.rglob("depth.npz")] == ["frame_0"]
    assert reconstruct_video(film, UNKNOWN, out, limit=2, lam=2.0, overwrite=True, **QUICK).done_before == 1


def test_what_a_video_is_made_from_is_never_replaced(film, out, call):
    out.mkdir()
    (film.parent / "cal.json").rename(out / "report.json")
    (film.parent / "cal.json").symlink_to(out / "report.json")
    status, _, said = call("--limit", 1, "--overwrite")
    assert status == 2
    assert "report.json is read by this very call" in said
    assert names(out) == ["report.json"]


def test_without_rerun_there_is_no_recording(film, out, monkeypatch, call):
    monkeypatch.setitem(sys.modules, "rerun", None)
    monkeypatch.delitem(sys.modules, "endolab.recording", raising=False)
    for before in (0, 1):
        found = reconstruct_video(film, UNKNOWN, out, limit=1 + before, **QUICK)
        assert found.done_before == before
        assert [path.name for path in found.paths] == [name for name in OUTPUTS if "rrd" not in name]
    code, said, error = call("--out", out.with_name("new"), "--solver", "facing")
    assert (code, error) == (0, "")
    assert 'There is no recording.rrd: rerun is not installed; pip install "endolab[lab]" brings it.' in said
    assert said.endswith(": frames, frames.csv, report.json\n")


def test_the_command_tells_what_became_of_it(film, out, call, stopped):
    (film / "frame_3.png").write_bytes(b"broken")
    stopped(KeyboardInterrupt())
    code, said, error = call()
    assert (code, said) == (130, "")
    assert error == "endolab: interrupted; 2 of 5 frames are done and stay, the same command goes on\n"
    code, said, error = call()
    assert (code, error) == (0, "")
    assert "not done: frame_3.png: cannot be read\n4 of 5 frames, 3 started from the last, " in said
    assert "done by an earlier call: 2 of them" in said
    assert "(relative units)\nThe gain is unknown: distances have no unit" in said
    assert said.endswith(f"written to {out}: frames, frames.csv, recording.rrd, report.json\n")


def test_a_full_disk_keeps_what_is_done(out, call, monkeypatch):
    real, saved = surfaces.save_depth, []

    def save(path, *maps):
        if len(saved) == 2:
            raise OSError(f"cannot write {path}: No space left on device")
        saved.append(path)
        real(path, *maps)

    monkeypatch.setattr(video, "save_depth", save)
    code, _, error = call("--solver", "facing")
    assert code == 2
    assert error.count("\n") == 1
    assert "No space left on device; 2 of 5 frames are done and stay" in error
    assert names(out / "frames") == ["frame_0", "frame_1"]
    assert len(table(out)) == 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--every", "0"], "--every must be at least 1, got 0"),
        (["--mesh"], "--mesh, --prepare and --snapshots are of one frame"),
        (["--lam", "-1"], "no frame could be reconstructed; the first: frame_0.png: lam must be finite"),
        (["--solver", "magic"], "unknown solver 'magic'"),
    ],
)
def test_a_bad_option_writes_nothing(out, call, options, message):
    code, _, error = call(*options)
    assert code == 2
    assert message in error
    assert error.count("\n") == 1
    assert not out.exists()


def test_every_nth_frame_of_a_video(film, out, tmp_path, call, shots):
    write_video(tmp_path / "v.mkv", [one.image for one in shots])
    options = ("--every", 2, "--limit", 2, "--solver", "facing", "--width", 48)
    code, said, _ = call(*options, source=tmp_path / "v.mkv")
    assert code == 0
    assert "2 of 2 frames" in said
    assert [row["frame"] for row in table(out)] == ["000000", "000002"]
    code, _, error = call(*options, source=film / "frame_0.png")
    assert code == 2
    assert "--every is of a folder or a video" in error
