"""Damage itself does not break, whatever it is given, and follows from the generator."""

import numpy as np
import pytest

from tests.hostile import damage, given

ARRAYS = {
    "distance": np.ones((6, 8), np.float32),
    "normals": np.ones((6, 8, 3), np.float32),
    "mask": np.ones((6, 8), bool),
    "metric": np.array(True),
}
DOCUMENT = {"a": [1, 2.5], "b": {"c": None, "d": "x", "e": True}, "f": []}
MAKE = {
    "bytes": lambda rng: damage.damaged_bytes(rng, bytes(int(rng.integers(40)))),
    "json": lambda rng: damage.damaged_json(rng, DOCUMENT).encode(errors="surrogatepass"),
    "table": lambda rng: damage.damaged_table(rng, "a,b\n1,2\n"),
    "text": lambda rng: damage.damaged_text(rng, given.GEOMETRY),
    "png": damage.odd_png,
    "array": lambda rng: [repr(damage.odd_array(rng, array)).encode() for array in ARRAYS.values()],
}


@pytest.mark.parametrize("name", MAKE)
def test_it_does_not_break_and_follows_from_its_seed(name):
    made, again = ([MAKE[name](np.random.default_rng(seed)) for seed in range(300)] for _ in range(2))
    assert made == again
    assert len({str(content) for content in made}) > 15


def test_archives():
    names = [damage.odd_npz(np.random.default_rng(seed), ARRAYS)[:2] for seed in range(60)]
    assert names.count(b"PK") > 40
