"""A result as a folder of files, against other programs; whole or not there."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import endolab as el
from endolab.io.surfaces import read_depth, write_cloud
from endolab.reconstruction.sentences import meaning
from endolab.solvers.solvers import DEFAULT_SOLVER
from endolab.workbench.reports import result as result_module

CAMERA = el.Pinhole(40, 30, 20.0, 20.0, 19.5, 14.5)


@pytest.fixture(scope="module")
def result():
    rendered = el.render(
        el.SCENES["curved"], CAMERA, el.Photometry(brdf=el.Lambertian((0.7, 0.4, 0.3)))
    )
    mask = rendered.mask.copy()
    mask[:5, :7] = False
    calibration = el.Calibration(CAMERA, rendered.photometry)
    return el.reconstruct(el.Frame(rendered.image, mask), calibration)


def contents(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def test_a_result_is_saved_whole(tmp_path, result):
    el.save_result(result, tmp_path / "a" / "b")
    files = ["cloud.ply", "depth.npz", "overview.png", "report.json"]
    assert contents(tmp_path / "a" / "b") == files
    with np.load(tmp_path / "a/b/depth.npz", allow_pickle=False) as depth:
        for name in ("distance", "z", "normals"):
            np.testing.assert_allclose(depth[name], getattr(result, name), rtol=1e-6)
        np.testing.assert_array_equal(depth["mask"], result.mask)
        assert bool(depth["metric"]) is True
    report = json.loads(
        (tmp_path / "a/b/report.json").read_text("utf-8"), parse_constant=pytest.fail
    )
    assert (report["status"], report["pixels"]) == ("CONVERGED", result.mask.sum())
    assert report["energy"] == result.energy == sum(report["terms"].values())
    known = result.distance[result.mask]
    assert list(report["distance"].values()) == pytest.approx(
        [np.median(known), known.min(), known.max()]
    )
    assert report["settings"]["solver"] == DEFAULT_SOLVER
    assert (report["unit"], report["metric"], report["scale"]) == ("mm", True, "gain")
    assert (report["ended"], report["meaning"]) == (
        result.status.value,
        list(meaning(result)),
    )
    overview = np.asarray(Image.open(tmp_path / "a/b/overview.png").convert("L"))
    assert min(overview.shape) > 200
    assert overview.std() > 10


def test_how_far_a_result_can_be_trusted_is_saved_beside_it(tmp_path, result):
    uncertainty = el.uncertainty_of(result, draws=4)
    el.save_result(result, tmp_path / "plain")
    el.save_result(result, tmp_path / "out", uncertainty=uncertainty)
    depth = read_depth(tmp_path / "out/depth.npz")
    for name in ("sigma", "sigma_shape"):
        np.testing.assert_allclose(depth[name], getattr(uncertainty, name), rtol=1e-6)
    assert depth["dominant_source"].dtype == np.uint8
    np.testing.assert_array_equal(depth["dominant_source"], uncertainty.dominant_source)
    report = json.loads(
        (tmp_path / "out/report.json").read_text("utf-8"), parse_constant=pytest.fail
    )["uncertainty"]
    share = (uncertainty.sigma / result.distance)[result.mask]
    assert report["sigma_percent"]["median"] == pytest.approx(100 * np.median(share))
    assert report["sigma_scale_percent"] == pytest.approx(100 * uncertainty.sigma_scale)
    assert list(report["dominant_source"]) == ["data", "border or contour", "prior"]
    assert sum(report["dominant_source"].values()) == pytest.approx(1)
    assert report["draws"] == 4
    plain = json.loads((tmp_path / "plain/report.json").read_text("utf-8"))
    assert "uncertainty" not in plain
    assert set(read_depth(tmp_path / "plain/depth.npz")) == {
        "distance",
        "z",
        "normals",
        "mask",
        "metric",
    }
    for name, width in (("plain", 1600), ("out", 2100)):
        with Image.open(tmp_path / name / "overview.png") as page:
            assert page.width == width


def test_nothing_of_an_earlier_result_is_left_beside_a_new_one(tmp_path, result):
    uncertainty = el.uncertainty_of(result, draws=4)
    el.save_result(result, tmp_path, mesh=True, uncertainty=uncertainty)
    assert {"mesh.ply", "mesh_uncertainty.ply"} < {*contents(tmp_path)}
    (tmp_path / "notes.txt").write_text("mine")
    el.save_result(result, tmp_path)
    plain = ["cloud.ply", "depth.npz", "notes.txt", "overview.png", "report.json"]
    assert contents(tmp_path) == plain
    (tmp_path / "mesh.ply").write_text("mine, of another program")
    el.save_result(result, tmp_path, overwrite=True)
    assert contents(tmp_path) == sorted([*plain, "mesh.ply"])


def test_relative_units_are_written_down(tmp_path, result):
    relative = replace(
        result,
        iterate=replace(result.iterate, problem=replace(result.problem, metric=False)),
    )
    report = result_module.report(relative)
    assert (report["unit"], report["metric"], report["scale"]) == (
        "relative units",
        False,
        "none",
    )
    el.save_result(relative, tmp_path)
    with np.load(tmp_path / "depth.npz", allow_pickle=False) as depth:
        assert bool(depth["metric"]) is False


def test_the_cloud_opens_in_open3d(tmp_path, result, open3d):
    el.save_result(result, tmp_path)
    cloud = open3d.io.read_point_cloud(str(tmp_path / "cloud.ply"))
    np.testing.assert_allclose(
        np.asarray(cloud.points), result.points[result.mask], rtol=1e-6, atol=1e-5
    )
    np.testing.assert_allclose(
        np.asarray(cloud.normals), result.normals[result.mask], atol=1e-6
    )
    colours = result.problem.picture[result.mask]
    np.testing.assert_allclose(np.asarray(cloud.colors), colours, atol=0.51 / 255)


def test_an_empty_cloud(tmp_path):
    write_cloud(tmp_path / "c.ply", *np.zeros((3, 0, 3)))
    assert b"element vertex 0\n" in (tmp_path / "c.ply").read_bytes()


@pytest.mark.parametrize("function", ["save_depth", "write_cloud", "write_atomically"])
def test_a_result_on_a_full_disk_leaves_nothing(tmp_path, monkeypatch, result, function):
    def full(path, *content):
        path.write_bytes(b"half")
        raise OSError(f"cannot write {path.name}: No space left on device")

    monkeypatch.setattr(result_module, function, full)
    with pytest.raises(OSError, match="No space left"):
        el.save_result(result, tmp_path / "new")
    assert contents(tmp_path) == []
