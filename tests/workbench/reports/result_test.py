"""A result as a folder of files, against other programs; whole or not there."""

import json
from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab.io.surfaces import read_depth
from endolab.reconstruction.report import meaning
from endolab.solvers.solvers import DEFAULT_SOLVER

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


def report_in(folder):
    text = (folder / "report.json").read_text("utf-8")
    return json.loads(text, parse_constant=pytest.fail)


def test_a_result_is_saved_whole(tmp_path, result):
    folder = tmp_path / "a" / "b"
    el.save_result(result, folder)
    files = ["cloud.ply", "depth.npz", "endoscope.json", "overview.png", "report.json"]
    assert contents(folder) == files
    used = el.load_calibration(folder / "endoscope.json")
    assert used == result.report.calibration
    depth = read_depth(folder / "depth.npz")
    for name in ("distance", "z", "normals"):
        np.testing.assert_allclose(depth[name], getattr(result, name), rtol=1e-6)
    np.testing.assert_array_equal(depth["mask"], result.mask)
    assert set(depth) == {"distance", "z", "normals", "mask", "metric"}
    report = report_in(folder)
    known = result.distance[result.mask]
    expected = {
        "status": "CONVERGED",
        "pixels": known.size,
        "unit": "mm",
        "metric": True,
        "scale": "gain",
        "meaning": list(meaning(result)),
        "energy": sum(report["terms"].values()),
        "left": result.left,
    }
    assert {name: report[name] for name in expected} == expected
    assert report["energy"] == result.energy
    found = list(report["distance"].values())
    assert found == pytest.approx([np.median(known), known.min(), known.max()])
    assert report["settings"]["solver"] == DEFAULT_SOLVER
    assert "uncertainty" not in report


def test_how_far_a_result_can_be_trusted_is_saved_beside_it(tmp_path, result):
    uncertainty = el.uncertainty_of(result, draws=4)
    el.save_result(result, tmp_path, mesh=True, uncertainty=uncertainty)
    assert {"mesh.ply", "mesh_uncertainty.ply"} < set(contents(tmp_path))
    depth = read_depth(tmp_path / "depth.npz")
    for name in ("sigma", "sigma_shape", "dominant_source"):
        np.testing.assert_allclose(depth[name], getattr(uncertainty, name), rtol=1e-6)
    report = report_in(tmp_path)["uncertainty"]
    share = (uncertainty.sigma / result.distance)[result.mask]
    assert report["sigma_percent"]["median"] == pytest.approx(100 * np.median(share))
    assert list(report["dominant_source"]) == ["data", "border or contour", "prior"]
    assert sum(report["dominant_source"].values()) == pytest.approx(1)


def test_relative_units_are_written_down(tmp_path, result):
    problem = replace(result.problem, metric=False)
    relative = replace(result, iterate=replace(result.iterate, problem=problem))
    el.save_result(relative, tmp_path)
    report = report_in(tmp_path)
    found = (report["unit"], report["metric"], report["scale"])
    assert found == ("relative units", False, "none")
    assert not read_depth(tmp_path / "depth.npz")["metric"]


def test_the_cloud_opens_in_open3d(tmp_path, result, open3d):
    el.save_result(result, tmp_path)
    cloud = open3d.io.read_point_cloud(str(tmp_path / "cloud.ply"))
    inside = result.mask
    np.testing.assert_allclose(
        cloud.points, result.points[inside], rtol=1e-6, atol=1e-5
    )
    np.testing.assert_allclose(cloud.normals, result.normals[inside], atol=1e-6)
    colours = result.problem.picture[inside]
    np.testing.assert_allclose(cloud.colors, colours, atol=0.51 / 255)
