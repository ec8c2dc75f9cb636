"""Recordings read back: what was solved is what is read, and files that are none are named."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import rerun as rr

import endolab as el
from endolab import datasets
from endolab.recording import decoder
from endolab.recording.reader import read_recording
from endolab.recording.show import picture_of
from endolab.recording.stream import png
from tests.tools.recorded import spoiled


@pytest.fixture(scope="module")
def seen():
    calibration = datasets.load_calibration("paper", width=64)
    scene = el.render(el.SCENES["colon"], calibration.camera, calibration.photometry)
    return el.Frame(scene.image, scene.mask), el.Calibration(scene.camera, scene.photometry)


@pytest.fixture(scope="module")
def solved(seen, tmp_path_factory):
    path = tmp_path_factory.mktemp("recordings") / "run.rrd"
    kept = []
    el.reconstruct(*seen, solver="primal_dual", max_iterations=60, observers=[el.record(path), kept.append])
    return kept, read_recording(path)


def test_curves_and_the_table_are_those_of_the_run(solved):
    iterates, recording = solved
    k, energy = recording.scalars["energy"]
    assert list(k) == [step.k for step in iterates]
    assert list(energy) == [step.energy for step in iterates]
    assert next(iter(recording.scalars)) == "energy"
    assert {"data", "regulariser", "change", *iterates[-1].scalars} < set(recording.scalars)
    table = recording.table()
    assert list(table["iteration"]) == [step.k for step in iterates]
    assert np.isnan(table["change"][0])  # the start has none
    assert table["change"][-1] == iterates[-1].change
    assert np.allclose(table["energy"], table["data"] + table["regulariser"], rtol=1e-12)


def test_depth_and_normals_are_those_of_the_iterates_and_what_has_none_says_where_the_nearest_is(solved):
    iterates, recording = solved
    assert recording.unit == "mm"
    assert np.array_equal(recording.mask, iterates[0].mask)
    assert recording.picture.shape == (48, 64, 3)
    assert "| solver | primal_dual |" in recording.settings
    for step in (iterates[0], iterates[-1]):
        assert np.allclose(recording.depth(step.k), step.distance, rtol=1e-6, equal_nan=True)
        cosine = np.sum(recording.normals(step.k) * step.normals, axis=-1)[step.mask]
        assert np.rad2deg(np.arccos(np.clip(cosine, -1, 1))).max() < 0.5
        assert np.isnan(recording.normals(step.k)[~step.mask]).all()
    assert np.array_equal(recording.depth(), recording.depth(iterates[-1].k), equal_nan=True)
    missing = next(k for k in range(200) if k not in recording.pictured)
    with pytest.raises(ValueError, match=f"iteration {missing} has no picture; the nearest that has is"):
        recording.depth(missing)


def test_a_comparison_of_nothing_leaves_no_file(tmp_path):
    with el.Comparison(tmp_path / "both.rrd") as both:
        both.run("never_started")
    assert list(tmp_path.iterdir()) == []


def test_two_runs_share_a_recording_and_a_timeline(seen, tmp_path):
    with el.Comparison(tmp_path / "both.rrd") as both:
        newton = el.reconstruct(*seen, channel="grey", observers=[both.run("gauss_newton")])
        assert list(tmp_path.iterdir()) == []  # not before it is whole
        how = {"solver": "primal_dual", "max_iterations": 40}
        paper = el.reconstruct(*seen, **how, observers=[both.run("primal_dual")])
        with pytest.raises(ValueError, match="'primal_dual': there is one already"):
            both.run("primal_dual")
        with pytest.raises(ValueError, match="expected a word"):
            both.run("a/b")
    both.close()
    recording = read_recording(both.path)
    assert list(recording.runs) == ["gauss_newton", "primal_dual"]
    for name, result in (("gauss_newton", newton), ("primal_dual", paper)):
        run = recording.runs[name]
        assert (list(run.runs), run.table()["energy"][-1]) == ([name], result.history[-1]["energy"])
        assert run.pictured[-1] == result.iterations
    assert np.allclose(recording.runs["gauss_newton"].depth(), newton.distance, rtol=1e-6, equal_nan=True)
    for ask in (lambda: recording.scalars, recording.depth, recording.table):
        with pytest.raises(ValueError, match="holds several runs: choose one"):
            ask()


def test_a_file_that_is_no_recording_is_named(solved, tmp_path):
    for name, (content, message) in spoiled(solved[1].path.read_bytes()).items():
        (tmp_path / f"{name}.rrd").write_bytes(content)
        with pytest.raises(ValueError, match=message) as error:
            read_recording(tmp_path / f"{name}.rrd")
        assert "\n" not in str(error.value)
        assert f"{name}.rrd" in str(error.value)
    with pytest.raises(FileNotFoundError, match=r"there is no recording .*missing\.rrd"):
        read_recording(tmp_path / "missing.rrd")


@pytest.mark.parametrize("seed", range(24))
def test_a_damaged_recording_is_one_sentence(solved, tmp_path, seed):
    """Bits, zeros, cuts, what is put elsewhere: nothing passes for a recording or ends Python."""
    chance, content = np.random.default_rng(seed), bytearray(solved[1].path.read_bytes())
    at, other = (int(place) for place in chance.integers(len(content), size=2))
    if seed % 4 == 0:
        content[at] ^= 1 << int(chance.integers(8))
    elif seed % 4 == 1:
        content[at : at + 300] = bytes(len(content[at : at + 300]))
    elif seed % 4 == 2:
        del content[at : at + 300]
    else:
        content[at : at + 1000] = content[other : other + 1000]
    (tmp_path / "run.rrd").write_bytes(content)
    with pytest.raises(ValueError, match=r"run\.rrd (is|was) ") as error:
        read_recording(tmp_path / "run.rrd")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("ending", ["os.abort()", "os._exit(1)", "b'x' * 2**44", "sys.exit('no')"])
def test_a_reader_that_dies_is_one_sentence(solved, tmp_path, monkeypatch, capfd, ending):
    (tmp_path / "decoder.py").write_text(f"import os, sys\nprint('half')\n{ending}\n")
    monkeypatch.setattr(decoder, "__file__", str(tmp_path / "decoder.py"))
    with pytest.raises(ValueError, match=r"run\.rrd is damaged: record the run again"):
        read_recording(solved[1].path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere memory has no limit")
def test_the_reader_has_an_end_and_little_memory():
    code = f"""
import sys, time
sys.path.insert(0, {str(Path(decoder.__file__).parent)!r})
import decoder
decoder.PATIENCE = 1
decoder._limit(0)
if sys.argv[1] == "time":
    time.sleep(600)
bytearray(2**33)
"""
    for what, last in (("time", "Timeout"), ("memory", "MemoryError")):
        done = subprocess.run([sys.executable, "-c", code, what], capture_output=True, text=True, check=False)
        assert done.returncode == 1
        assert last in done.stderr


# What a recording of another program may hold under our names, or an unfinished one lacks.
ODD = {
    "no picture of the frame": ("input", None),
    "no mask": ("mask", None),
    "no settings": ("settings", None),
    "no normals": ("normals", None),
    "a picture that is none": ("normals", rr.EncodedImage(contents=b"abc", media_type="image/png")),
    "an empty picture": ("input", rr.EncodedImage(contents=b"", media_type="image/png")),
    "normals of another size": ("normals", png(np.ones((3, 3, 3)))),
    "a mask of another size": ("mask", rr.SegmentationImage(np.ones((3, 3), np.uint8))),
    "a mask of another kind": ("mask", rr.SegmentationImage(np.ones((4, 5), np.uint16))),
    "distances of another kind": ("depth", rr.DepthImage(np.ones((4, 5), np.uint16), meter=1000.0)),
    "no distance": ("depth", rr.DepthImage(np.full((4, 5), np.nan, np.float32), meter=1000.0)),
    "a negative distance": ("depth", rr.DepthImage(np.full((4, 5), -1, np.float32), meter=1000.0)),
    "an infinite distance": ("depth", rr.DepthImage(np.full((4, 5), np.inf, np.float32), meter=1000.0)),
    "no unit": ("depth", rr.DepthImage(np.ones((4, 5), np.float32))),
    "an energy that is none": ("plots/energy", rr.Scalars(np.nan)),
    "words for numbers": ("plots/energy", rr.TextDocument("low")),
}


@pytest.mark.parametrize("odd", [None, *ODD])
def test_what_is_missing_or_odd_is_said_when_it_is_read(odd, tmp_path):
    logged = {
        "input": png(np.ones((4, 5, 3))),
        "mask": rr.SegmentationImage(np.ones((4, 5), np.uint8)),
        "settings": rr.TextDocument("fast"),
        "depth": rr.DepthImage(np.ones((4, 5), np.float32), meter=1000.0),
        "normals": png(np.ones((4, 5, 3))),
        "plots/energy": rr.Scalars(1.0),
    }
    if odd is not None:
        entity, what = ODD[odd]
        logged[entity] = what
    stream = rr.RecordingStream("another")
    memory = rr.binary_stream(stream)
    stream.set_time("iteration", sequence=0)
    for entity, what in logged.items():
        if what is not None:
            stream.log(entity, what)
    (tmp_path / "run.rrd").write_bytes(memory.read() or b"")
    if odd is None:
        assert picture_of(read_recording(tmp_path / "run.rrd")).axes
    elif odd == "words for numbers":
        assert read_recording(tmp_path / "run.rrd").runs == {}
    else:
        with pytest.raises(ValueError, match=r"run\.rrd is damaged: \w+") as error:
            read_recording(tmp_path / "run.rrd")
        assert "\n" not in str(error.value)


def test_a_recording_that_is_written_anew_by_another_program_is_not_trusted(solved, tmp_path):
    content = solved[1].path.read_bytes()
    (stamp,) = re.findall(rb"~[0-9a-f]{8}~", content)
    for other in (b"~00000000~", decoder.UNKNOWN):
        (tmp_path / "run.rrd").write_bytes(content.replace(stamp, other))
        if other == decoder.UNKNOWN:  # as if it had never been stamped
            assert read_recording(tmp_path / "run.rrd").runs
        else:
            with pytest.raises(ValueError, match="its checksum is another one"):
                read_recording(tmp_path / "run.rrd")


def test_a_recording_of_frames_holds_no_reconstruction(tmp_path):
    stream = rr.RecordingStream("endolab")
    memory = rr.binary_stream(stream)
    stream.set_time("frame", sequence=0)
    stream.log("plots/energy", rr.Scalars(1.0))
    (tmp_path / "video.rrd").write_bytes(memory.read() or b"")
    assert read_recording(tmp_path / "video.rrd").runs == {}


def test_a_recording_of_something_else_holds_no_reconstruction(tmp_path):
    stream = rr.RecordingStream("another")
    memory = rr.binary_stream(stream)
    stream.log("words", rr.TextDocument("hello"))
    (tmp_path / "other.rrd").write_bytes(memory.read() or b"")
    recording = read_recording(tmp_path / "other.rrd")
    assert recording.runs == {}
    for ask in (lambda: recording.scalars, recording.depth):
        with pytest.raises(ValueError, match="holds no reconstruction"):
            ask()


def test_a_long_recording_stays_small(tmp_path):
    """A hundred iterations that are all shown, at 320 x 240, take less than 20 MB."""
    calibration = datasets.load_calibration("paper", width=320)
    scene = el.render(el.SCENES["colon"], calibration.camera, calibration.photometry, noise=1, bits=8)
    frame, known = el.Frame(scene.image, scene.mask), el.Calibration(scene.camera, scene.photometry)
    steps = el.iterate(frame, known, solver="primal_dual", every=1)
    el.run(steps, observers=[el.record(tmp_path / "run.rrd")], max_iterations=100)
    recording = read_recording(tmp_path / "run.rrd")
    assert list(recording.scalars["energy"][0]) == list(range(101))
    assert (tmp_path / "run.rrd").stat().st_size < 20e6
