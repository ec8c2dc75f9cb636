"""Depth maps in files: what is read is a map of a surface."""

import numpy as np
import pytest

from endolab.io.surfaces import read_depth

DISTANCE = np.linspace(20, 30, 12, dtype=np.float32).reshape(3, 4)
GOOD = {
    "distance": DISTANCE,
    "z": 0.9 * DISTANCE,
    "normals": np.zeros((3, 4, 3), np.float32),
}
GOOD |= {"mask": np.ones((3, 4), bool), "metric": np.array(True)}


def test_what_is_no_distance_is_unknown_and_what_is_not_ours_is_left(tmp_path):
    distance = DISTANCE.copy()
    distance[0] = np.nan, np.inf, -3, 0
    np.savez(
        tmp_path / "a.npz", **(GOOD | {"distance": distance, "other": np.zeros(3)})
    )
    maps = read_depth(tmp_path / "a.npz")
    assert set(maps) == set(GOOD)
    assert np.isnan(maps["distance"][0]).all()
    np.testing.assert_array_equal(maps["distance"][1:], DISTANCE[1:])
    assert maps["distance"].dtype == np.float32


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"distance": None}, "distance"),
        ({"z": None}, "z"),
        ({"distance": DISTANCE.ravel()}, "distance"),
        ({"distance": DISTANCE.astype(complex)}, "distance"),
        ({"distance": DISTANCE.astype(int)}, "distance"),
        ({"z": DISTANCE[:2]}, "z"),
        ({"normals": DISTANCE}, "normals"),
        ({"sigma": DISTANCE[0]}, "sigma"),
        ({"sigma_shape": np.full((3, 4), 1e300)}, "sigma_shape"),
        ({"dominant_source": DISTANCE}, "dominant_source"),
        ({"mask": np.ones(3, bool)}, "mask"),
        ({"metric": np.ones(2, bool)}, "metric"),
        ({"z": np.full((3, 4), 1e300)}, "z"),
    ],
)
def test_what_is_no_map_of_a_surface_is_refused(tmp_path, wrong, named):
    content = {
        name: values for name, values in (GOOD | wrong).items() if values is not None
    }
    np.savez(tmp_path / "a.npz", **content)
    with pytest.raises(ValueError, match=rf"a\.npz: {named} "):
        read_depth(tmp_path / "a.npz")
