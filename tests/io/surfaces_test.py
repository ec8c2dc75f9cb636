"""Depth maps and surfaces in files."""

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


@pytest.mark.parametrize("suffix", ["ply", "obj"])
def test_a_mesh_says_its_unit_and_axes(tmp_path, suffix):
    corners = np.eye(3)
    mesh = Mesh(corners, np.array([[0, 1, 2]]), corners, corners, "relative", "σ")
    el.write_mesh(tmp_path / f"a.{suffix}", mesh)
    head = (tmp_path / f"a.{suffix}").read_bytes()[:200].decode()
    for words in ("unit: relative", "x right, y down, z forward", "colours: σ"):
        assert words in head
