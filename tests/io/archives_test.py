"""Arrays in an .npz: nothing is inflated that was not judged first, and nothing is code."""

import io
import struct
import zipfile

import numpy as np
import pytest

from endolab.io.archives import read_arrays

NUMBERS = np.arange(12, dtype=np.float32).reshape(3, 4)
NAMES = ("a", "f", "big", "one", "text")


def read(path):
    return read_arrays(path, "an archive of numbers", NAMES)


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_what_numpy_wrote_is_read(tmp_path, save):
    written = {
        "a": NUMBERS,
        "f": np.asfortranarray(NUMBERS),
        "big": NUMBERS.astype(">f8"),
    }
    written |= {"one": np.array(True), "text": np.array("λ")}
    # Which is not asked for.
    save(tmp_path / "a.npz", **written, other=np.array([{}], object))
    found = read(tmp_path / "a.npz")
    assert list(found) == list(written)
    for name, values in written.items():
        np.testing.assert_array_equal(found[name], values, strict=True)


def promising(shape):
    """An archive whose array has a head that promises a shape, with the numbers of `NUMBERS` behind it."""
    text = (
        f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}".ljust(117)
        + "\n"
    )
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        head = b"\x93NUMPY\x01\0" + struct.pack("<H", len(text)) + text.encode()
        archive.writestr("a.npy", head + NUMBERS.tobytes())
    return content.getvalue()


def saved(values):
    content = io.BytesIO()
    np.savez(content, a=values)
    return content.getvalue()


WHOLE = saved(NUMBERS)
DAMAGED = {
    "text": b"hello",
    "half": WHOLE[: len(WHOLE) // 2],
    "changed": WHOLE.replace(NUMBERS.tobytes()[8:16], bytes(8)),
    "code": saved(np.array([{}], object)),
    "longer than it is": promising("(1000000, 1000000)"),
    "no shape": promising("(1,) * 9**9"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_what_is_damaged_or_holds_code_is_refused_in_one_sentence(tmp_path, name):
    (tmp_path / "a.npz").write_bytes(DAMAGED[name])
    with pytest.raises(ValueError, match=r"a\.npz: not an archive of numbers$"):
        read(tmp_path / "a.npz")


def test_a_bomb_is_refused_before_it_is_inflated(tmp_path, monkeypatch):
    np.savez_compressed(tmp_path / "a.npz", a=np.zeros(10**7))
    assert (tmp_path / "a.npz").stat().st_size < 10**5
    monkeypatch.setattr("endolab.io.archives.MOST_BYTES", 10**7)
    with pytest.raises(
        ValueError, match=r"a\.npz: not an archive of numbers: .*0\.1 GB"
    ):
        read(tmp_path / "a.npz")
