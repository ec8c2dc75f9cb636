"""Videos as folders of results: what is done stays, the next call goes on, other settings are refused."""

import csv
import json
import os
import re
import sys
from contextlib import nullcontext
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
from tests.tools.recorded import Recorded

COUNT = 5
BASE = datasets.load_calibration("simple", 96)
UNKNOWN = el.Calibration(BASE.camera, replace(BASE.photometry.channel("green"), gain=None))
QUICK = {"solver": "facing", "width": 48}
SHORT = {"max_iterations": 3, "width": 48}
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


def kept(out):
    """All that a folder holds, read back, but for seconds."""
    found = {"report": report(out), "rows": [row | {"seconds": ""} for row in table(out)]}
    for path in sorted((out / "frames").rglob("*.npz")):
        with np.load(path, allow_pickle=False) as maps:
            found[path.relative_to(out).as_posix()] = {name: maps[name].tobytes() for name in maps.files}
    for entity, components in Recorded(out / "recording.rrd").rows.items():
        if "seconds" not in entity and not entity.startswith("/__"):
            found[entity] = {name: {k: str(v) for k, v in rows.items()} for name, rows in components.items()}
    return found


def lost(monkeypatch, after):
    """Fail at a change of the disk, as if the power went: nothing is tidied up after it."""
    changes = []

    def counted(real):
        def write(*what):
            changes.append(what)
            if len(changes) > after:
                raise RuntimeError("the power is gone")
            real(*what)

        return write

    for name in ("write_atomically", "write_rows", "save_depth"):
        monkeypatch.setattr(video, name, counted(getattr(video, name)))
    monkeypatch.setattr(video, "_undone", lambda files: nullcontext())


@pytest.mark.parametrize("after", range(1, 10))
def test_whenever_it_was_cut_off_it_comes_to_the_same_bits(film, out, monkeypatch, after):
    """After the report, and after the depth map, what is handed on and the table of each frame."""
    (film / "frame_1.png").write_bytes(b"broken")
    reconstruct_video(film, UNKNOWN, out.with_name("whole"), limit=4, **SHORT)
    with monkeypatch.context() as patch:
        lost(patch, after)
        with pytest.raises(RuntimeError, match="the power is gone"):
            reconstruct_video(film, UNKNOWN, out, limit=4, **SHORT)
    reconstruct_video(film, UNKNOWN, out, limit=4, **SHORT)
    assert kept(out) == kept(out.with_name("whole"))


def test_what_the_next_frame_takes_up_is_kept_no_longer_than_that(film, out):
    reconstruct_video(film, UNKNOWN, out.with_name("whole"), **SHORT)
    reconstruct_video(film, UNKNOWN, out, limit=2, **SHORT)
    assert [path.parent.name for path in out.rglob("state.npz")] == ["frame_1"]
    reconstruct_video(film, UNKNOWN, out, **SHORT)
    assert list(out.rglob("state.npz")) == []
    assert kept(out) == kept(out.with_name("whole"))


@pytest.mark.parametrize("content", [b"", b"PK", "another"])
def test_what_is_handed_on_but_damaged_is_not_trusted(film, out, content):
    reconstruct_video(film, UNKNOWN, out, limit=2, **SHORT)
    state = out / "frames/frame_1/state.npz"
    if content == "another":
        with np.load(state) as arrays:
            handed = dict(arrays)
        np.savez(state, **handed | {"log_distance": handed["log_distance"] + 1e-3})
    else:
        state.write_bytes(content)
    rows = reconstruct_video(film, UNKNOWN, out, limit=3, **SHORT).rows
    assert [(row["error"], row["warm"]) for row in rows[2:]] == [("", 0)]
    assert [path.parent.name for path in out.rglob("state.npz")] == ["frame_2"]


@pytest.mark.parametrize("damage", ["cut", "empty", "foreign", "another frame's", "gone"])
def test_a_damaged_depth_map_is_done_again_and_said(film, out, call, damage):
    options = ("--width", 48, "--max-iterations", 3)
    assert call(*options)[0] == 0
    depth = out / "frames/frame_2/depth.npz"
    wrong = {"cut": depth.read_bytes()[:-99], "empty": b"", "foreign": b"mine"}
    wrong["another frame's"] = (out / "frames/frame_1/depth.npz").read_bytes()
    depth.unlink()
    if damage in wrong:
        depth.write_bytes(wrong[damage])
    code, said, error = call(*options)
    assert (code, error) == (0, "")
    assert f"frame_2.png is done again; {depth}: " in said
    assert "done by an earlier call: 4 of them" in said
    assert np.isfinite(distances(out, 2)).any()


@pytest.mark.parametrize(
    ("change", "again"),
    [
        (lambda text: text[:-20], False),  # of whom a row is that lacks cells is not certain
        (lambda text: text.replace(",3,", ",1e999,", 1), True),
        (lambda text: text.replace(",3,", ",1e308,", 1), True),
        (lambda text: text.replace(",3,", ",nan,", 1), True),
        (
            lambda text: re.sub(r"^(0,(?:[^,]*,){8})[^,]*", r"\1nan", text, flags=re.MULTILINE),
            True,
        ),  # its seconds
        (lambda text: text.replace("relative units", "furlongs", 1), True),
        (lambda text: text + text.splitlines()[1] + "\n", False),
        (lambda text: text + text.splitlines()[1].replace("frame_0", "../../x") + "\n", False),
    ],
)
def test_rows_that_are_not_certain_are_done_again(film, out, call, change, again):
    options = ("--width", 48, "--max-iterations", 3, "--limit", 2)
    assert call(*options)[0] == 0
    text = (out / "frames.csv").read_text(encoding="utf-8")
    (out / "frames.csv").write_text(change(text), encoding="utf-8")
    code, said, error = call(*options)
    assert (code, error) == (0, "")
    assert ("not a row of a frame" in said) == again
    assert [row["frame"] for row in table(out)] == ["frame_0.png", "frame_1.png"]
    assert names(out) == OUTPUTS


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("frames.csv", b""),
        ("frames.csv", b"a,b\n1,2\n"),
        ("frames.csv", b'"' + b"x" * 200_000),
        ("report.json", b"[" * 100_000),
        ("report.json", b'{"sequence": "x", "settings": [], "meaning": []}'),
        ("report.json", b'{"sequence": "x", "settings": {}, "meaning": 3}'),
    ],
)
def test_other_tables_and_reports_are_refused_and_stay(film, out, call, name, content):
    options = ("--width", 48, "--solver", "facing", "--limit", 1)
    assert call(*options)[0] == 0
    (out / name).write_bytes(content)
    code, _, error = call(*options)
    assert (code, error.count("\n")) == (2, 1)
    assert "choose another folder, or replace it with --overwrite" in error
    assert (out / name).read_bytes() == content


def test_names_of_any_bytes(film, out):
    odd = [b"line\nbreak.png", b"byte\xff.png", b"comma,.png"]
    try:
        for name, old in zip(odd, sorted(film.iterdir()), strict=False):
            old.rename(film / os.fsdecode(name))
    except (OSError, UnicodeError):
        pytest.skip("this system has no such names")
    for before in (0, COUNT):
        found = reconstruct_video(film, UNKNOWN, out, **QUICK)
        assert (found.done_before, [row["error"] for row in found.rows]) == (before, [""] * COUNT)


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
        (["--mesh"], "--mesh, --prepare, --trust and --snapshots are of one frame"),
        (["--lam", "-1"], "no frame could be reconstructed; the first: frame_0.png: lam must "),
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
