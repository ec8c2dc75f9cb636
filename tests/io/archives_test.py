"""Arrays in an .npz: nothing is inflated that was not judged by its head first."""

import io
import struct
import zipfile

import numpy as np
import pytest

from endolab.io.archives import read_arrays

NUMBERS = np.arange(12, dtype=np.float32).reshape(3, 4)
WHAT = "an archive of numbers"


NAMES = ("a", "f", "big", "one", "line", "none", "text")


def everything(path):
    return read_arrays(path, WHAT, NAMES, lambda heads: None)


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_what_numpy_wrote_is_read(tmp_path, save):
    written = {
        **{
            "a": NUMBERS,
            "f": np.asfortranarray(NUMBERS),
            "big": NUMBERS.astype(">f8"),
            "one": np.array(True),
        },
        **{"line": np.arange(3, dtype=np.uint16), "none": np.zeros((0, 2)), "text": np.array("λ")},
    }
    save(tmp_path / "a.npz", **written)
    found = everything(tmp_path / "a.npz")
    assert list(found) == list(written)
    for name, values in written.items():
        np.testing.assert_array_equal(found[name], values, strict=True)


@pytest.mark.parametrize("values", [np.array([{}], object), np.zeros(2, "f4,i4"), np.zeros(2, complex)])
def test_what_holds_code_or_other_numbers_is_refused_if_it_is_asked_for(tmp_path, values):
    np.savez(tmp_path / "a.npz", a=NUMBERS, other=values)
    assert list(everything(tmp_path / "a.npz")) == ["a"]
    np.savez(tmp_path / "a.npz", a=values)
    with pytest.raises(ValueError, match=r"a\.npz: not an archive of numbers$"):
        everything(tmp_path / "a.npz")


def test_what_is_not_asked_for_or_refused_is_not_read(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("a.npy", head("(3, 4)") + NUMBERS.tobytes())
        archive.writestr("other.npy", head("(99999999999,)") + bytes(10**6))
        archive.writestr("readme.txt", "nothing")
    assert list(everything(tmp_path / "a.npz")) == ["a"]

    def refuse(heads):
        raise ValueError(f"{heads['a'].dtype} of {heads['a'].shape}")

    with pytest.raises(ValueError, match=r"^float32 of \(3, 4\)$"):
        read_arrays(tmp_path / "a.npz", WHAT, NAMES, refuse)


def head(shape, descr="<f4"):
    text = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\0" + struct.pack("<H", len(text)) + text.encode()


@pytest.mark.parametrize(
    "shape", ["(1000000, 1000000)", "(3, 5)", "(-1, 4)", "(3.0, 4)", "[3, 4]", "(1,) * 9**9"]
)
def test_a_promise_that_is_not_kept_is_refused(tmp_path, shape):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("a.npy", head(shape) + NUMBERS.tobytes())
    with pytest.raises(ValueError, match=r"a\.npz: not an archive of numbers$"):
        everything(tmp_path / "a.npz")


def test_what_is_larger_than_memory_is_refused_before_it_is_inflated(tmp_path, monkeypatch):
    np.savez_compressed(tmp_path / "a.npz", a=np.zeros(10**6))
    monkeypatch.setattr("psutil.virtual_memory", lambda: type("Memory", (), {"available": 10**6}))
    with pytest.raises(
        MemoryError, match=r"a.npz: what it holds needs about 0.0 GB of memory, 0.0 GB are free"
    ):
        everything(tmp_path / "a.npz")


def flagged(content, offset, value):
    """Set a byte of the archive's first entry, where it is said twice."""
    changed = bytearray(content)
    changed[offset] = changed[changed.index(b"PK\1\2") + offset + 2] = value
    return bytes(changed)


def damaged_archives():
    whole = io.BytesIO()
    np.savez(whole, a=NUMBERS)
    content = whole.getvalue()
    return {
        "empty": b"",
        "text": b"hello",
        "half": content[: len(content) // 2],
        "damaged": content.replace(NUMBERS.tobytes()[8:16], bytes(8)),
        "of no version": flagged(content, 4, 255),
        "patched": flagged(content, 6, 32),
        "encrypted": flagged(content, 6, 1),
        "packed by bzip2": flagged(content, 8, 12),
        "packed somehow": flagged(content, 8, 99),
    }


@pytest.mark.parametrize("name", damaged_archives())
def test_damage_is_said_in_one_sentence(tmp_path, name):
    (tmp_path / "a.npz").write_bytes(damaged_archives()[name])
    with pytest.raises(ValueError, match=r"a\.npz: not an archive of numbers$"):
        everything(tmp_path / "a.npz")


def test_seeded_damages_are_sentences(tmp_path, rng):
    whole = io.BytesIO()
    np.savez_compressed(whole, a=NUMBERS, one=np.array(True))
    content = whole.getvalue()
    for _ in range(300):
        damaged = bytearray(content)
        for place in rng.integers(len(damaged), size=rng.integers(1, 5)):
            damaged[place] = rng.integers(256)
        (tmp_path / "a.npz").write_bytes(damaged[: rng.integers(3 * len(damaged))])
        try:
            assert set(everything(tmp_path / "a.npz")) <= {"a", "one"}
        except ValueError as error:
            assert str(error).endswith("a.npz: not an archive of numbers")  # noqa: PT017


def test_what_is_no_file(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.npz: there is no such file"):
        everything(tmp_path / "none.npz")
    with pytest.raises(ValueError, match="not an archive of numbers"):
        everything(tmp_path)
