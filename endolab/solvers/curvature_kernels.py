"""What `curvature.py` says, compiled, row by row: the form, its two costs and their parabolas.

The form at a pixel is linear in w at nine: itself and the neighbours to the right, left, below, above, below
right, below left, above right and above left, in this order. `rays` are padded, (3, ...), as are the maps,
see `numerics.compiled`.
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
    return (
        float(link[0, i, j])
        * float(link[1, i, j])
        * float(link[0, i + 1, j])
        * float(link[1, i, j + 1])
    )


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
def _mixed_of_row(x: FloatArray, squares: FloatArray, i: int, out: FloatArray) -> None:
    """uv of a map on a row: the mean of those of the squares that there are."""
    up = x[i - 1]
    row = x[i]
    down = x[i + 1]
    for j in range(out.size):
        falling = squares[0, j] * ((down[j + 3] + row[j + 2]) - (down[j + 2] + row[j + 3]))
        falling += squares[3, j] * ((row[j + 2] + up[j + 1]) - (row[j + 1] + up[j + 2]))
        rising = squares[1, j] * ((down[j + 2] + row[j + 1]) - (down[j + 1] + row[j + 2]))
        rising += squares[2, j] * ((row[j + 3] + up[j + 2]) - (row[j + 2] + up[j + 3]))
        out[j] = falling + rising


@on_cores(cost=15)
def fill_shares(rows: Span, rays: FloatArray, link: ByteArray, out: FloatArray) -> None:
    """a, b and c, (3, ...), of uu, uv and vv, (3, ...): see `curvature`; 0 where one is not known.

    a and b are of the sums of the differences to both sides, not of their means.
    """
    first, last = rows_within(rows, PAD, rays.shape[1] - PAD)
    count = rays.shape[2] - 2 * PAD
    across = np.empty((3, count))
    along = np.empty((3, count))
    known = np.empty((3, count))
    second = np.empty((3, 3, count))
    plane = np.empty((3, 3, count))
    squares = np.empty((4, count))
    for i in range(first, last):
        _know_row(link, i, known)
        _squares_row(link, i, squares)
        next_to = link[0, i]
        below = link[1, i]
        above = link[1, i - 1]
        for k in range(3):
            row = rays[k, i]
            up = rays[k, i - 1]
            down = rays[k, i + 1]
            for j in range(count):
                right = next_to[j + 2]
                left = next_to[j + 1]
                south = below[j + 2]
                north = above[j + 2]
                here = row[j + 2]
                ahead = float(right) * (row[j + 3] - here) + float(left) * (
                    here - row[j + 1]
                )
                across[k, j] = ahead * (1 - 0.5 * (float(right) * left))
                ahead = float(south) * (down[j + 2] - here) + float(north) * (
                    here - up[j + 2]
                )
                along[k, j] = ahead * (1 - 0.5 * (float(south) * north))
                second[0, k, j] = row[j + 3] - 2 * here + row[j + 1]
                second[2, k, j] = down[j + 2] - 2 * here + up[j + 2]
            _mixed_of_row(rays[k], squares, i, second[1, k])
        # Cramer's rule for a r_u + b r_v + c r
        for j in range(count):
            x = rays[0, i, PAD + j]
            y = rays[1, i, PAD + j]
            z = rays[2, i, PAD + j]
            ux = across[0, j]
            uy = across[1, j]
            uz = across[2, j]
            vx = along[0, j]
            vy = along[1, j]
            vz = along[2, j]
            plane[0, 0, j] = vy * z - vz * y
            plane[0, 1, j] = vz * x - vx * z
            plane[0, 2, j] = vx * y - vy * x
            plane[1, 0, j] = y * uz - z * uy
            plane[1, 1, j] = z * ux - x * uz
            plane[1, 2, j] = x * uy - y * ux
            plane[2, 0, j] = uy * vz - uz * vy
            plane[2, 1, j] = uz * vx - ux * vz
            plane[2, 2, j] = ux * vy - uy * vx
        for k in range(3):
            for n in range(3):
                share = out[k, n, i]
                for j in range(count):
                    right = next_to[j + 2]
                    left = next_to[j + 1]
                    south = below[j + 2]
                    north = above[j + 2]
                    volume = across[0, j] * plane[0, 0, j] + across[1, j] * plane[0, 1, j]
                    volume += across[2, j] * plane[0, 2, j]
                    part = (
                        second[k, 0, j] * plane[n, 0, j] + second[k, 1, j] * plane[n, 1, j]
                    )
                    part += second[k, 2, j] * plane[n, 2, j]
                    mean = (
                        1.0
                        if n == 2
                        else 1
                        - 0.5 * (float(right) * left if n == 0 else float(south) * north)
                    )
                    there = known[k, j] > 0
                    share[j + 2] = (
                        mean * part / (volume if there else 1.0) if there else 0.0
                    )


@kernel
def _know_row(link: ByteArray, i: int, known: FloatArray) -> None:
    """1 where uu and vv have all their steps, and one on the other axis, and uv a square, 0 elsewhere."""
    next_to = link[0, i]
    below = link[1, i]
    above = link[1, i - 1]
    for j in range(known.shape[1]):
        right = float(next_to[j + 2])
        left = float(next_to[j + 1])
        south = float(below[j + 2])
        north = float(above[j + 2])
        known[0, j] = right * left * max(south, north)
        any_below = max(square(link, i, j + 2), square(link, i, j + 1))
        known[1, j] = max(
            any_below, max(square(link, i - 1, j + 2), square(link, i - 1, j + 1))
        )
        known[2, j] = south * north * max(right, left)


@kernel
def bend_row(
    x: FloatArray, link: ByteArray, shares: FloatArray, i: int, form: FloatArray
) -> None:
    """The form of a map on a row, see `curvature.second_form`; `shares` as `fill_shares` writes them."""
    row = x[i]
    up = x[i - 1]
    down = x[i + 1]
    next_to = link[0, i]
    below = link[1, i]
    above = link[1, i - 1]
    known = np.empty(form.shape)
    squares = np.empty((4, form.shape[1]))
    _know_row(link, i, known)
    _squares_row(link, i, squares)
    uu = form[0]
    uv = form[1]
    vv = form[2]
    _mixed_of_row(x, squares, i, uv)
    for j in range(uu.size):
        here = row[j + 2]
        uu[j] = known[0, j] * (row[j + 3] - 2 * here + row[j + 1])
        vv[j] = known[2, j] * (down[j + 2] - 2 * here + up[j + 2])
    for k in range(3):
        bend = form[k]
        a = shares[k, 0, i]
        b = shares[k, 1, i]
        c = shares[k, 2, i]
        for j in range(bend.size):
            here = row[j + 2]
            u = float(next_to[j + 2]) * (row[j + 3] - here) + float(next_to[j + 1]) * (
                here - row[j + 1]
            )
            w = float(below[j + 2]) * (down[j + 2] - here) + float(above[j + 2]) * (
                here - up[j + 2]
            )
            bend[j] -= a[j + 2] * u + b[j + 2] * w + c[j + 2] * here


@kernel
def add_unbent_row(
    form: FloatArray, link: ByteArray, shares: FloatArray, i: int, out: FloatArray
) -> None:
    """Add the adjoint of `bend_row` to a map; `form` is 0 where it is not known."""
    here = out[i]
    up = out[i - 1]
    down = out[i + 1]
    next_to = link[0, i]
    below = link[1, i]
    above = link[1, i - 1]
    uu = form[0]
    uv = form[1]
    vv = form[2]
    across = np.zeros(uu.size)
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
        right = next_to[j + 2]
        left = next_to[j + 1]
        south = below[j + 2]
        north = above[j + 2]
        own = a * (float(left) - right) + b * (float(north) - south) + c
        falling = squares[0, j] + squares[3, j]
        rising = squares[1, j] + squares[2, j]
        here[j + 2] += falling - rising - 2 * uu[j] - 2 * vv[j] - own
        down[j + 2] += vv[j] - squares[0, j] + squares[1, j] - b * float(south)
        up[j + 2] += vv[j] + squares[2, j] - squares[3, j] + b * float(north)
    for j in range(uu.size):
        here[j + 3] += (
            uu[j] - squares[0, j] + squares[2, j] - across[j] * float(next_to[j + 2])
        )
        down[j + 3] += squares[0, j]
        up[j + 3] -= squares[2, j]
    for j in range(uu.size):
        here[j + 1] += (
            uu[j] + squares[1, j] - squares[3, j] + across[j] * float(next_to[j + 1])
        )
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
    """See `curvature.size_and_twofold`; the second is 0 where not all of the form is known."""
    known = np.empty(form.shape)
    _know_row(link, i, known)
    p_row = metric[0, i]
    q_row = metric[1, i]
    r_row = metric[2, i]
    for j in range(size.size):
        uu = form[0, j]
        uv = form[1, j]
        vv = form[2, j]
        p = p_row[j + 2]
        q = q_row[j + 2]
        r = r_row[j + 2]
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
    rows = np.empty((11, count))
    size = rows[0]
    twofold = rows[1]
    one = rows[2]
    two = rows[3]
    a = rows[4]
    b = rows[5]
    c = rows[6]
    falls = rows[7]
    rises = rows[8]
    q01 = rows[9]
    q12 = rows[10]
    p = metric[0, i, PAD:]
    q = metric[1, i, PAD:]
    r = metric[2, i, PAD:]
    uu = form[0]
    uv = form[1]
    vv = form[2]
    _measure_row(form, metric, link, i, size, twofold)
    _know_row(link, i, known)
    epsilon *= CREASE
    # Loops are short: those that write and read many arrays are not made to take many pixels at once.
    for j in range(count):
        softened = size[j] * size[j] + SLIGHT * SLIGHT
        falls[j] = ANGLE**4 * twofold[j] / softened
        # The form times the slope is `twofold` by a factor, 1 to 2.
        two[j] = (
            weight[j]
            * TWOFOLD
            / (max(abs(twofold[j]), epsilon) * (1 + SLIGHT * SLIGHT / softened))
        )
    for j in range(count):
        rises[j] = (
            ANGLE**4
            * (p[j] * r[j] - q[j] * q[j])
            / np.sqrt(size[j] * size[j] + SLIGHT * SLIGHT)
        )
        one[j] = weight[j] * ANGLE**4 / max(size[j], epsilon)
    for j in range(count):
        two[j] *= known[0, j] * known[1, j] * known[2, j]
    for j in range(count):
        raised = p[j] * (p[j] * uu[j] + 2 * q[j] * uv[j]) + q[j] * q[j] * vv[j]
        a[j] = rises[j] * vv[j] - falls[j] * raised
    for j in range(count):
        raised = (
            p[j] * q[j] * uu[j] + (q[j] * q[j] + p[j] * r[j]) * uv[j] + q[j] * r[j] * vv[j]
        )
        b[j] = -2 * rises[j] * uv[j] - 2 * falls[j] * raised
    for j in range(count):
        raised = q[j] * q[j] * uu[j] + r[j] * (2 * q[j] * uv[j] + r[j] * vv[j])
        c[j] = rises[j] * uu[j] - falls[j] * raised
    # what was there is not needed any more
    q00 = rows[7]
    q02 = size
    q11 = twofold
    q22 = rows[8]
    for j in range(count):
        q00[j] = one[j] * p[j] * p[j] + two[j] * a[j] * a[j]
    for j in range(count):
        q01[j] = one[j] * 2 * p[j] * q[j] + two[j] * a[j] * b[j]
    for j in range(count):
        q02[j] = one[j] * q[j] * q[j] + two[j] * a[j] * c[j]
    for j in range(count):
        q11[j] = one[j] * 2 * (p[j] * r[j] + q[j] * q[j]) + two[j] * b[j] * b[j]
    for j in range(count):
        q12[j] = one[j] * 2 * q[j] * r[j] + two[j] * b[j] * c[j]
    for j in range(count):
        q22[j] = one[j] * r[j] * r[j] + two[j] * c[j] * c[j]
    for j in range(count):
        a[j] = known[0, j] * (q00[j] * uu[j] + q01[j] * uv[j] + q02[j] * vv[j])
    for j in range(count):
        b[j] = known[1, j] * (q01[j] * uu[j] + q11[j] * uv[j] + q12[j] * vv[j])
    for j in range(count):
        c[j] = known[2, j] * (q02[j] * uu[j] + q12[j] * uv[j] + q22[j] * vv[j])
    for k, row in enumerate((a, b, c)):
        copy_row(row, form[k])
    for k, row in enumerate((q00, q01, q02, q11, q12, q22)):
        copy_row(row, smoothness[k, i, PAD:])


@kernel
def stencils_row(link: ByteArray, shares: FloatArray, i: int, t: FloatArray) -> None:
    """Weights (3, 9, ...) of the nine pixels for uu, uv and vv, on a row; 0 where one is not known."""
    count = t.shape[2]
    next_to = link[0, i]
    below = link[1, i]
    above = link[1, i - 1]
    known = np.empty((3, count))
    squares = np.empty((4, count))
    _know_row(link, i, known)
    _squares_row(link, i, squares)
    t[:3] = 0.0
    for j in range(count):
        t[0, 0, j] = -2 * known[0, j]
        t[0, 1, j] = known[0, j]
        t[0, 2, j] = known[0, j]
        t[2, 0, j] = -2 * known[2, j]
        t[2, 3, j] = known[2, j]
        t[2, 4, j] = known[2, j]
    for j in range(count):
        lower_right = squares[0, j]
        lower_left = squares[1, j]
        upper_right = squares[2, j]
        upper_left = squares[3, j]
        t[1, 0, j] = (lower_right + upper_left) - (lower_left + upper_right)
        t[1, 1, j] = upper_right - lower_right
        t[1, 2, j] = lower_left - upper_left
        t[1, 3, j] = lower_left - lower_right
        t[1, 4, j] = upper_right - upper_left
        t[1, 5, j] = lower_right
        t[1, 6, j] = -lower_left
        t[1, 7, j] = -upper_right
        t[1, 8, j] = upper_left
    for k in range(3):
        for j in range(count):
            right = float(next_to[j + 2])
            left = float(next_to[j + 1])
            part = shares[k, 0, i, PAD + j]
            t[k, 0, j] -= part * (left - right) + shares[k, 2, i, PAD + j]
            t[k, 1, j] -= part * right
            t[k, 2, j] += part * left
        for j in range(count):
            south = float(below[j + 2])
            north = float(above[j + 2])
            part = shares[k, 1, i, PAD + j]
            t[k, 0, j] -= part * (north - south)
            t[k, 3, j] -= part * south
            t[k, 4, j] += part * north
