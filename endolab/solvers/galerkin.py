"""The matrix of a coarse grid as the fine one has it: C = Pᵀ A P (Galerkin).

P leads from blocks to pixels (`interpolation`). So a step of the blocks, interpolated, costs what it costs
on the fine grid, beside cuts as well. Equations that are written down anew from averaged coefficients do
as well where nothing is cut; beside cuts they do not: there conjugate gradients took 11 steps where
they take 2 or 3 now.

Two pixels that are coupled are two rows and columns apart at most, and so are two blocks. Amid four blocks
of one side a pixel's weights are a row's times a column's, 3/4 for its own block and 1/4 for that beside.
There C is summed to the right, to the left and then down:

    pixels     o  *  |  o  o          A_ij couples the pixels * and +
               o  o  |  o  +          1/4 · 3/4 of it, along rows, couples their blocks C and C'
              ---C---+---C'--

Beside cuts and rims P has other rows, whose pixels are taken one by one. What they couple
further apart than two blocks is a hundredth and less; its size is added to the diagonal of both, so that C
stays positive.
"""

from __future__ import annotations

import numpy as np

from endolab.numerics.arrays import FloatArray, Span
from endolab.numerics.compiled import PAD, clear_row, kernel
from endolab.numerics.threads import on_cores
from endolab.solvers.interpolation import Interpolation
from endolab.solvers.normal_equations import OFFSETS

# Which entry of `normal_equations.OFFSETS` couples a pixel to that dy rows down and dx - 2 columns right.
ENTRY_AT = np.array([[2, 1, 0, 1, 2], [9, 6, 3, 5, 7], [12, 10, 4, 8, 11]])
REACH = 3  # blocks from a pixel's own that it and its neighbours follow, along an axis


@kernel
def _pixels_of_entry(
    m: FloatArray, regular: FloatArray, i: int, dy: int, dx: int, row: FloatArray
) -> None:
    """Write what couples the pixels of a row to those dy down and dx right, where P is regular for both."""
    entry = ENTRY_AT[dy, dx + 2]
    if entry >= len(m):
        clear_row(row)
        return
    other = max(PAD + dx, 0)
    holder = max(
        min(other, PAD) if dy == 0 else PAD, 0
    )  # the earlier pixel holds the entry
    for j in range(row.size - 2 * PAD):
        inside = 256 * regular[i, j + PAD] * regular[i + dy, j + other]
        row[j + PAD] = inside * m[entry, i, j + holder]


@kernel
def _sum_along(pixels: FloatArray, first: FloatArray, b: FloatArray) -> None:
    """Sum a row's `pixels` (5, W), two to the left up to two to the right, into blocks: b (5, w) likewise.

    First to the right, into `first` (2, 4, w), what couples the first and the second pixel of a block to
    blocks, which mirror each other; then to the left.
    """
    count = b.shape[1] - 2 * PAD
    for k in range(2):
        for c in range(count):
            j = 2 * c + PAD + k
            far = pixels[4 * k, j]
            near = pixels[1 + 2 * k, j]
            own = pixels[2, j]
            beside = pixels[3 - 2 * k, j]
            last = pixels[4 - 4 * k, j]
            first[k, 3 * k, c + 2] = far
            first[k, 1 + k, c + 2] = 3 * (far + near) + own
            first[k, 2 - k, c + 2] = near + 3 * (own + beside) + last
            first[k, 3 - 3 * k, c + 2] = beside + 3 * last
    for c in range(count):
        b[0, c + 2] = (3 * first[0, 0, c + 2] + first[1, 0, c + 1]) / 16
        b[4, c + 2] = (3 * first[1, 3, c + 2] + first[0, 3, c + 3]) / 16
    for k in range(1, 4):
        for c in range(count):
            amid = first[0, k, c + 2] + first[1, k - 1, c + 2]
            beyond = first[1, k, c + 1] + first[0, k - 1, c + 3]
            b[k, c + 2] = (3 * amid + beyond) / 16


@kernel
def _sum_down(b: FloatArray, i: int, rows: Span, sums: FloatArray, out: FloatArray) -> None:
    """Add b (3, 5, w), of the row i of pixels and those 0 to 2 below, to these rows of blocks.

    What couples pixels of one row, b[0], is there in both orders, and counts half in each.
    """
    own = PAD + (i - PAD) // 2
    is_even = (i - PAD) % 2 == 0
    for ex in range(5):
        for c in range(b.shape[2]):
            half = b[0, ex, c] / 2
            below = b[1, ex, c]
            last = b[2, ex, c]
            sums[0, ex, c] = half if is_even else 3 * half + below
            sums[1, ex, c] = 3 * (half if is_even else last) + 3 * below
            sums[1, ex, c] += last if is_even else half
            sums[2, ex, c] = below + 3 * last if is_even else last
    top = own - 1 if is_even else own
    for k in range(2):
        row = own if k == 0 else (own - 1 if is_even else own + 1)
        weight = (3 if k == 0 else 1) / 16
        for n in range(3):
            _add_row(sums[n], row, top + n, weight, rows, out)


@kernel
def _add_row(
    b: FloatArray, row: int, other: int, weight: float, rows: Span, out: FloatArray
) -> None:
    """Add b (5, w), what couples a row of blocks to another one, and its transpose."""
    down = other - row
    for ex in range(-2, 3):
        # The earlier of two blocks holds what couples them.
        later = down > 0 or (down == 0 and ex >= 0)
        entry = ENTRY_AT[abs(down), 2 + (ex if later else -ex)]
        at = row if later else other
        if not rows[0] <= at < rows[1]:
            continue
        target = max(PAD + (0 if later else ex), 0)
        times = 2 * weight if down == 0 and ex == 0 else weight
        for c in range(b.shape[1] - 2 * PAD):
            out[entry, at, c + target] += times * b[ex + 2, c + PAD]


@kernel
def _row_and_weight(i: int, k: int) -> tuple[int, float]:
    """The block that a pixel's row lies in (k = 0) or beside (k = 1), and its weight."""
    own = PAD + (i - PAD) // 2
    if k == 0:
        return own, 0.75
    return own + (1 if (i - PAD) % 2 else -1), 0.25


@kernel
def _add_value(
    value: float,
    interpolation: Interpolation,
    i: int,
    j: int,
    sums: FloatArray,
    top: int,
    first: int,
) -> None:
    """Add a value times the pixel's row of P to sums, of which (top, first) is the first block.

    Pixels beside cuts and rims bring the same once more, and count half.
    """
    regular, starts, _, block_row, block_column, weight = interpolation
    if regular[i, j] > 0:
        for k in range(2):
            row, by_row = _row_and_weight(i, k)
            for n in range(2):
                column, by_column = _row_and_weight(j, n)
                sums[row - top, column - first] += value * by_row * by_column
        return
    pixel = i * regular.shape[1] + j
    for k in range(starts[pixel], starts[pixel + 1]):
        half = 0.5 * value * weight[k]
        sums[block_row[k] - top, block_column[k] - first] += half


@kernel
def _add_between(
    value: float,
    row: int,
    column: int,
    other: int,
    beside: int,
    rows: Span,
    out: FloatArray,
) -> None:
    """Add what couples a block to that at (`other`, `beside`), and its transpose, to these rows."""
    if other < row or (other == row and beside < column):
        row, column, other, beside = other, beside, row, column
    down = other - row
    right = beside - column
    if down > 2 or abs(right) > 2:
        if rows[0] <= row < rows[1]:
            out[0, row, column] += abs(value)
        if rows[0] <= other < rows[1]:
            out[0, other, beside] += abs(value)
    elif rows[0] <= row < rows[1]:
        own = down == 0 and right == 0
        out[ENTRY_AT[down, 2 + right], row, column] += 2 * value if own else value


@kernel
def _add_special(
    m: FloatArray,
    interpolation: Interpolation,
    i: int,
    rows: Span,
    sums: FloatArray,
    out: FloatArray,
) -> None:
    """Add what the pixels of a row beside cuts and rims couple; `sums` is room for a row of A P."""
    regular, starts, _, block_row, block_column, weight = interpolation
    width = regular.shape[1]
    if starts[i * width] == starts[(i + 1) * width]:
        return
    top = PAD + (i - PAD) // 2 - REACH
    for j in range(PAD, width - PAD):
        start = starts[i * width + j]
        end = starts[i * width + j + 1]
        if start == end:
            continue
        first = PAD + (j - PAD) // 2 - REACH
        _add_value(m[0, i, j], interpolation, i, j, sums, top, first)
        for entry in range(1, len(m)):
            down, right = OFFSETS[entry]
            for side in (1, -1):
                row = i + side * down
                column = j + side * right
                value = m[entry, i, j] if side == 1 else m[entry, row, column]
                if value != 0:
                    _add_value(value, interpolation, row, column, sums, top, first)
        for y in range(sums.shape[0]):
            for x in range(sums.shape[1]):
                value = sums[y, x]
                sums[y, x] = 0.0
                if value == 0:
                    continue
                for k in range(start, end):
                    part = weight[k] * value
                    row = block_row[k]
                    _add_between(part, row, block_column[k], top + y, first + x, rows, out)


@on_cores(cost=120)
def coarsen(
    rows: Span, out: FloatArray, m: FloatArray, interpolation: Interpolation
) -> None:
    """Write the matrix of the blocks, (13, ...), of a matrix (7 or 13, ...) of the pixels, in these rows."""
    regular = interpolation.regular
    for k in range(len(out)):
        for i in range(rows[0], rows[1]):
            clear_row(out[k, i])
    pixels = np.zeros((5, regular.shape[1]))
    b, summed = np.zeros((2, 3, 5, out.shape[2]))
    to_right = np.zeros((2, 4, out.shape[2]))
    around = np.zeros((2 * REACH + 1, 2 * REACH + 1))
    first = PAD + 2 * max(rows[0] - PAD - REACH - 1, 0)
    last = PAD + 2 * (rows[1] - PAD + REACH + 1)
    for i in range(first, min(last, regular.shape[0] - PAD)):
        for dy in range(3):
            for dx in range(-2, 3):
                _pixels_of_entry(m, regular, i, dy, dx, pixels[dx + 2])
            _sum_along(pixels, to_right, b[dy])
        _sum_down(b, i, rows, summed, out)
        _add_special(m, interpolation, i, rows, around, out)
