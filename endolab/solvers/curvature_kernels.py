"""What `curvature.py` says, compiled, row by row: the form, its two costs and their parabolas.

The form at a pixel is linear in w at nine: itself and the neighbours to the right, left, below, above, below
right, below left, above right and above left, in this order. `rays` are padded, (3, ...), as are the maps,
see `numerics.compiled`. The same, readably: tests/solvers/curvature_model.py.
"""

import numpy as np

from endolab.numerics.arrays import ByteArray, FloatArray, Span
from endolab.numerics.compiled import PAD, copy_row, kernel
from endolab.numerics.threads import on_cores, rows_within
from endolab.solvers.curvature import ANGLE, CREASE, SLIGHT, TWOFOLD

# Of the nine, from the pixel.
DOWN = (0, 0, 0, 1, -1, 1, 1, -1, -1)
RIGHT = (0, 1, -1, 0, 0, 1, -1, 1, -1)


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


@kernel
def _squares_row(link: ByteArray, i: int, shares: FloatArray) -> None:
    """Shares of the squares to the lower right, lower left, upper right and upper left in uv, on a row."""
    for j in range(shares.shape[1]):
        shares[0, j] = square(link, i, j + 2)
        shares[1, j] = square(link, i, j + 1)
        shares[2, j] = square(link, i - 1, j + 2)
        shares[3, j] = square(link, i - 1, j + 1)
        count = max((shares[0, j] + shares[3, j]) + (shares[1, j] + shares[2, j]), 1.0)
        for k in range(4):
            shares[k, j] /= count


@kernel
def _twist(x: FloatArray, i: int, j: int) -> float:
    """Mixed difference of the square to the lower right of a pixel."""
    return (x[i + 1, j + 1] + x[i, j]) - (x[i + 1, j] + x[i, j + 1])


@kernel
def _mixed_of_row(x: FloatArray, squares: FloatArray, i: int, out: FloatArray) -> None:
    """uv of a map on a row: the mean of those of the squares that there are."""
    for j in range(out.size):
        falling = squares[0, j] * _twist(x, i, j + 2)
        falling += squares[3, j] * _twist(x, i - 1, j + 1)
        rising = squares[1, j] * _twist(x, i, j + 1)
        rising += squares[2, j] * _twist(x, i - 1, j + 2)
        out[j] = falling + rising


@kernel
def _cross_row(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """Vector product of two rows of vectors, (3, ...)."""
    for k in range(3):
        before = a[k - 2]
        after = a[k - 1]
        for j in range(out.shape[1]):
            out[k, j] = before[j] * b[k - 1, j] - after[j] * b[k - 2, j]


@on_cores(cost=15)
def fill_shares(rows: Span, rays: FloatArray, link: ByteArray, out: FloatArray) -> None:
    """a, b and c, (3, ...), of uu, uv and vv, (3, ...): 0 where one is not known.

    a and b are of the sums of the differences to both sides, not of their means.
    """
    first, last = rows_within(rows, PAD, rays.shape[1] - PAD)
    count = rays.shape[2] - 2 * PAD
    ray = np.empty((3, count))
    across = np.empty((3, count))
    along = np.empty((3, count))
    known = np.empty((3, count))
    volume = np.empty(count)
    part = np.empty(count)
    second = np.empty((3, 3, count))
    plane = np.empty((3, 3, count))
    means = np.ones((3, count))
    squares = np.empty((4, count))
    for i in range(first, last):
        _know_row(link, i, known)
        _squares_row(link, i, squares)
        for j in range(count):
            means[0, j], means[1, j] = step_means(link, i, j + 2)
        for k in range(3):
            x = rays[k]
            for j in range(count):
                along_row, along_column = step_sums(x, link, i, j + 2)
                ray[k, j] = x[i, j + 2]
                across[k, j] = along_row * means[0, j]
                along[k, j] = along_column * means[1, j]
                second[0, k, j] = x[i, j + 3] - 2 * ray[k, j] + x[i, j + 1]
                second[2, k, j] = x[i + 1, j + 2] - 2 * ray[k, j] + x[i - 1, j + 2]
            _mixed_of_row(x, squares, i, second[1, k])
        # Cramer's rule for a r_u + b r_v + c r
        _cross_row(along, ray, plane[0])
        _cross_row(ray, across, plane[1])
        _cross_row(across, along, plane[2])
        _dot_row(across, plane[0], volume)
        for k in range(3):
            for n in range(3):
                _dot_row(second[k], plane[n], part)
                for j in range(count):
                    there = known[k, j] > 0
                    share = means[n, j] * part[j] / (volume[j] if there else 1.0)
                    out[k, n, i, j + 2] = share if there else 0.0


@kernel
def _dot_row(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """Scalar product of two rows of vectors, (3, ...)."""
    for j in range(out.size):
        out[j] = a[0, j] * b[0, j] + a[1, j] * b[1, j] + a[2, j] * b[2, j]


@kernel
def _know_row(link: ByteArray, i: int, known: FloatArray) -> None:
    """1 where uu and vv have all their steps, and one on the other axis, and uv a square, 0 elsewhere."""
    for j in range(known.shape[1]):
        right, left, south, north = steps(link, i, j + 2)
        below = max(square(link, i, j + 2), square(link, i, j + 1))
        above = max(square(link, i - 1, j + 2), square(link, i - 1, j + 1))
        known[0, j] = right * left * max(south, north)
        known[1, j] = max(below, above)
        known[2, j] = south * north * max(right, left)


@kernel
def bend_row(
    x: FloatArray, link: ByteArray, shares: FloatArray, i: int, form: FloatArray
) -> None:
    """The form of a map on a row, 0 where it is not known; `shares` as `fill_shares` writes them."""
    known = np.empty(form.shape)
    squares = np.empty((4, form.shape[1]))
    _know_row(link, i, known)
    _squares_row(link, i, squares)
    uu = form[0]
    uv = form[1]
    vv = form[2]
    _mixed_of_row(x, squares, i, uv)
    for j in range(uu.size):
        here = x[i, j + 2]
        uu[j] = known[0, j] * (x[i, j + 3] - 2 * here + x[i, j + 1])
        vv[j] = known[2, j] * (x[i + 1, j + 2] - 2 * here + x[i - 1, j + 2])
    for k in range(3):
        bend = form[k]
        a = shares[k, 0, i]
        b = shares[k, 1, i]
        c = shares[k, 2, i]
        for j in range(bend.size):
            u, w = step_sums(x, link, i, j + 2)
            bend[j] -= a[j + 2] * u + b[j + 2] * w + c[j + 2] * x[i, j + 2]


@kernel
def add_unbent_row(
    form: FloatArray, link: ByteArray, shares: FloatArray, i: int, out: FloatArray
) -> None:
    """Add the adjoint of `bend_row` to a map; `form` is 0 where it is not known."""
    here = out[i]
    up = out[i - 1]
    down = out[i + 1]
    uu = form[0]
    uv = form[1]
    vv = form[2]
    across = np.empty(uu.size)
    squares = np.empty((4, uu.size))
    _squares_row(link, i, squares)
    for k in range(4):
        for j in range(uu.size):
            squares[k, j] *= uv[j]
    for j in range(uu.size):
        a = shares[0, 0, i, PAD + j] * uu[j] + shares[1, 0, i, PAD + j] * uv[j]
        a += shares[2, 0, i, PAD + j] * vv[j]
        b = shares[0, 1, i, PAD + j] * uu[j] + shares[1, 1, i, PAD + j] * uv[j]
        b += shares[2, 1, i, PAD + j] * vv[j]
        c = shares[0, 2, i, PAD + j] * uu[j] + shares[1, 2, i, PAD + j] * uv[j]
        c += shares[2, 2, i, PAD + j] * vv[j]
        across[j] = a
        right, left, south, north = steps(link, i, j + 2)
        own = a * (left - right) + b * (north - south) + c
        falling = squares[0, j] + squares[3, j]
        rising = squares[1, j] + squares[2, j]
        here[j + 2] += falling - rising - 2 * uu[j] - 2 * vv[j] - own
        down[j + 2] += vv[j] - squares[0, j] + squares[1, j] - b * south
        up[j + 2] += vv[j] + squares[2, j] - squares[3, j] + b * north
    for j in range(uu.size):
        right = float(link[0, i, j + 2])
        here[j + 3] += uu[j] - squares[0, j] + squares[2, j] - across[j] * right
        down[j + 3] += squares[0, j]
        up[j + 3] -= squares[2, j]
    for j in range(uu.size):
        left = float(link[0, i, j + 1])
        here[j + 1] += uu[j] + squares[1, j] - squares[3, j] + across[j] * left
        down[j + 1] -= squares[1, j]
        up[j + 1] += squares[3, j]


@kernel
def _measure_row(
    form: FloatArray,
    metric: FloatArray,
    link: ByteArray,
    i: int,
    size: FloatArray,
    twofold: FloatArray,
) -> None:
    """What is charged; the second is 0 where not all of the form is known."""
    known = np.empty(form.shape)
    _know_row(link, i, known)
    for j in range(size.size):
        uu = form[0, j]
        uv = form[1, j]
        vv = form[2, j]
        p = metric[0, i, j + 2]
        q = metric[1, i, j + 2]
        r = metric[2, i, j + 2]
        here = uu * p + uv * q
        there = uv * q + vv * r
        square = here * here + 2 * (uu * q + uv * r) * (uv * p + vv * q) + there * there
        size[j] = ANGLE**2 * np.sqrt(max(square, 0.0))
        product = ANGLE**4 * (uu * vv - uv * uv) * (p * r - q * q)
        all_known = known[0, j] * known[1, j] * known[2, j]
        twofold[j] = all_known * product / np.sqrt(size[j] * size[j] + SLIGHT * SLIGHT)


@kernel
def add_bending_row(
    form: FloatArray,
    metric: FloatArray,
    link: ByteArray,
    i: int,
    epsilon: float,
    weight: FloatArray,
    out: FloatArray,
) -> None:
    """Add what a row's bending costs, by Huber's penalty and with these weights, but without λ."""
    size = np.empty(out.size)
    twofold = np.empty(out.size)
    _measure_row(form, metric, link, i, size, twofold)
    epsilon *= CREASE
    for j in range(out.size):
        size_here = size[j]
        twofold_here = abs(twofold[j])
        less = min(size_here, epsilon)
        little = min(twofold_here, epsilon)
        cost = less * (size_here - 0.5 * less) + TWOFOLD * (
            little * (twofold_here - 0.5 * little)
        )
        out[j] += weight[j + 2] * cost / epsilon


@kernel
def weigh_bending_row(
    form: FloatArray,
    metric: FloatArray,
    link: ByteArray,
    i: int,
    epsilon: float,
    weight: FloatArray,
    smoothness: FloatArray,
) -> None:
    """Write Q, six maps: the cost is about ½ formᵀ Q form; the form becomes its slope, Q form.

    Parabolas touch both penalties; `twofold` is linearised: it is its slope times the form.
    """
    count = form.shape[1]
    known = np.empty(form.shape)
    size = np.empty(count)
    twofold = np.empty(count)
    one = np.empty(count)
    two = np.empty(count)
    a = np.empty(count)
    b = np.empty(count)
    c = np.empty(count)
    falls = np.empty(count)
    rises = np.empty(count)
    mixed = np.empty(count)
    entries = np.empty((6, count))
    q00 = entries[0]
    q01 = entries[1]
    q02 = entries[2]
    q11 = entries[3]
    q12 = entries[4]
    q22 = entries[5]
    p = metric[0, i, PAD:]
    q = metric[1, i, PAD:]
    r = metric[2, i, PAD:]
    uu = form[0]
    uv = form[1]
    vv = form[2]
    ones = np.ones(count)
    _measure_row(form, metric, link, i, size, twofold)
    _know_row(link, i, known)
    epsilon *= CREASE
    # Loops are short: those that write and read many arrays are not made to take many pixels at once.
    for j in range(count):
        softened = size[j] * size[j] + SLIGHT * SLIGHT
        falls[j] = ANGLE**4 * twofold[j] / softened
        # The form times the slope is `twofold` by a factor, 1 to 2.
        factor = 1 + SLIGHT * SLIGHT / softened
        two[j] = weight[j] * TWOFOLD / (max(abs(twofold[j]), epsilon) * factor)
    for j in range(count):
        softened = np.sqrt(size[j] * size[j] + SLIGHT * SLIGHT)
        rises[j] = ANGLE**4 * (p[j] * r[j] - q[j] * q[j]) / softened
        one[j] = weight[j] * ANGLE**4 / max(size[j], epsilon)
    for j in range(count):
        two[j] *= known[0, j] * known[1, j] * known[2, j]
    for j in range(count):
        raised = p[j] * (p[j] * uu[j] + 2 * q[j] * uv[j]) + q[j] * q[j] * vv[j]
        a[j] = rises[j] * vv[j] - falls[j] * raised
    for j in range(count):
        mixed[j] = p[j] * r[j] + q[j] * q[j]
        raised = p[j] * q[j] * uu[j] + mixed[j] * uv[j] + q[j] * r[j] * vv[j]
        b[j] = -2 * rises[j] * uv[j] - 2 * falls[j] * raised
    for j in range(count):
        raised = q[j] * q[j] * uu[j] + r[j] * (2 * q[j] * uv[j] + r[j] * vv[j])
        c[j] = rises[j] * uu[j] - falls[j] * raised
    _add_outer(one, 1, p, p, two, a, a, q00)
    _add_outer(one, 2, p, q, two, a, b, q01)
    _add_outer(one, 1, q, q, two, a, c, q02)
    _add_outer(one, 2, mixed, ones, two, b, b, q11)
    _add_outer(one, 2, q, r, two, b, c, q12)
    _add_outer(one, 1, r, r, two, c, c, q22)
    for j in range(count):
        a[j] = known[0, j] * (q00[j] * uu[j] + q01[j] * uv[j] + q02[j] * vv[j])
    for j in range(count):
        b[j] = known[1, j] * (q01[j] * uu[j] + q11[j] * uv[j] + q12[j] * vv[j])
    for j in range(count):
        c[j] = known[2, j] * (q02[j] * uu[j] + q12[j] * uv[j] + q22[j] * vv[j])
    for k, row in enumerate((a, b, c)):
        copy_row(row, form[k])
    for k in range(6):
        copy_row(entries[k], smoothness[k, i, PAD:])


@kernel
def _add_outer(
    one: FloatArray,
    times: int,
    x: FloatArray,
    y: FloatArray,
    two: FloatArray,
    a: FloatArray,
    b: FloatArray,
    out: FloatArray,
) -> None:
    """An entry of Q: what the size and the twofold bending cost."""
    for j in range(out.size):
        out[j] = one[j] * times * x[j] * y[j] + two[j] * a[j] * b[j]


@kernel
def stencils_row(link: ByteArray, shares: FloatArray, i: int, t: FloatArray) -> None:
    """Weights (3, 9, ...) of the nine pixels for uu, uv and vv, on a row; 0 where one is not known."""
    count = t.shape[2]
    known = np.empty((3, count))
    squares = np.empty((4, count))
    _know_row(link, i, known)
    _squares_row(link, i, squares)
    lower_right = squares[0]
    lower_left = squares[1]
    upper_right = squares[2]
    upper_left = squares[3]
    t[:3] = 0.0
    for j in range(count):
        t[0, 0, j] = -2 * known[0, j]
        t[0, 1, j] = known[0, j]
        t[0, 2, j] = known[0, j]
        t[2, 0, j] = -2 * known[2, j]
        t[2, 3, j] = known[2, j]
        t[2, 4, j] = known[2, j]
    for j in range(count):
        falling = lower_right[j] + upper_left[j]
        t[1, 0, j] = falling - (lower_left[j] + upper_right[j])
        t[1, 1, j] = upper_right[j] - lower_right[j]
        t[1, 2, j] = lower_left[j] - upper_left[j]
        t[1, 3, j] = lower_left[j] - lower_right[j]
        t[1, 4, j] = upper_right[j] - upper_left[j]
        t[1, 5, j] = lower_right[j]
        t[1, 6, j] = -lower_left[j]
        t[1, 7, j] = -upper_right[j]
        t[1, 8, j] = upper_left[j]
    for k in range(3):
        a = shares[k, 0, i]
        b = shares[k, 1, i]
        c = shares[k, 2, i]
        for j in range(count):
            right, left, south, north = steps(link, i, j + 2)
            t[k, 0, j] -= a[j + 2] * (left - right) + c[j + 2]
            t[k, 1, j] -= a[j + 2] * right
            t[k, 2, j] += a[j + 2] * left
            t[k, 0, j] -= b[j + 2] * (north - south)
            t[k, 3, j] -= b[j + 2] * south
            t[k, 4, j] += b[j + 2] * north
