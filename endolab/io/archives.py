"""Arrays in an .npz: what it promises is judged before anything is inflated."""

import io
import zipfile
from collections.abc import Collection

import numpy as np

from endolab.io.atomic import PathLike, damage_told, read_bytes
from endolab.numerics.memory import check_memory


def read_arrays(path: PathLike, what: str, names: Collection[str]) -> dict[str, np.ndarray]:
    """Read the arrays of an .npz that have one of a few names, as far as they are there.

    `what` says what it should be: "a depth.npz that endolab wrote". ValueError or OSError in one sentence,
    if it is something else; MemoryError, before anything is inflated, if that is larger than memory.
    """
    content = read_bytes(path)
    with damage_told(path, what), zipfile.ZipFile(io.BytesIO(content)) as archive:
        sizes = {entry.filename.removesuffix(".npy"): entry.file_size for entry in archive.infolist()}
    check_memory(2 * sum(sizes.get(name, 0) for name in names), f"{path}: what it holds")
    with damage_told(path, what), np.load(io.BytesIO(content), allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in names if name in sizes}
        return {name: np.asarray(array, order="C") for name, array in arrays.items()}
