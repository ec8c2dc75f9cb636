"""Depth maps in files: what is read is a map of a surface."""

import numpy as np
import pytest

from endolab.io.surfaces import read_depth

DISTANCE = np.linspace(20, 30, 12, dtype=np.float32).reshape(3, 4)
NORMALS = np.zeros((3, 4, 3), np.float32)
GOOD = {
    **{"distance": DISTANCE, "z": 0.9 * DISTANCE, "normals": NORMALS},
    **{"mask": np.ones((3, 4), bool), "metric": np.array(True)},
}


def test_what_is_no_distance_is_unknown_and_what_is_not_ours_is_left(tmp_path):
    distance = DISTANCE.copy()
    distance[0] = np.nan, np.inf, -3, 0
    np.savez(tmp_path / "a.npz", **(GOOD | {"distance": distance, "other": np.zeros(3)}))
    maps = read_depth(tmp_path / "a.npz")
    assert set(maps) == set(GOOD)
    assert np.isnan(maps["distance"][0]).all()
    np.testing.assert_array_equal(maps["distance"][1:], DISTANCE[1:])
    assert maps["distance"].dtype == np.float32


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"distance": None}, "distance is missing"),
        ({"z": None}, "z is missing"),
        ({"distance": DISTANCE.ravel()}, "distance is not a map of the size of distance"),
        ({"distance": DISTANCE.astype(complex)}, "not a depth.npz that endolab wrote"),
        ({"distance": DISTANCE.astype(int)}, "distance is not a map of the size of distance"),
        ({"z": DISTANCE[:2]}, "z is not a map of the size of distance"),
        ({"normals": DISTANCE}, "normals is not a map of the size of distance"),
        ({"sigma": DISTANCE[0]}, "sigma is not a map of the size of distance"),
        (
            {"sigma_shape": np.full((3, 4), 1e300)},
            r"sigma_shape holds values up to 1e\+300; no surface has them",
        ),
        ({"decided_by": DISTANCE}, "decided_by is not a map of the size of distance"),
        ({"mask": np.ones(3, bool)}, "mask is not a map of the size of distance"),
        ({"metric": np.ones(2, bool)}, "metric is not true or false"),
        ({"z": np.full((3, 4), 1e300)}, r"z holds values up to 1e\+300; no surface has them"),
        (
            dict.fromkeys(("distance", "z"), np.zeros((1, 10**8 + 1), np.float16)),
            r"distance has shape \(1, 100000001\), which is larger than any picture",
        ),
    ],
)
def test_what_is_no_map_of_a_surface_is_refused(tmp_path, wrong, sentence):
    content = {name: values for name, values in (GOOD | wrong).items() if values is not None}
    (np.savez_compressed if max(v.size for v in content.values()) > 1e6 else np.savez)(
        tmp_path / "a.npz", **content
    )
    with pytest.raises(ValueError, match=rf"a\.npz: {sentence}$"):
        read_depth(tmp_path / "a.npz")
