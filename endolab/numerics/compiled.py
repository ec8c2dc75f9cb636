"""Compiled loops: how they are compiled and kept, and the padding that spares them their borders.

Numba keeps what it has compiled for the next run: beside the sources, in the user's folder for such things,
or where `NUMBA_CACHE_DIR` says. Where none of them can be written, each run compiles.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import config as numba_config
from numba import njit
from numba.core import event

from endolab.numerics.arrays import FloatArray
from endolab.numerics.iteration import CLOCK


def _cache_is_kept() -> bool:
    """Whether there is a place where what is compiled can be kept for the next run."""
    try:
        njit(cache=True)(_cache_is_kept)  # which is not compiled by that
    except RuntimeError:
        return False
    return True


CACHE = _cache_is_kept()
kernel: Callable[..., Any] = njit(  # type: ignore[call-overload]
    cache=CACHE, nogil=True, error_model="numpy", no_cfunc_wrapper=True
)
PAD = 2

config: Any = numba_config


class _Compiling(event.TimingListener):
    """Tells `CLOCK` the seconds that loops are being compiled; endolab's are with less optimisation."""

    def __init__(self) -> None:
        super().__init__()
        self.levels: list[int] = []  # as they were before; one loop may need others

    def on_start(self, occurrence: Any) -> None:
        super().on_start(occurrence)
        self.levels.append(config.OPT)
        if occurrence.data["dispatcher"].py_func.__module__.startswith("endolab."):
            # Of 0 to 3; Numba's own is 3, whose loops are no faster and take a third longer to compile.
            config.OPT = type(config.OPT)(1)

    def on_end(self, occurrence: Any) -> None:
        super().on_end(occurrence)
        config.OPT = self.levels.pop()
        CLOCK.compiled = self.duration if self.done else 0.0


event.register("numba:compile", _Compiling())


@kernel
def copy_row(source: FloatArray, target: FloatArray) -> None:
    """Copy a row; in compiled loops several times as fast as an assignment to a slice."""
    for j in range(source.size):
        target[j] = source[j]


@kernel
def clear_row(row: FloatArray) -> None:
    """Write zeros to a row."""
    for j in range(row.size):
        row[j] = 0.0


def pad_maps(a: Any) -> Any:
    """Return maps (..., H, W) with `PAD` zeros around each."""
    out = np.zeros(
        (*a.shape[:-2], a.shape[-2] + 2 * PAD, a.shape[-1] + 2 * PAD), dtype=a.dtype
    )
    inner(out)[...] = a
    return out


def inner(a: Any) -> Any:
    """Return padded maps without their padding, as a view."""
    return a[..., PAD:-PAD, PAD:-PAD]


def block_sums(a: Any) -> Any:
    """Sum of a padded map over every 2×2 block, padded; of an odd number of rows, the last block has one."""
    height, width = ((size - 2 * PAD + 1) // 2 for size in a.shape)
    even = a[PAD : PAD + 2 * height, PAD : PAD + 2 * width]
    rows = even[::2] + even[1::2]
    return pad_maps(rows[:, ::2] + rows[:, 1::2])


def active_blocks(active: Any) -> Any:
    """Blocks of which at least one pixel is active."""
    return (block_sums(active) > 0).astype(np.int8)


def halve_links(link: Any) -> Any:
    """Links between 2×2 blocks: where at least one pair of their pixels is linked."""
    outer = link.copy()  # of the links from pixel to pixel, those that lead out of a block
    inner(outer)[0, :, ::2] = 0
    inner(outer)[1, ::2] = 0
    return np.stack([active_blocks(outer[0]), active_blocks(outer[1])])
