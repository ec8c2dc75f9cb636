"""Depth maps and surfaces in files."""

from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab.io.surfaces import read_depth
from endolab.model.mesh import Mesh


def test_what_is_no_distance_is_unknown_and_what_is_not_ours_is_left(tmp_path):
    distance = np.full((3, 4), 20, np.float32)
    distance[0] = np.nan, np.inf, -3, 0
    maps = {"distance": distance, "z": 0.9 * distance, "metric": np.array(True)}
    maps["normals"] = np.zeros((3, 4, 3), np.float32)
    np.savez(tmp_path / "a.npz", **maps, other=np.array([{}], object))
    found = read_depth(tmp_path / "a.npz")
    assert set(found) == set(maps)
    assert np.isnan(found["distance"][0]).all()
    np.testing.assert_array_equal(found["distance"][1:], distance[1:])


SQUARE = Mesh(
    vertices=np.array([[0, 0, 9], [1, 0, 9], [1, 2.5, 9], [0, 2.5, 9]], float),
    triangles=np.array([[0, 1, 2], [0, 2, 3]]),
    colours=np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [1.2, 1, 1]]),
    normals=np.tile([0.0, 0.0, -1.0], (4, 1)),
    unit="relative",
    legend="σ",
)


@pytest.mark.parametrize("suffix", ["ply", "obj"])
@pytest.mark.parametrize("count", [2, 0], ids=["mesh", "cloud"])
def test_other_programs_read_a_mesh_and_a_cloud(tmp_path, suffix, count):
    trimesh = pytest.importorskip("trimesh")
    path = tmp_path / f"a.{suffix}"
    el.write_mesh(path, replace(SQUARE, triangles=SQUARE.triangles[:count]))
    head = path.read_bytes()[:200]
    assert b"unit: relative" in head
    assert b"x right, y down, z forward" in head
    if suffix == "obj" and count == 0:
        return
    read = trimesh.load(path, process=False, maintain_order=True)
    np.testing.assert_allclose(read.vertices, SQUARE.vertices)
    if count:
        np.testing.assert_array_equal(read.faces, SQUARE.triangles)
        np.testing.assert_allclose(read.vertex_normals, SQUARE.normals)
        colours = read.visual.vertex_colors[:, :3]
    else:
        colours = read.colors[:, :3]
    expected = np.round(255 * np.clip(SQUARE.colours, 0, 1))
    np.testing.assert_allclose(colours, expected, atol=1)
