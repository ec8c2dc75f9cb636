"""Recordings: what was logged, read back from the file, and what becomes of the file when things go wrong."""

import _thread
import contextlib
import gc
import resource
import signal
import socket
import sys
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb

import endolab as el
from endolab.depth.energy import model_image
from endolab.model.cameras import Pinhole
from endolab.plots.scales import DECIDERS
from endolab.recording import layouts, viewer
from endolab.recording import recorder as recorder_module
from endolab.recording.pictures import Painter
from endolab.recording.reader import read_recording
from endolab.recording.stream import Sink
from tests.tools.problems import coloured_colon
from tests.tools.recorded import Recorded

PAPER = el.load_calibration("paper").camera


def frame(camera, metric=True):
    problem, seen = coloured_colon(camera, metric=metric, settings={"solver": "by hand"})
    return seen, problem


def towards(seen, problem, count):
    """Give iterates that go from the start to the truth, and the status that `run` expects."""
    goal = np.where(problem.mask, np.log(seen.distance), np.nan)
    current = None
    for k in range(count):
        v = problem.log_facing + (1 - 0.7**k) * (goal - problem.log_facing)
        arrived = problem.mask & (seen.distance < 20 + 10 * k)
        current = el.Iterate.of(problem, v, current, maps={"arrived": arrived}, scalars={"step": 0.5**k})
        yield current
    return el.Status.CONVERGED


def start_of(seen, problem, folder, **how):
    """Record the start alone, and read it back."""
    with contextlib.closing(el.record(folder / "run.rrd", **how)) as recorder:
        recorder(next(towards(seen, problem, 1)))
    return Recorded(folder / "run.rrd")


@pytest.fixture(scope="module")
def small():
    return frame(PAPER.resize(80, 60))


@pytest.fixture(scope="module")
def recorded(small, tmp_path_factory):
    seen, problem = small
    path = tmp_path_factory.mktemp("recording") / "run.rrd"
    kept = []
    result = el.run(towards(seen, problem, 4), observers=[el.record(path, truth=seen.distance), kept.append])
    assert result.status is el.Status.CONVERGED
    assert [file.name for file in path.parent.iterdir()] == ["run.rrd"]
    return kept, Recorded(path)


def test_every_entity_is_there(recorded):
    plots = {f"/plots/{name}" for name in ("energy", "data", "regulariser", "change", "step")}
    plots |= {f"/log10/{name}" for name in ("energy", "data", "regulariser", "change")}
    section = {f"/section/{name}" for name in ("now", "start", "truth", "scale", "length", "key", "names")}
    section |= {f"/scales/{name}/{part}" for name in ("depth", "residual") for part in ("bar", "words")}
    world = {"/world", "/world/camera", "/world/cloud", "/world/truth"}
    pictures = {"/input", "/mask", "/depth", "/normals", "/residual", "/front/arrived"}
    assert recorded[1].entities == pictures | plots | section | world | {"/settings"}


def test_scalars_are_those_of_the_iterates_and_depth_is_the_distance_in_millimetres(recorded):
    iterates, file = recorded
    for name in ("energy", "data", "regulariser", "step"):
        found = file.numbers(f"/plots/{name}", "scalars")
        expected = [{"energy": i.energy, **i.terms, **i.scalars}[name] for i in iterates]
        assert list(found) == [0, 1, 2, 3]
        assert [value.item() for value in found.values()] == expected
    change = file.numbers("/plots/change", "scalars")
    assert list(change) == [1, 2, 3]  # the start has none
    assert change[3].item() == iterates[3].change
    depth = file.numbers("/depth", "buffer")
    assert list(depth) == [0, 1, 2, 3]
    values = depth[3].astype(np.uint8).tobytes()
    stored = np.frombuffer(values, np.float32).reshape(60, 80)
    assert np.array_equal(stored, iterates[3].distance.astype(np.float32), equal_nan=True)
    assert file.numbers("/depth", "meter")[0] == 1000


def test_the_cloud_has_the_points_and_colours_of_the_mask_and_the_section_its_middle_column(recorded):
    iterates, file = recorded
    mask = iterates[2].mask
    positions = file.numbers("/world/cloud", "positions")
    assert list(positions) == [0, 1, 2, 3]
    assert np.allclose(positions[2].reshape(-1, 3), iterates[2].points[mask], rtol=1e-6)
    packed = file.numbers("/world/cloud", "colors")[None]
    red = (packed >> 24) & 255
    assert np.array_equal(red, np.round(255 * iterates[2].problem.picture[mask][:, 0]))
    assert file.numbers("/world/truth", "positions")[None].size == 3 * mask.sum()
    now = file.numbers("/section/now", "strips")
    assert list(now) == [0, 1, 2, 3]
    line = iterates[3].points[:, 40][:, [2, 1]]
    inside = iterates[3].mask[:, 40]
    assert np.allclose(now[3].reshape(-1, 2), line[inside], rtol=1e-6)


def test_pictures_show_what_they_say(recorded, small):
    iterates, file = recorded
    problem = small[1]
    assert np.array_equal(file.picture("/input", None), np.round(255 * problem.picture))
    normals = file.picture("/normals", 1)
    expected = np.round(255 * (iterates[1].normals + 1) / 2)
    assert np.array_equal(normals[problem.mask], expected[problem.mask])
    assert not normals[~problem.mask].any()
    arrived = file.picture("/front/arrived", 2)[..., 0]
    assert np.array_equal(arrived == 255, iterates[2].maps["arrived"])
    residual = file.picture("/residual", 0).astype(int)
    error = model_image(problem, iterates[0].log_distance) - problem.image
    bright, dark = error > 0.02, error < -0.02
    assert (residual[bright][:, 0] >= residual[bright][:, 2]).all()
    assert (residual[dark][:, 0] <= residual[dark][:, 2]).all()
    assert not residual[~problem.mask].any()
    mask = file.numbers("/mask", "buffer")[None].astype(bool)
    assert np.array_equal(mask.reshape(60, 80), problem.mask)


def test_curves_are_there_as_logarithms_too(recorded, tmp_path):
    iterates, file = recorded
    for name in ("energy", "data", "regulariser", "change"):
        plain, log10 = (file.numbers(f"/{folder}/{name}", "scalars") for folder in ("plots", "log10"))
        assert list(plain) == list(log10)
        assert all(10 ** log10[k].item() == pytest.approx(plain[k].item()) for k in plain)
    with contextlib.closing(el.record(tmp_path / "run.rrd")) as recorder:
        for iterate in iterates:
            recorder(replace(iterate, terms={**iterate.terms, "regulariser": 0.0}))
    zero = Recorded(tmp_path / "run.rrd")
    assert "scalars" in zero.rows["/plots/regulariser"]
    assert "scalars" not in zero.rows["/log10/regulariser"]


def test_colours_reach_what_the_end_needs_and_their_scale_says_so(recorded):
    iterates, file = recorded
    last = iterates[-1]
    near, far = np.percentile(last.distance[last.mask], [1, 99])
    assert file.numbers("/depth", "depth_range")[None].reshape(2) == pytest.approx([near, far], rel=1e-6)
    bar = file.numbers("/scales/depth/bar", "strips")[None].reshape(-1, 2)
    assert bar[:, 0].min() > 80  # beside the map
    assert (bar[:, 1].max(), bar[:, 1].min()) == (60, 0)
    packed = file.numbers("/scales/depth/bar", "colors")[None]
    dark, bright = [((packed[i] >> np.array([24, 16, 8])) & 255).tolist() for i in (0, -1)]
    assert (dark, bright) == ([68, 1, 84], [253, 231, 37])  # viridis, as the viewer paints depth
    words = [file.rows["/scales/depth/words"]["labels"][None][i].as_py() for i in range(3)]
    assert words == [f"{value:.3g}" for value in (far, (near + far) / 2, near)]
    error = 255 * np.abs(model_image(last.problem, last.log_distance) - last.problem.image)
    most = float(file.rows["/scales/residual/words"]["labels"][None][0].as_py())
    assert most == pytest.approx(max(np.percentile(error[last.mask], 98), 1.0), rel=0.06)
    darkest = file.picture("/residual", 3)[last.mask].astype(int).sum(axis=-1).min()
    assert darkest <= 204  # blue or red at its end, not near white


def test_pictures_have_a_timeline_of_their_own(tmp_path):
    seen, problem = frame(PAPER.resize(32, 24))
    path = tmp_path / "run.rrd"
    el.run(towards(seen, problem, 60), observers=[el.record(path)])
    numbers = {}
    for chunk in rr.chunk.RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        entity = batch.schema.metadata[b"rerun:entity_path"].decode()
        if "picture" in batch.schema.names:
            pairs = zip(*(batch.column(name).to_pylist() for name in ("iteration", "picture")), strict=True)
            numbers.setdefault(entity, {}).update(pairs)
    pictured = read_recording(path).pictured
    assert len(pictured) < 30
    for entity in ("/depth", "/residual", "/world/cloud", "/section/now", "/plots/energy", "/log10/energy"):
        assert numbers[entity] == {k: n for n, k in enumerate(pictured)}


def test_a_start_with_spikes_does_not_widen_the_section(tmp_path, small):
    seen, problem = small
    *_, last = towards(seen, problem, 40)
    spiky = replace(problem, image=np.where(np.arange(60)[:, None] == 30, 1e-3, problem.image))
    last = el.Iterate.of(spiky, last.log_distance)
    boxes = []
    for name, truth in (("alone", None), ("with", seen.distance)):
        with contextlib.closing(el.record(tmp_path / f"{name}.rrd", truth=truth)) as recorder:
            recorder(last)
        boxes.append(recorder.shown.box)
        file = Recorded(tmp_path / f"{name}.rrd")
        line = file.numbers("/section/now", "strips")[0].reshape(-1, 2)
        start = file.numbers("/section/start", "strips")[None].reshape(-1, 2)
        assert np.exp(spiky.log_facing[30, 40]) > 3 * line[:, 0].max()
        width, height = boxes[-1][1] - boxes[-1][0]
        assert start[:, 0].max() <= boxes[-1][1, 0] + 0.07 * width
        assert np.ptp(start[:, 1]) <= 1.13 * height
    assert boxes[0][1] == pytest.approx(line.max(axis=0))
    assert (boxes[1][1] >= boxes[0][1]).all()


def test_settings_are_legible(recorded, small):
    text = recorded[1].text("/settings", "text")
    photometry = small[1].photometry
    assert recorded[1].text("/settings", "media_type") == "text/markdown"
    for part in ("| distances | mm |", "| k | 2.5 |", "| γ | 2.2 |", "| solver | by hand |", "λ = 1,"):
        assert part in text
    assert f"| gain | {photometry.gain:.6g} |" in text


def test_without_a_gain_it_says_relative(tmp_path):
    seen, problem = frame(PAPER.resize(40, 30), metric=False)
    file = start_of(seen, problem, tmp_path, truth=10 * seen.distance)
    assert "**relative units**" in file.text("/settings", "text")
    truth = file.numbers("/world/truth", "positions")[None].reshape(-1, 3)
    cloud = file.numbers("/world/cloud", "positions")[0].reshape(-1, 3)
    ratio = np.linalg.norm(cloud, axis=1) / np.linalg.norm(truth, axis=1)
    assert np.median(ratio) == pytest.approx(1, abs=1e-3)


def test_a_pinhole_keeps_its_numbers_and_a_fisheye_its_rim(tmp_path, recorded):
    seen, problem = frame(Pinhole(40, 30, 30.0, 31.0, 19.0, 15.0))
    camera = start_of(seen, problem, tmp_path)
    matrix = camera.numbers("/world/camera", "image_from_camera")[None].reshape(3, 3).T
    assert np.allclose(matrix, [[30, 0, 19], [0, 31, 15], [0, 0, 1]])
    strips = recorded[1].numbers("/world/camera", "strips")[None].reshape(-1, 3)
    rim = strips[:97] / np.linalg.norm(strips[:97], axis=1, keepdims=True)
    pixels = PAPER.resize(80, 60).project(rim)
    to_edge = np.minimum(pixels + 0.5, [79.5, 59.5] - pixels).min(axis=1)
    angle = np.arccos(rim[:, 2])
    assert (to_edge > -1e-3).all()
    assert ((to_edge < 0.5) | (angle > PAPER.max_angle - 0.2)).all()


def test_a_truth_of_another_size_is_named(tmp_path, small):
    recorder = el.record(tmp_path / "run.rrd", truth=np.ones((3, 4)))
    with pytest.raises(ValueError, match=r"truth has shape \(3, 4\), the frame \(60, 80\)"):
        recorder(next(towards(*small, 1)))
    recorder.close()
    assert list(tmp_path.iterdir()) == []


def test_large_pictures_are_thinned(tmp_path):
    seen, problem = frame(PAPER.resize(80, 60))
    file = start_of(seen, problem, tmp_path, max_width=30)
    assert file.picture("/input", None).shape == (20, 27, 3)
    assert file.numbers("/world/cloud", "positions")[0].size == 3 * problem.mask[::3, ::3].sum()


def test_a_long_run_keeps_all_scalars_and_some_pictures(tmp_path):
    seen, problem = frame(PAPER.resize(32, 24))
    recorder = el.record(tmp_path / "run.rrd")
    el.run(towards(seen, problem, 60), observers=[recorder])
    file = Recorded(tmp_path / "run.rrd")
    assert list(file.numbers("/plots/energy", "scalars")) == list(range(60))
    shown = list(file.numbers("/depth", "buffer"))
    assert (shown[:21], shown[-1]) == (list(range(21)), 59)
    assert len(shown) < 45
    assert list(file.numbers("/world/cloud", "positions")) == shown


@pytest.fixture
def painted(monkeypatch):
    """Places of the iterates whose pictures are made, as they are made."""
    places, paint = [], Painter.paint

    def noted(painter, iterate):
        places.append(iterate.k)
        return paint(painter, iterate)

    monkeypatch.setattr(Painter, "paint", noted)
    return places


def test_pictures_are_made_when_the_run_has_ended(tmp_path, small, painted):
    recorder = el.record(tmp_path / "run.rrd")
    for iterate in towards(*small, 4):
        recorder(iterate)
        _ = iterate.points, iterate.normals
    assert painted == []
    recorder.close()
    assert sorted(painted) == [0, 1, 2, 3]


def test_no_more_is_kept_than_a_bound(tmp_path, small, painted, monkeypatch):
    """What is made during the run then is the same; of what waits, nothing that others asked for."""
    steps = list(towards(*small, 9))
    each = steps[0].log_distance.nbytes + steps[0].maps["arrived"].nbytes
    monkeypatch.setattr(recorder_module, "KEPT", int(2.5 * each))
    bounded, _ = el.record(tmp_path / "bounded.rrd"), steps[0].points
    for step in steps:
        bounded(step)
        assert bounded._kept <= 2.5 * each
        assert all("points" not in vars(kept) for *_, kept in bounded._waiting)
    before = len(painted)  # the last of three jobs may go on
    assert before >= 3
    bounded.close()
    monkeypatch.undo()
    el.run(iter_of(steps), observers=[el.record(tmp_path / "whole.rrd")])
    one, other = (Recorded(tmp_path / f"{name}.rrd") for name in ("bounded", "whole"))
    assert one.entities == other.entities
    for entity in ("/depth", "/normals", "/residual", "/front/arrived", "/world/cloud", "/section/now"):
        assert one.rows[entity].keys() == other.rows[entity].keys()
        for component, rows in one.rows[entity].items():
            assert rows == other.rows[entity][component]


def test_an_interrupt_leaves_a_whole_file(tmp_path, small):
    def interrupted():
        yield from towards(*small, 2)
        raise KeyboardInterrupt

    (tmp_path / "run.rrd").write_bytes(b"an old recording")
    result = el.run(interrupted(), observers=[el.record(tmp_path / "run.rrd")])
    assert result.status is el.Status.STOPPED
    assert list(Recorded(tmp_path / "run.rrd").numbers("/plots/energy", "scalars")) == [0, 1]


def test_ctrl_c_as_a_recording_begins_loses_nothing_of_it(tmp_path, small, monkeypatch, capfd):
    """Rerun complains on stderr of a memory that is lost before it was read."""

    def slow(stream, make=rr.binary_stream):
        memory = make(stream)
        _thread.interrupt_main()
        time.sleep(0.1)
        return memory

    monkeypatch.setattr(rr, "binary_stream", slow)
    recorder = el.record(tmp_path / "run.rrd")
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job ignores it
    try:
        with pytest.raises(KeyboardInterrupt), recorder:
            recorder(next(towards(*small, 1)))
    finally:
        signal.signal(signal.SIGINT, handler)
    recorder.close()
    gc.collect()
    assert "Dropping data" not in capfd.readouterr().err


def test_ctrl_c_before_the_memory_is_made_leaves_none_that_comes_late(tmp_path, monkeypatch, capfd):
    late = []

    class Late(threading.Thread):
        def start(self):
            late.append(self._target)
            raise KeyboardInterrupt

    monkeypatch.setattr(threading, "Thread", Late)
    sink = Sink(tmp_path / "run.rrd")
    with pytest.raises(KeyboardInterrupt), sink:
        sink.begin()
    for target in late:
        target()
    assert len(late) == 1
    late.clear()
    del sink, target
    gc.collect()
    assert "Dropping data" not in capfd.readouterr().err


def test_without_an_iterate_there_is_no_file(tmp_path):
    recorder = el.record(tmp_path / "run.rrd")
    recorder.close()
    recorder.close()
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ValueError, match="closed"):
        recorder(None)


def test_a_file_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "folder.rrd").mkdir()
    for path in (tmp_path / "missing" / "run.rrd", tmp_path / "folder.rrd"):
        with pytest.raises(OSError, match=r"cannot write the recording .*") as error:
            el.record(path)
        assert str(path) in str(error.value)
    assert [file.name for file in tmp_path.iterdir()] == ["folder.rrd"]
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="cannot write the recording"):
        el.record(tmp_path / "file" / "run.rrd")


@contextlib.contextmanager
def file_limit(size):
    """Let no file grow beyond a size: writes fail as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_full_disk_leaves_nothing(tmp_path, small):
    (tmp_path / "run.rrd").write_bytes(b"an old recording")
    recorder = el.record(tmp_path / "run.rrd")
    with file_limit(50_000), pytest.raises(OSError, match=r"cannot write .*run\.rrd: File too large"):
        el.run(towards(*small, 3), observers=[recorder])
    recorder.close()
    assert [file.name for file in tmp_path.iterdir()] == ["run.rrd"]
    assert (tmp_path / "run.rrd").read_bytes() == b"an old recording"


def test_a_path_or_a_viewer_and_a_sensible_width(tmp_path):
    for wrong in ({}, {"path": tmp_path / "run.rrd", "spawn": True}):
        with pytest.raises(ValueError, match="either a path or spawn"):
            el.record(**wrong)
    with pytest.raises(ValueError, match=r"ends in \.rrd, got .*run\.txt"):
        el.record(tmp_path / "run.txt")
    with pytest.raises(ValueError, match="max_width"):
        el.record(tmp_path / "run.rrd", max_width=0)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there is always a screen")
def test_a_viewer_without_a_screen_says_so(monkeypatch):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        monkeypatch.setattr(viewer, "PORT", free.getsockname()[1])
    for variable in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(variable, raising=False)
    with pytest.raises(OSError, match="needs a screen"):
        el.record(spawn=True)


def in_stages(round_by_round=2):
    """Iterates of a run that begins on a smaller grid and ends in mm, and the truth."""
    coarse, fine = (frame(PAPER.resize(*size), metric=False) for size in ((40, 30), (80, 60)))
    steps = [
        replace(step, stage="bounced light", round=n, maps={"light": step.maps["arrived"]})
        for n in range(1, round_by_round + 1)
        for step in towards(*coarse, 3)
    ]
    steps += towards(*fine, 4)
    mm = replace(fine[1], metric=True)
    last = replace(steps[-1], problem=mm, log_distance=steps[-1].log_distance + np.log(2.0), stage="scaled")
    return [*steps, last], fine[0].distance


@pytest.fixture(scope="module")
def staged(tmp_path_factory):
    path = tmp_path_factory.mktemp("recording") / "stages.rrd"
    steps, truth = in_stages()
    with contextlib.closing(el.record(path, truth=truth)) as recorder:
        for step in steps:
            recorder(step)
    return steps, Recorded(path), read_recording(path)


def test_the_timeline_runs_on_over_all_stages(staged):
    steps, file, recording = staged
    assert list(file.numbers("/plots/energy", "scalars")) == list(range(len(steps)))
    assert list(recording.table()["energy"]) == [step.energy for step in steps]
    assert recording.pictured == (0, 2, 3, *range(5, len(steps)))  # ends of the stages before, all after
    stages = [(0, "bounced light", 1), (3, "bounced light", 2), (6, "solution", 0), (10, "scaled", 0)]
    assert recording.stages == stages
    assert file.text("/stage", "text", 3) == "bounced light, round 2"


def test_what_stays_for_a_stage_is_logged_as_it_begins_and_never_for_all_times(staged):
    steps, file, _ = staged
    begins = [0, 3, 6, 10]
    for entity, component in (
        *(("/input", "blob"), ("/mask", "buffer"), ("/settings", "text"), ("/world/camera", "strips")),
        *(("/world/cloud", "colors"), ("/world/truth", "positions")),
        *(("/section/start", "strips"), ("/section/truth", "strips")),
    ):
        assert sorted(file.rows[entity][component]) == begins
    for entity in ("/section/scale", "/scales/depth/bar", "/scales/residual/bar"):
        assert sorted(file.rows[entity]["strips"]) == [0, 6, 10]  # as grid and unit change
    assert (file.picture("/input", 3).shape, file.picture("/input", 6).shape) == ((30, 40, 3), (60, 80, 3))
    sizes = {k: colours.size for k, colours in file.numbers("/world/cloud", "colors").items()}
    assert sizes == {k: steps[k].mask.sum() for k in begins}
    assert "**relative units**" in file.text("/settings", "text", 6)
    assert "| distances | mm |" in file.text("/settings", "text", 10)
    assert not file.picture("/front/light", 6).any()  # gone with its stage
    # The truth lies where the stage believes it, on the grid of the stage, and in mm at the end.
    for k in begins:
        truth = file.at("/world/truth", "positions", k).reshape(-1, 3)
        cloud = file.at("/world/cloud", "positions", k).reshape(-1, 3)
        assert len(truth) <= len(cloud)
        if k < 10:
            ratio = np.median(np.linalg.norm(cloud, axis=1)) / np.median(np.linalg.norm(truth, axis=1))
            assert ratio == pytest.approx(1, abs=0.1)


def test_stages_and_rounds_are_lanes_of_the_timeline_and_the_start_is_not_the_end(staged):
    _, file, _ = staged
    states = {
        entity: {k: rows[0].as_py() for k, rows in file.rows[entity]["state"].items()}
        for entity in ("/stage", "/round")
    }
    assert states["/stage"] == {0: "bounced light", 3: "bounced light", 6: "solution", 10: "scaled"}
    assert states["/round"] == {0: "1", 3: "2", 6: "-", 10: "-"}
    start, end = (file.at("/section/start", "strips", 10), file.at("/section/now", "strips", 10))
    assert start.shape != end.shape or not np.allclose(start, end, rtol=1e-3)


def test_each_stage_is_read_back_on_its_own_grid(staged):
    steps, _, recording = staged
    for k in (0, 5, 6, 10):
        step = steps[k]
        assert np.allclose(recording.depth(k), step.distance, rtol=1e-6, equal_nan=True)
        cosine = np.sum(recording.normals(k) * step.normals, axis=-1)[step.mask]
        assert np.rad2deg(np.arccos(np.clip(cosine, -1, 1))).max() < 0.5
        assert np.array_equal(np.isfinite(recording.normals(k)).all(axis=-1), step.mask)
    assert recording.unit == "mm"
    assert np.array_equal(recording.mask, steps[-1].mask)
    assert recording.picture.shape == (60, 80, 3)
    assert "| distances | mm |" in recording.settings
    assert np.allclose(recording.depth(), 2 * recording.depth(9), rtol=1e-6, equal_nan=True)


def test_a_run_of_one_stage_stays_as_it_was(recorded, tmp_path):
    steps, file = recorded
    assert None in file.rows["/input"]["blob"]
    el.run(iter_of(steps), observers=[el.record(tmp_path / "run.rrd")])
    assert read_recording(tmp_path / "run.rrd").stages == [(0, "solution", 0)]
    el.run(
        iter_of([replace(step, stage="march") for step in steps]),
        observers=[el.record(tmp_path / "march.rrd")],
    )
    assert read_recording(tmp_path / "march.rrd").stages == [(0, "march", 0)]


def test_the_layout_shows_the_stage_and_what_all_stages_have(tmp_path):
    recorder = el.record(tmp_path / "run.rrd")
    steps, _ = in_stages()
    el.run(iter_of(steps), observers=[recorder])
    assert recorder.shown.staged
    assert (recorder.shown.unit, recorder.shown.maps) == ("mm", ("light", "arrived"))


def test_stages_side_by_side(tmp_path):
    steps, truth = in_stages(1)
    with el.Comparison(tmp_path / "both.rrd", truth=truth) as both:
        for name, seen in (("all", steps), ("last", steps[3:7])):
            observer = both.run(name)
            for step in seen:
                observer(step)
    runs = read_recording(tmp_path / "both.rrd").runs
    assert [name for _, name, _ in runs["all"].stages] == ["bounced light", "solution", "scaled"]
    assert (runs["last"].stages, runs["last"].pictured) == ([(0, "solution", 0)], (0, 1, 2, 3))


def test_runs_side_by_side_have_the_same_colours_and_a_surface_each(tmp_path, small):
    steps = list(towards(*small, 30))
    with el.Comparison(tmp_path / "both.rrd") as both:
        recorders = {name: both.run(name) for name in ("short", "long")}
        el.run(iter_of(steps[:7]), observers=[recorders["short"]])
        el.run(iter_of(steps), observers=[recorders["long"]])
    file = Recorded(tmp_path / "both.rrd")
    reach = [file.numbers(f"/{name}/depth", "depth_range")[None].reshape(2) for name in recorders]
    ends = [np.percentile(steps[k].distance[steps[k].mask], [1, 99]) for k in (6, 29)]
    assert np.array_equal(*reach)
    assert reach[0] == pytest.approx([min(ends[0][0], ends[1][0]), max(ends[0][1], ends[1][1])], rel=1e-6)
    labels = [file.rows[f"/{name}/scales/residual/words"]["labels"][None].to_pylist() for name in recorders]
    assert labels[0] == labels[1]
    layout = layouts.comparison([recorder.shown for recorder in recorders.values()])
    surfaces = [view.name for view in spaces(layout.root_container)]
    assert surfaces == ["Surface [mm] · short", "Surface [mm] · long"]
    assert (layout.time_panel.timeline, layout.time_panel.fps) == ("picture", 2)


def test_seven_iterates_can_be_watched_and_a_long_run_does_not_take_all_day(tmp_path, small):
    steps = list(towards(*small, 7))
    with contextlib.closing(el.record(tmp_path / "run.rrd")) as recorder:
        for step in steps:
            recorder(step)
    for how in layouts.BLUEPRINTS.values():
        for last, seconds in ((recorder.shown.last, 6), (600, 20)):
            panel = how(replace(recorder.shown, last=last)).time_panel
            assert (panel.timeline, last / panel.fps) == ("iteration", pytest.approx(seconds))
        titles = views(how(recorder.shown).root_container)
        assert {"log₁₀ energy", "Distance [mm]", "Residual [1/255]", "Middle column"} <= set(titles)


def test_a_truth_must_fit_the_solution_or_have_its_shape(tmp_path):
    steps, truth = in_stages()
    recorder = el.record(tmp_path / "run.rrd", truth=truth[::2])
    refused = pytest.raises(ValueError, match=r"truth has shape \(30, 80\), the frame \(30, 40\)")
    with contextlib.closing(recorder), refused:
        recorder(steps[0])


@pytest.fixture(scope="module")
def trusted(tmp_path_factory):
    """A run that ends in mm after stages on a smaller grid, and how far that can be trusted."""
    steps, _ = in_stages()
    trust = el.trust_of(steps[-1], draws=4)
    path = tmp_path_factory.mktemp("trust") / "run.rrd"
    with el.record(path) as recorder:
        el.run(iter_of(steps), observers=[recorder])
        recorder.add_trust(trust, steps[-1])
        assert not path.exists()
    return steps, trust, path, recorder


def test_trust_is_recorded_in_percent_with_names(trusted):
    steps, trust, path, recorder = trusted
    file, mask = Recorded(path), steps[-1].mask
    sigma = file.numbers("/front/trust/sigma", "buffer")[None].astype(np.uint8).view(np.float32)
    percent = 100 * trust.sigma / steps[-1].distance
    assert np.allclose(sigma.reshape(60, 80), percent, rtol=1e-6, equal_nan=True)
    least, most = file.numbers("/front/trust/sigma", "depth_range")[None].reshape(2)
    assert (least, most) == (0, recorder.shown.sigma)
    labels = file.rows["/scales/sigma/words"]["labels"][None].to_pylist()
    assert labels == [f"{most:.3g}", f"{most / 2:.3g}", "0"]
    assert file.rows["/scales/decided_by/words"]["labels"][None].to_pylist() == [*DECIDERS]
    assert np.mean(percent[mask] <= 1.05 * most) > 0.97
    assert np.mean(percent[mask] >= 0.9 * most) > 0.005
    decided = file.numbers("/front/trust/decided_by", "buffer")[None].reshape(60, 80)
    assert np.array_equal(decided, trust.decided_by)
    names = str(file.rows["/front/trust/decided_by"]["context"][None])
    assert all(name in names for name in ("left out", "data", "border or contour", "prior"))
    seen = file.numbers("/front/trust/mask", "buffer")[None].reshape(60, 80)
    assert np.array_equal(seen, mask)
    words = file.text("/front/trust/words", "text")
    assert f"{np.median(percent[mask]):.2g} % for the median pixel" in words
    assert f"data {100 * np.mean(trust.decided_by[mask] == 1):.0f} %" in words
    assert all(f"| {cause} |" in words for cause in trust.causes)
    assert trust.notes[0] in words


def test_a_recording_with_trust_is_read_as_one_without(trusted, staged):
    steps, _, path, _ = trusted
    kept = read_recording(path)
    assert kept.stages == staged[2].stages
    assert np.array_equal(kept.depth(), staged[2].depth(), equal_nan=True)
    assert (kept.mask == steps[-1].mask).all()


def test_trust_is_read_back_in_the_unit_of_the_depth(trusted, staged, tmp_path):
    """To single precision; None where none was written, in a run beside another too."""
    steps, trust, path, _ = trusted
    kept = read_recording(path)
    assert np.allclose(kept.sigma, trust.sigma, rtol=1e-6, equal_nan=True)
    assert np.array_equal(kept.decided_by, trust.decided_by)
    assert (staged[2].sigma, staged[2].decided_by) == (None, None)
    with el.Comparison(tmp_path / "both.rrd") as both:
        with both.run("one") as observer:
            el.run(iter_of(steps), observers=[observer])
            observer.add_trust(trust, steps[-1])
        both.run("other")(steps[-1])
    one, other = (read_recording(tmp_path / "both.rrd").runs[name] for name in ("one", "other"))
    assert np.array_equal(one.sigma, kept.sigma, equal_nan=True)
    assert (other.sigma, other.decided_by) == (None, None)


@pytest.mark.parametrize("name", ["sigma", "decided_by"])
def test_a_trust_that_cannot_be_is_damage(tmp_path, trusted, name):
    steps, trust, _, _ = trusted
    wrong = replace(trust, **{name: 0 * trust.decided_by if name == "decided_by" else -trust.sigma})
    with el.record(tmp_path / "run.rrd") as recorder:
        recorder(steps[-1])
        recorder.add_trust(wrong, steps[-1])
    with pytest.raises(ValueError, match="is damaged: the trust is not that"):
        read_recording(tmp_path / "run.rrd")


def views(layout):
    """Names of the views of a layout."""
    parts = getattr(layout, "contents", None)
    inside = [view for part in parts or () if not isinstance(part, str) for view in views(part)]
    return [layout.name, *inside] if isinstance(layout, rrb.View) else inside


def spaces(layout):
    """Views in space of a layout."""
    parts = [part for part in getattr(layout, "contents", None) or () if not isinstance(part, str)]
    return [layout] if isinstance(layout, rrb.Spatial3DView) else [v for part in parts for v in spaces(part)]


def test_the_layout_shows_trust_where_there_is_some(trusted):
    shown = trusted[3].shown
    for layout in (layouts.reconstruction, lambda one: layouts.comparison([one])):
        with_trust, without = (
            views(layout(one).root_container) for one in (shown, replace(shown, sigma=None))
        )
        assert [name for name in without if name in with_trust] == without
        for title in ("σ [%]", "Who decided"):
            assert title in with_trust
            assert title not in without


def test_trust_comes_before_the_end_and_of_what_was_recorded(tmp_path, trusted, small):
    steps, trust, _, _ = trusted
    recorder = el.record(tmp_path / "run.rrd")
    with pytest.raises(ValueError, match="nothing was recorded"):
        recorder.add_trust(trust, steps[-1])
    with recorder:
        recorder(steps[0])
        with pytest.raises(ValueError, match=r"trust has shape \(60, 80\), .* recorded \(30, 40\)"):
            recorder.add_trust(trust, steps[-1])
    assert (tmp_path / "run.rrd").exists()
    with pytest.raises(ValueError, match="closed: use it as a context manager"):
        recorder.add_trust(trust, steps[-1])


def refuse(_):
    raise ValueError("nothing of it")


def test_a_block_that_fails_leaves_what_was_recorded(tmp_path, trusted):
    steps = trusted[0]
    with pytest.raises(ValueError, match="nothing of it"), el.record(tmp_path / "run.rrd") as recorder:
        el.run(iter_of(steps[-1:]), observers=[recorder, refuse])
    assert read_recording(tmp_path / "run.rrd").pictured == (steps[-1].k,)


def test_trust_of_one_run_of_several(tmp_path, trusted):
    steps, trust, _, _ = trusted
    with el.Comparison(tmp_path / "both.rrd") as both:
        with both.run("one") as observer:
            el.run(iter_of(steps), observers=[observer])
            observer.add_trust(trust, steps[-1])
        both.run("other")(steps[-1])
    entities = Recorded(tmp_path / "both.rrd").entities
    assert "/one/front/trust/sigma" in entities
    assert "/other/front/trust/sigma" not in entities


def test_trust_of_a_large_picture_is_thinned_with_it(tmp_path):
    seen, problem = frame(PAPER.resize(160, 120))
    *_, last = towards(seen, problem, 3)
    with el.record(tmp_path / "run.rrd", max_width=80) as recorder:
        recorder(last)
        recorder.add_trust(el.trust_of(last, draws=4), last)
    file = Recorded(tmp_path / "run.rrd")
    assert file.numbers("/front/trust/decided_by", "buffer")[None].size == 80 * 60
    assert file.numbers("/front/trust/sigma", "buffer")[None].size == 4 * 80 * 60


def iter_of(steps):
    yield from steps
    return el.Status.CONVERGED
