"""Recordings of runs: what was logged is what is read back, and the file is whole or not there."""

import contextlib
from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab.model.cameras import Pinhole
from endolab.solvers.energy import model_image
from endolab.solvers.provenance import Report
from endolab.workbench.recording.recorder import record_sequence
from tests.tools.problems import coloured_colon
from tests.tools.recorded import Recorded

PAPER = el.load_calibration("paper").camera
BY_HAND = Report({"solver": "by hand"})


def towards(camera, count, metric=True):
    """Iterates from the start to the truth, and the truth."""
    problem, seen = coloured_colon(camera, metric=metric, report=BY_HAND)
    goal = np.where(problem.mask, np.log(seen.distance), np.nan)
    steps = []
    for k in range(count):
        v = problem.log_d0 + (1 - 0.7**k) * (goal - problem.log_d0)
        previous = steps[-1] if steps else None
        steps.append(el.Iterate.of(problem, v, previous, scalars={"step": 0.5**k}))
    return steps, seen.distance


def iter_of(steps):
    yield from steps
    return el.Status.CONVERGED


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    """Iterates that were recorded, and what is read back."""
    steps, truth = towards(PAPER.resize(80, 60), 4)
    path = tmp_path_factory.mktemp("recording") / "run.rrd"
    el.run(iter_of(steps), observers=[el.record(path, truth=truth)])
    assert [file.name for file in path.parent.iterdir()] == ["run.rrd"]
    return steps, el.read_recording(path)


def assert_same_depth(recording, k, step):
    found = recording.depth(k)
    assert np.allclose(found, step.distance, rtol=1e-6, equal_nan=True)


def test_what_is_read_back_is_the_run(solved):
    steps, recording = solved
    table = recording.table()
    assert list(table["iteration"]) == [0, 1, 2, 3]
    assert list(table["energy"]) == [step.energy for step in steps]
    assert np.isnan(table["change"][0])  # the start has none
    assert table["change"][-1] == steps[-1].change
    assert list(table["step"]) == [step.scalars["step"] for step in steps]
    assert (recording.unit, recording.pictured) == ("mm", (0, 1, 2, 3))
    assert np.array_equal(recording.mask, steps[0].mask)
    assert np.abs(recording.picture - steps[0].problem.picture).max() < 0.003
    for k in (0, 3, -1):
        step = steps[k]
        assert_same_depth(recording, k, step)
        cosine = np.sum(recording.normals(k) * step.normals, axis=-1)
        assert np.rad2deg(np.arccos(np.clip(cosine[step.mask], -1, 1))).max() < 0.5
        assert np.isnan(cosine[~step.mask]).all()


def read_out(file, entity, k, since):
    """What the viewer tells of each pixel, in numbers; nan of what is left out, None of a line."""
    (named,) = file.rows[entity]["context"][since].to_pylist()
    infos = [one["class_description"]["info"] for one in named]
    words = {"left out": np.nan, "a round distance": np.inf}
    values = {
        one["id"]: words.get(one["label"]) or float(one["label"].split()[0])
        for one in infos
        if one["label"] in words or one["label"][0] in "-.0123456789"
    }
    return np.array([values[k] for k in file.at(entity, "buffer", k)])


def test_the_viewer_tells_what_was_found(solved):
    steps, recording = solved
    file = Recorded(recording.path)
    assert "| solver | by hand |" in file.text("/settings", "text", None)
    last = steps[-1]
    inside = last.mask
    seen = inside[::2, ::2]
    positions = file.at("/world/cloud", "positions", 3).reshape(-1, 3)
    assert np.allclose(positions, last.points[::2, ::2][seen], rtol=1e-6)
    residual = 255 * (model_image(last.problem, last.log_distance) - last.problem.image)
    found = read_out(file, "/residual", 3, None)
    expected = residual.clip(-10, 10).ravel()
    assert np.allclose(found, expected, atol=0.06, equal_nan=True)
    found = read_out(file, "/distance", 3, 0)
    lines = np.isinf(found)
    assert 0.01 < lines.mean() < 0.2
    near, far = el.plots.limits("distance", steps[0].distance)
    expected = last.distance.clip(near / 2, far).ravel()[~lines]
    assert np.allclose(found[~lines], expected, rtol=0.012, equal_nan=True)
    # The error of the start, from which the truth is 1 / (1 - 0.7³) of the way away.
    start, end = steps[0].log_distance, last.log_distance
    off = np.expm1((start - end) / (1 - 0.7**3))
    error = recording.table()["error"][0]
    assert error == pytest.approx(100 * np.nanmean(np.abs(off)))


def test_a_long_run_keeps_all_scalars_and_some_pictures_which_are_thinned(tmp_path):
    steps = towards(Pinhole(32, 24, 24.0, 24.0, 15.5, 11.5), 60)[0]
    el.run(iter_of(steps), observers=[el.record(tmp_path / "run.rrd", max_width=12)])
    recording = el.read_recording(tmp_path / "run.rrd")
    assert len(recording.table()) == 60
    assert (recording.pictured[:21], recording.pictured[-1]) == (tuple(range(21)), 59)
    assert len(recording.pictured) < 30
    assert recording.depth().shape == (8, 11)


def test_stages_runs_and_uncertainty_are_read_back(tmp_path):
    """Of a run that begins on a smaller grid and ends in mm."""
    coarse = towards(PAPER.resize(40, 30), 4, metric=False)[0]
    fine = towards(PAPER.resize(80, 60), 4, metric=False)[0]
    once = [replace(step, stage="bounced light", round=1) for step in coarse]
    twice = [replace(step, round=2) for step in once]
    mm = replace(fine[-1].problem, metric=True)
    last = replace(fine[-1], problem=mm, stage="scaled")
    steps = [*once, *twice, *fine, last]
    uncertainty = el.uncertainty_of(last, draws=4)
    path = tmp_path / "both.rrd"
    with el.record(path) as both:
        one = both.run("one")
        el.run(iter_of(steps), observers=[one])
        one.add_uncertainty(uncertainty, last)
        both.run("other")(last)
        assert not path.exists()  # not before it is whole
    runs = el.read_recording(path).runs
    assert list(runs) == ["one", "other"]
    assert_same_depth(runs["other"], 0, last)
    run = runs["one"]
    assert run.unit == "mm"
    assert list(run.table()["energy"]) == [step.energy for step in steps]
    # Ends of the stages before, all after.
    assert run.pictured == (0, 3, 4, 7, *range(8, 13))
    for k in run.pictured:
        assert_same_depth(run, k, steps[k])
        known = np.isfinite(run.normals(k)).all(axis=-1)
        assert np.array_equal(known, steps[k].mask)
    file = Recorded(path)
    assert list(file.numbers("/one/stage", "text")) == [0, 4, 8, 12]
    # Of one unit all distances have the same colours.
    colours = [file.rows[f"/{name}/distance"]["context"] for name in runs]
    assert colours[0][12] == colours[1][0]
    # A stage's curve begins anew with each round, after a gap.
    curve = file.numbers("/one/log10/energy/bounced_light", "scalars")
    assert list(curve) == list(range(8))
    assert list(file.numbers("/one/log10/energy/scaled", "scalars")) == [12]
    percent = (100 * uncertainty.sigma / last.distance).clip(0, 20).ravel()
    found = read_out(file, "/one/sigma", 12, None)
    assert np.allclose(found, percent, atol=0.11, equal_nan=True)
    source = file.at("/one/dominant_source", "buffer", 12)
    assert set(source) - {0} <= {6, 7, 8}
    assert np.array_equal(source > 0, last.mask.ravel())
    with pytest.raises(ValueError, match="several runs"):
        el.read_recording(path).depth()


# Whole, or not there ------------------------------------------------------------------
def test_an_interrupt_leaves_a_whole_file(tmp_path, solved):
    def interrupted():
        yield from solved[0][:2]
        raise KeyboardInterrupt

    (tmp_path / "run.rrd").write_bytes(b"an old recording")
    result = el.run(interrupted(), observers=[el.record(tmp_path / "run.rrd")])
    assert result.status is el.Status.STOPPED
    assert el.read_recording(tmp_path / "run.rrd").pictured == (0, 1)


def fails(recorder, steps):
    with recorder:
        recorder(steps[0])
        raise KeyboardInterrupt


def fails_beside(recorder, steps):
    with recorder as both:
        both.run("one")(steps[0])
        raise KeyboardInterrupt


def never_begins(recorder, steps):
    recorder.close()


def has_another_truth(recorder, steps):
    with recorder:
        recorder(towards(Pinhole(32, 32, 24.0, 24.0, 15.5, 15.5), 1)[0][0])


@pytest.mark.parametrize("what", [fails, fails_beside, never_begins, has_another_truth])
def test_nothing_is_left_of_a_run_that(what, tmp_path, solved):
    steps = solved[0]
    recorder = el.record(tmp_path / "run.rrd", truth=steps[0].distance)
    with contextlib.suppress(KeyboardInterrupt, ValueError):
        what(recorder, steps)
    assert list(tmp_path.iterdir()) == []


def test_a_run_goes_on_if_it_cannot_be_recorded(tmp_path, solved, monkeypatch):
    """Of several runs that share a file, too; what was there is not taken for theirs."""
    steps = solved[0]
    uncertainty = el.uncertainty_of(steps[-1], draws=4)
    (tmp_path / "run.rrd").write_bytes(b"an old recording")
    with el.record(tmp_path / "run.rrd") as both:
        one = both.run("one")
        one(steps[0])
        with monkeypatch.context() as patch:
            patch.delattr("endolab.workbench.recording.recorder.paint")
            result = el.run(iter_of(steps), observers=[one])
        assert result.iterations == 3
        one.add_uncertainty(uncertainty, result)
        both.run("other")(steps[0])
    (sentence,) = both.undrawn
    assert "run.rrd could not be drawn" in sentence
    assert list(tmp_path.iterdir()) == []


# Damaged files ------------------------------------------------------------------------
@pytest.mark.parametrize("content", [b"", b"RRF2", b"RRF2\0\x63\0\0" + bytes(99), None])
def test_what_is_no_recording_or_is_cut_off_is_named(content, tmp_path, solved):
    if content is None:
        content = solved[1].path.read_bytes()[:-1000]
    (tmp_path / "run.rrd").write_bytes(content)
    with pytest.raises(ValueError, match=r"run\.rrd is"):
        el.read_recording(tmp_path / "run.rrd")


def test_a_sequence_holds_its_frames_and_no_reconstruction(tmp_path):
    first, second = towards(PAPER.resize(640, 480), 2)[0]
    camera = first.problem.camera
    frames = []
    for number, step in ((3, second), (0, first)):
        row = {"index": number, "frame": "f.png", "energy": step.energy, "gain": np.nan}
        row |= dict.fromkeys(("median_distance", "iterations", "seconds"), 1.0)
        maps = {"distance": step.distance, "normals": step.normals}
        frames.append((row, step.problem.shown, maps))
    record_sequence(tmp_path / "frames.rrd", "mm", el.Calibration(camera), frames)
    file = Recorded(tmp_path / "frames.rrd")
    assert "/plots/gain" not in file.rows
    energies = file.numbers("/plots/energy", "scalars")
    assert energies == {0: first.energy, 3: second.energy}
    assert file.numbers("/distance", "buffer")[3].size == 320 * 240
    assert el.read_recording(tmp_path / "frames.rrd").runs == {}
