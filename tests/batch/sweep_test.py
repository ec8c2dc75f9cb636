"""Sweeps: one tidy table, on one core or more, gone on with after a break."""

import csv
import math
import os
import time
from dataclasses import replace

import joblib
import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.batch import sweep as sweeps
from endolab.batch.sweep import COLUMNS, read_table, sweep
from endolab.cli import main as cli
from endolab.io.images import write_image
from endolab.io.surfaces import save_depth
from endolab.numerics.iteration import Status
from endolab.reconstruction import reconstruct as reconstruct_module

BASE = datasets.load_calibration("simple", 64)
GREEN = replace(BASE.photometry.channel("green"), gain=900.0)
CALIBRATION = el.Calibration(BASE.camera, GREEN)
SETTINGS = {"lam": (0.1, 1.0), "xi": ("1/d", "d"), "regulariser": ("first", "second")}


@pytest.fixture(scope="module")
def seen():
    return {name: el.render(el.SCENES[name], BASE.camera, GREEN, noise=1.0) for name in ("plane", "tube")}


@pytest.fixture
def frames(seen):
    return [el.Frame(one.image, one.mask, name) for name, one in seen.items()]


@pytest.fixture
def solved(monkeypatch):
    """Count what is reconstructed."""
    count, real = [], reconstruct_module.reconstruct

    def counting(frame, *arguments, **options):
        count.append((frame.name, options["lam"]))
        return real(frame, *arguments, **options)

    monkeypatch.setattr(sweeps, "reconstruct", counting)
    return count


def test_each_with_each_is_one_row(frames, seen, tmp_path, solved):
    truth = [(one.distance, one.normals) for one in seen.values()]
    path = tmp_path / "t.csv"
    rows = sweep(frames, CALIBRATION, **SETTINGS, truth=truth, table=path)
    assert len(rows) == len(solved) == 16
    with open(path, newline="", encoding="utf-8") as stream:
        stored = list(csv.DictReader(stream))
    assert tuple(stored[0]) == COLUMNS
    assert len({tuple(row[name] for name in sweeps.KEY) for row in stored}) == 16
    assert [float(row["energy"]) for row in stored] == [row["energy"] for row in rows]
    for row in rows:
        assert row["energy"] == pytest.approx(row["data"] + row["regulariser_energy"])
        if row["regulariser"] == "second":  # the first order wants a smaller λ
            assert 0 < row["mean_percent"] < 10
            assert 0 < row["mean_degrees"] < 20
        assert row["median_mm"] > 0
        assert row["error"] == ""
        assert row["seconds"] > 0
    one = el.reconstruct(frames[1], CALIBRATION, lam=0.1, xi="d", regulariser="first")
    same = [row for row in rows if (row["frame"], row["lam"], row["xi"]) == ("tube", 0.1, "d")]
    assert same[0]["energy"] == pytest.approx(one.energy, rel=1e-9)


def test_a_second_call_makes_only_what_is_not_there(frames, tmp_path, solved):
    path = tmp_path / "t.csv"
    first = sweep(frames[:1], CALIBRATION, lam=(0.1, 1), table=path)
    again = sweep(frames, CALIBRATION, lam=(0.1, 1, 10), table=path)
    assert solved == [("plane", 0.1), ("plane", 1.0), ("plane", 10.0)] + [("tube", x) for x in (0.1, 1, 10)]
    assert again[:2] == [pytest.approx(row, nan_ok=True) for row in first]
    (row,) = sweep(frames[:1], CALIBRATION, lam=(0.1,), width=48, table=path)
    assert row["options"].endswith(" width=48")
    assert len(read_table(path)) == 7
    assert math.isnan(again[0]["mean_mm"])


def test_an_interrupted_sweep_goes_on(frames, tmp_path, solved):
    path = tmp_path / "t.csv"

    def stop(done, total, row):
        assert total == 4
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt, match="3 of 4 rows are in the table, the same command goes on"):
        sweep(frames, CALIBRATION, lam=(0.1, 1), table=path, progress=stop)
    assert len(read_table(path)) == 3
    assert len(sweep(frames, CALIBRATION, lam=(0.1, 1), table=path)) == 4
    assert len(solved) == len(set(solved)) == 4


def test_an_interrupt_is_all_that_is_heard_of_tasks_under_way(frames, tmp_path):
    """Joblib warns of what was in vain, and here warnings are errors."""

    def stop(done, total, row):
        time.sleep(0.2)  # while others are done, and wait
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt, match="in the table"):
        sweep(
            frames,
            CALIBRATION,
            lam=np.geomspace(0.1, 1, 8),
            table=tmp_path / "t.csv",
            progress=stop,
            n_jobs=2,
        )


def test_a_sweep_that_was_interrupted_comes_to_the_same_table(frames, tmp_path):
    def stop(done, total, row):
        if done == 2:
            raise KeyboardInterrupt

    def written(path):
        with open(path, newline="", encoding="utf-8") as stream:
            return [row | {"seconds": ""} for row in csv.DictReader(stream)]

    how = {"lam": (0.1, 1), "max_iterations": 3}
    sweep(frames, CALIBRATION, table=tmp_path / "whole.csv", **how)
    with pytest.raises(KeyboardInterrupt):
        sweep(frames, CALIBRATION, table=tmp_path / "t.csv", progress=stop, **how)
    sweep(frames, CALIBRATION, table=tmp_path / "t.csv", **how)
    assert written(tmp_path / "t.csv") == written(tmp_path / "whole.csv")


@pytest.mark.parametrize(
    "cells",
    [
        {"iterations": "inf"},
        {"iterations": "3.5"},
        {"iterations": "1e308"},
        {"pixels": "x", "lam": ""},
        {"energy": "\0"},
        {"xi": '"'},
    ],
)
def test_wild_cells_are_no_row_and_stay(frames, tmp_path, cells):
    path = tmp_path / "t.csv"
    row = dict.fromkeys(COLUMNS, "1") | cells
    path.write_text(f"{','.join(COLUMNS)}\n{','.join(row[name] for name in COLUMNS)}\n")
    content = path.read_bytes()
    with pytest.raises(ValueError, match=r"t\.csv, line 2: not a row of a sweep"):
        sweep(frames, CALIBRATION, table=path)
    assert path.read_bytes() == content


def test_a_field_without_end_is_another_table(frames, tmp_path):
    (tmp_path / "t.csv").write_text(",".join(COLUMNS) + '\n"' + "x" * 200_000)
    with pytest.raises(ValueError, match=r"t\.csv: not a table of a sweep"):
        sweep(frames, CALIBRATION, table=tmp_path / "t.csv")


def test_a_row_that_says_neither_result_nor_error_is_made_again(frames, tmp_path, solved):
    path = tmp_path / "t.csv"
    sweep(frames[:1], CALIBRATION, table=path)
    path.write_text(path.read_text().replace("CONVERGED", "FINE"))
    assert sweep(frames[:1], CALIBRATION, table=path)[0]["status"] == "CONVERGED"
    assert len(solved) == 2


def test_another_calibration_and_a_new_truth_are_made_anew(frames, seen, tmp_path, solved):
    path = tmp_path / "t.csv"
    sweep(frames[:1], CALIBRATION, table=path)
    darker = replace(CALIBRATION, photometry=replace(GREEN, brdf=el.Lambertian(0.2)))
    (other,) = sweep(frames[:1], darker, table=path)
    assert len(solved) == len(read_table(path)) == 2
    assert np.isnan(other["mean_percent"])
    for _ in range(2):
        (row,) = sweep(frames[:1], darker, table=path, truth=[seen["plane"].distance])
        assert row["mean_percent"] > 0
    assert len(solved) == 3
    assert len(read_table(path)) == 2


def test_a_run_that_was_stopped_is_no_row(frames, tmp_path, monkeypatch):
    real = reconstruct_module.reconstruct
    monkeypatch.setattr(sweeps, "reconstruct", lambda *a, **k: replace(real(*a, **k), status=Status.STOPPED))
    with pytest.raises(KeyboardInterrupt, match="0 of 2 rows"):
        sweep(frames, CALIBRATION, table=tmp_path / "t.csv")
    assert read_table(tmp_path / "t.csv") == {}


def test_a_full_disk_keeps_the_rows_that_are_there(frames, tmp_path, monkeypatch):
    real, writes = sweeps.write_rows, []

    def write(path, *table):
        writes.append(path)
        if len(writes) > 3:
            raise OSError(f"cannot write {path}: No space left on device")
        real(path, *table)

    monkeypatch.setattr(sweeps, "write_rows", write)
    with pytest.raises(OSError, match="No space left"):
        sweep(frames, CALIBRATION, lam=(0.1, 1), table=tmp_path / "t.csv")
    assert len(read_table(tmp_path / "t.csv")) == 2
    assert os.listdir(tmp_path) == ["t.csv"]


def test_a_frame_that_cannot_be_used_is_a_row_with_a_sentence(frames, tmp_path, solved):
    path = tmp_path / "t.csv"
    dark = el.Frame(np.zeros((48, 64)), np.ones((48, 64), bool), "dark")
    rows = sweep([dark, frames[0], tmp_path / "none.png"], CALIBRATION, table=path)
    assert [row["status"] for row in rows] == ["", "CONVERGED", ""]
    assert "dark: the picture is all dark" in rows[0]["error"]
    assert "none.png: there is no such file" in rows[2]["error"]
    (tmp_path / "truth.npz").write_bytes(b"PK\3\4 cut off")
    (row,) = sweep(frames[:1], CALIBRATION, table=tmp_path / "2.csv", truth=[tmp_path / "truth.npz"])
    assert row["error"].endswith("truth.npz: not a depth.npz that endolab wrote")
    sweep([dark], CALIBRATION, table=path)  # tried again
    assert solved.count(("dark", 1.0)) == 2
    assert len(read_table(path)) == 3


@pytest.mark.parametrize("backend", ["loky", "threading"])
def test_workers_find_the_same_and_the_backend_may_be_set_outside(frames, tmp_path, backend):
    alone = sweep(frames, CALIBRATION, table=tmp_path / "1.csv")
    together = sweep(frames, CALIBRATION, table=tmp_path / "2.csv", n_jobs=2, backend=backend)
    for a, b in zip(alone, together, strict=True):
        assert a["frame"] == b["frame"]
        assert a["energy"] == pytest.approx(b["energy"], rel=1e-6)
    if backend == "threading":
        with joblib.parallel_config(backend="threading", n_jobs=2):
            assert len(sweep(frames, CALIBRATION, table=tmp_path / "t.csv")) == 2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lam": ()}, "at least one frame, lam, xi and regulariser"),
        ({"lam": [math.nan]}, "lam must be finite, got nan"),
        ({"truth": []}, "expected a truth for each of 2 frames, found 0"),
        ({"frames": ["a/x.png", "b/x.png"]}, "two frames are called x.png"),
    ],
)
def test_a_sweep_that_cannot_be(frames, tmp_path, change, message):
    options = {"frames": frames, "table": tmp_path / "t.csv"} | change
    with pytest.raises(ValueError, match=message):
        sweep(options.pop("frames"), CALIBRATION, **options)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("content", [b"a,b\n1,2\n", b"\xff\xfe", (",".join(COLUMNS) + "\nx,y\n").encode()])
def test_another_table_is_left_alone(frames, tmp_path, content):
    (tmp_path / "t.csv").write_bytes(content)
    with pytest.raises(ValueError, match=r"t\.csv.*not a (table|row) of a sweep"):
        sweep(frames, CALIBRATION, table=tmp_path / "t.csv")
    assert (tmp_path / "t.csv").read_bytes() == content


def test_the_command(seen, tmp_path, capsys):
    CALIBRATION.save(tmp_path / "cal.json")
    for name, one in seen.items():
        write_image(tmp_path / f"{name}.png", one.image)
        save_depth(tmp_path / f"{name}.npz", one, True)
    paths, truths = ([str(tmp_path / f"{name}.{kind}") for name in seen] for kind in ("png", "npz"))
    out = tmp_path / "sweep.csv"
    command = ["sweep", *paths, "--calibration", str(tmp_path / "cal.json"), "--out", str(out)]
    command += ["--lam", "0.1,1", "--xi", "1/d,d", "--regulariser", "first", "--truth", *truths]
    assert cli.main(command) == 0
    assert "8 of 8 rows" in capsys.readouterr().out
    assert cli.main(command) == 0
    assert "made by an earlier call: 8 of them" in capsys.readouterr().out
    assert all(row["median_mm"] < 20 for row in read_table(out).values())
    for wrong, message in (
        (["--lam", "a,b"], "--lam must be numbers such as 0.1,1,10, got a,b"),
        (["--jobs", "0"], "--jobs must be at least 1"),
        (["--backend", "smoke"], "unknown backend 'smoke'; choose loky, threading or dask"),
        (["--xi", "w"], "unknown xi 'w'; choose 1/z, d or 1/d"),
        (["--out", str(tmp_path / "no/t.csv")], "cannot write"),
    ):
        assert cli.main([*command, *wrong]) == 2
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1
