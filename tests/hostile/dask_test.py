"""A sweep on a real Dask, where one is installed: the rows that processes of this machine make."""

import csv

import pytest

import endolab as el

distributed = pytest.importorskip("distributed", reason="Dask is not installed: pip install distributed")


def rows(path):
    """All that a table says, but for the seconds."""
    with path.open(encoding="utf-8") as stream:
        return [
            {key: cell for key, cell in row.items() if key != "seconds"} for row in csv.DictReader(stream)
        ]


@pytest.mark.filterwarnings("default")  # of Dask's own
def test_rows_are_the_same_as_here(tmp_path):
    calibration = el.load_calibration("paper", width=32)
    scene = el.render(el.SCENES["colon"], calibration.camera, calibration.photometry)
    frames, how = [el.Frame(scene.image, scene.mask)], {"lam": (0.1, 1.0), "solver": "gauss_newton"}
    here, there = tmp_path / "here.csv", tmp_path / "there.csv"
    el.sweep(frames, calibration, table=here, n_jobs=1, **how)
    cluster = distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
    )
    with cluster, distributed.Client(cluster):
        el.sweep(frames, calibration, table=there, backend="dask", **how)
    assert rows(there) == rows(here)
    assert len(rows(here)) == 2
