"""Sweeps: one tidy table, on one core, on more, or on a cluster of Dask's."""

import csv
from contextlib import nullcontext
from dataclasses import replace

import joblib
import pytest

import endolab as el
from endolab.batch.sweep import SWEEP_COLUMNS, sweep
from endolab.workbench.recording.layouts import LAMBDAS
from tests.tools.cases import drawn
from tests.tools.recorded import Recorded

GREEN = el.load_calibration("simple").photometry.channel("green")
SEEN = [
    drawn(name, "simple", 64, replace(GREEN, gain=900.0), noise=1.0)
    for name in ("plane", "tube")
]
CALIBRATION = SEEN[0].calibration


@pytest.fixture
def frames():
    return [one.frame for one in SEEN]


def test_each_with_each_is_one_row(frames, tmp_path):
    truth = [(one.distance, one.normals) for one in SEEN]
    path = tmp_path / "t.csv"
    calls = []
    grid = {"lam": (0.1, 1.0), "xi": ("1/d", "d"), "regulariser": ("first", "second")}
    how = {"truth": truth, "table": path, "progress": lambda *call: calls.append(call)}
    rows = sweep(frames, CALIBRATION, **grid, **how)
    assert calls == [(number, 16, row) for number, row in enumerate(rows, 1)]
    with open(path, newline="", encoding="utf-8") as stream:
        stored = list(csv.DictReader(stream))
    assert tuple(stored[0]) == SWEEP_COLUMNS
    assert len({tuple(row.values()) for row in stored}) == len(rows) == 16
    assert [float(row["energy"]) for row in stored] == [row["energy"] for row in rows]
    for row in rows:
        assert (row["error"], row["seconds"] > 0) == ("", True)
        if row["regulariser"] == "second":  # the first order wants a smaller λ
            assert 0 < row["mean_percent"] < 10
    setting = {"lam": 0.1, "xi": "d", "regulariser": "first"}
    asked = (setting | {"frame": "tube"}).items()
    (same,) = (row for row in rows if asked <= row.items())
    one = el.reconstruct(frames[1], CALIBRATION, **setting)
    assert same["energy"] == pytest.approx(one.energy, rel=1e-9)


@pytest.mark.parametrize("backend", ["loky", "threading", "dask"])
def test_workers_find_the_same(frames, tmp_path, backend):
    alone = sweep(frames, CALIBRATION, table=tmp_path / "1.csv")
    cluster = nullcontext()
    if backend == "dask":
        client = pytest.importorskip("distributed").Client
        cluster = client(n_workers=2, threads_per_worker=1, dashboard_address=None)
    with cluster, joblib.parallel_config(backend, n_jobs=2):
        together = sweep(frames, CALIBRATION, table=tmp_path / "2.csv")
    for a, b in zip(alone, together, strict=True):
        assert (a["frame"], a["energy"]) == (
            b["frame"],
            pytest.approx(b["energy"], rel=1e-6),
        )


def test_a_recording_has_an_answer_and_its_error_for_each_lambda(frames, tmp_path):
    recording = tmp_path / "lam.rrd"
    how = {"table": tmp_path / "1.csv", "recording": recording, "lam": [0.1, 1, 10]}
    truth = [(SEEN[0].distance, SEEN[0].normals)]
    rows = sweep(frames[:1], CALIBRATION, truth=truth, **how)
    run = el.read_recording(recording)
    assert run.pictured == (0, 1, 2)
    for row, recorded in zip(rows, run.table(), strict=True):
        assert recorded["energy"] == pytest.approx(row["energy"])
        assert recorded["error"] == pytest.approx(row["mean_percent"])
    assert [row["found"] for row in rows] == ["anew", "held", "held"]
    at = Recorded(recording, [LAMBDAS]).rows["/stage"]["text"]
    named = {-1000: "λ 0.1", 0: "λ 1", 1000: "λ 10"}
    assert {place: words[0].as_py() for place, words in at.items()} == named


def test_each_xi_has_its_lambdas_found_anew_if_asked(frames, tmp_path):
    how = {
        "table": tmp_path / "1.csv",
        "recording": tmp_path / "lam.rrd",
        "xi": ["d", "1/d"],
    }
    rows = sweep(frames[:1], CALIBRATION, lam=[1, 10], anew=True, **how)
    assert {row["found"] for row in rows} == {"anew"}
    runs = el.read_recording(tmp_path / "lam.rrd").runs
    recorded = [x for run in runs.values() for x in run.table()["energy"]]
    assert recorded == pytest.approx([row["energy"] for row in rows])
