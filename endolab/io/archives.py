"""Arrays in an .npz: what it promises is judged before anything is inflated."""

import io
import zipfile
from collections.abc import Collection

import numpy as np

from endolab.io.atomic import PathLike, name_damage, read_bytes
from endolab.numerics.memory import check_memory

# Bytes of arrays; the maps of a frame of 10 megapixels take a sixth.
MOST_BYTES = 2_000_000_000


def array_names(path: PathLike, what: str) -> list[str]:
    """Name the arrays of an .npz; errors as of `read_arrays`."""
    content = io.BytesIO(read_bytes(path))
    with name_damage(path, what), zipfile.ZipFile(content) as archive:
        return [name.removesuffix(".npy") for name in archive.namelist()]


def read_arrays(path: PathLike, what: str, names: Collection[str]) -> dict[str, np.ndarray]:
    """Read the arrays of an .npz that have one of a few names, as far as they are there.

    `what` says what it should be: "a depth.npz that endolab wrote". ValueError or OSError in one sentence,
    if it is something else; that, or a MemoryError, before anything is inflated, if it is too large.
    """
    content = read_bytes(path)
    with name_damage(path, what), zipfile.ZipFile(io.BytesIO(content)) as archive:
        sizes = {
            entry.filename.removesuffix(".npy"): entry.file_size
            for entry in archive.infolist()
        }
    needed = sum(sizes.get(name, 0) for name in names)
    if needed > MOST_BYTES:
        raise ValueError(f"{path}: not {what}: it would take {needed / 1e9:.1f} GB")
    check_memory(2 * needed, f"{path}: what it holds")
    with (
        name_damage(path, what),
        np.load(io.BytesIO(content), allow_pickle=False) as archive,
    ):
        arrays = {name: archive[name] for name in names if name in sizes}
        return {name: np.asarray(array, order="C") for name, array in arrays.items()}
