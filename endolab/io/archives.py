"""Arrays in an .npz: what it promises is read and judged before anything is inflated."""

from __future__ import annotations

import errno
import math
import re
import zipfile
import zlib
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from endolab.io.atomic import PathLike, as_path, one_sentence
from endolab.numerics.memory import check_memory

MOST_PIXELS = 100_000_000  # of a map in a file; no endoscope has a tenth of them
_HEAD = re.compile(
    rb"\{'descr': '([<>|](?:b1|[iu][1248]|f[248])|[<>]U\d{1,7})', 'fortran_order': (False|True), "
    rb"'shape': \(((?:\d{1,12}, )*(?:\d{1,12},?)?)\), \} *\n"
)
_ENCRYPTED = 1  # bit of an entry's flags


@dataclass(frozen=True)
class Head:
    """What the head of an array says."""

    dtype: np.dtype
    shape: tuple[int, ...]
    fortran: bool
    begins: int  # where its numbers begin, bytes


def read_arrays(
    path: PathLike, what: str, names: Collection[str], check: Callable[[dict[str, Head]], None]
) -> dict[str, np.ndarray]:
    """Read the arrays of an .npz that have one of a few names, as far as they are there.

    `what` says what it should be: "a depth.npz that endolab wrote". `check` is given the heads, to refuse
    them by raising before anything is inflated. ValueError or OSError in one sentence, if it is something
    else.
    """
    source = as_path(path)
    with one_sentence(f"{source}: cannot be read"):
        if not source.exists():
            raise FileNotFoundError(f"{source}: there is no such file")
        if not source.is_file():
            raise ValueError(f"{source}: not {what}")
    with _told(source, what), zipfile.ZipFile(source) as archive:
        entries = {entry.filename.removesuffix(".npy"): entry for entry in archive.infolist()}
        heads = {name: _head(archive, entries[name]) for name in names if name in entries}
    check(heads)
    needed = sum(head.dtype.itemsize * math.prod(head.shape) for head in heads.values())
    check_memory(2 * needed, f"{source}: what it holds")
    with _told(source, what), zipfile.ZipFile(source) as archive:
        return {name: _array(archive, entries[name], head) for name, head in heads.items()}


@contextmanager
def _told(source: Path, what: str) -> Iterator[None]:
    """Say in one sentence what is wrong with an archive."""
    try:
        yield
    except (ValueError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        raise ValueError(f"{source}: not {what}") from error
    except OSError as error:
        if error.errno == errno.EINVAL:  # a place before the file's beginning was looked for
            raise ValueError(f"{source}: not {what}") from error
        raise OSError(f"{source}: cannot be read: {error.strerror or error}") from error


def _head(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> Head:
    """Read the head of an entry; ValueError if it is no array of numbers or text, as long as that says."""
    if entry.flag_bits & _ENCRYPTED or entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError("encrypted, or compressed as NumPy does not")
    with archive.open(entry) as stream:
        begins = stream.read(10)
        length = int.from_bytes(begins[8:], "little")
        found = _HEAD.fullmatch(stream.read(length))
    if begins[:8] != b"\x93NUMPY\x01\0" or found is None:
        raise ValueError("not an array of numbers or text")
    dtype = np.dtype(found[1].decode())
    shape = tuple(int(size) for size in found[3].decode().split(",") if size.strip())
    if entry.file_size != 10 + length + dtype.itemsize * math.prod(shape):
        raise ValueError("not as long as its head says")
    return Head(dtype, shape, found[2] == b"True", 10 + length)


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, head: Head) -> np.ndarray:
    with archive.open(entry) as stream:
        stream.read(head.begins)
        values = np.frombuffer(stream.read(), head.dtype)
    return values.reshape(head.shape, order="F" if head.fortran else "C")
