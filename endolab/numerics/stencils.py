"""Steps from a pixel to its neighbours, for compiled loops over padded maps: see `compiled`.

`link` is that of `derivatives.links`, padded: 1 where a step leads to the right (first) or down, 0 elsewhere.
"""

from endolab.numerics.arrays import ByteArray, FloatArray
from endolab.numerics.compiled import kernel

# A pixel and its neighbours: right, left, below, above and lower right.
DOWN = (0, 0, 0, 1, -1, 1)
RIGHT = (0, 1, -1, 0, 0, 1)


@kernel
def square(link: ByteArray, i: int, j: int) -> float:
    """1 where the four pixels from column j and row i to the right and below are joined, 0 elsewhere."""
    upper = float(link[0, i, j]) * link[1, i, j]
    return upper * link[0, i + 1, j] * link[1, i, j + 1]


@kernel
def steps(link: ByteArray, i: int, j: int) -> tuple[float, float, float, float]:
    """1 where a step leads from a pixel to the right, left, below and above, 0 elsewhere."""
    right = float(link[0, i, j])
    left = float(link[0, i, j - 1])
    south = float(link[1, i, j])
    north = float(link[1, i - 1, j])
    return right, left, south, north


@kernel
def step_means(link: ByteArray, i: int, j: int) -> tuple[float, float]:
    """By what sums of a pixel's differences become means, along the row and along the column."""
    right, left, south, north = steps(link, i, j)
    return 1 - 0.5 * (right * left), 1 - 0.5 * (south * north)


@kernel
def step_sums(x: FloatArray, link: ByteArray, i: int, j: int) -> tuple[float, float]:
    """Sums of a pixel's differences that there are, along the row and along the column."""
    right, left, south, north = steps(link, i, j)
    here = x[i, j]
    along = right * (x[i, j + 1] - here) + left * (here - x[i, j - 1])
    down = south * (x[i + 1, j] - here) + north * (here - x[i - 1, j])
    return along, down
