"""The matrix of a Gauss-Newton step, and the same on half the pixels.

It couples a pixel to the twelve that the squared central differences and the squared Hessian
reach, two steps along rows and columns, one along diagonals, and to four that are a knight's move
away, where a form of all second differences is squared. It is symmetric, so nine numbers a pixel
hold it. The same matrix, readably: tests/depth/gauss_newton_model.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from endolab.depth.curvature_kernels import COLUMNS, ROWS, form_stencils
from endolab.depth.problem import CURVATURE, FIRST, SECOND
from endolab.depth.tears import coarser_links, held, main_parts
from endolab.numerics.arrays import FloatArray
from endolab.numerics.compiled import PAD, block_sums, halved, inner, kernel

CENTRE, E, EE, S, SS, SE, SW, SEE, SSE = range(9)  # a pixel's own entry and those towards later pixels
# Of each pair of the six pixels of `curvature_kernels`, the entry, and which of the two holds it: that above
# or, in a row, that on the left.
PAIRS = np.array(
    [
        *((k, k, CENTRE) for k in range(6)),
        *((0, 1, E), (2, 0, E), (3, 5, E), (2, 1, EE), (4, 3, SS)),
        *((0, 3, S), (4, 0, S), (1, 5, S), (0, 5, SE), (4, 1, SE), (2, 3, SE)),
        *((1, 3, SW), (4, 2, SW), (2, 5, SEE), (4, 5, SSE)),
    ]
)


@kernel
def assemble(
    by_v: FloatArray,
    by_v_u: FloatArray,
    by_v_v: FloatArray,
    weight: FloatArray,
    slope: FloatArray,
    smoothness: FloatArray,
    caution: FloatArray,
    link: Any,
    rays: FloatArray,
    kind: int,
    m: Any,
) -> None:
    """Write the normal equations Jᵀ W J + X Dᵀ Q D X into m; all arrays padded.

    A pixel's row of J is a + b·∇ with the mean of the differences that `link` allows, D is the
    forward gradient, the Hessian or the form of `curvature`, X the slope of ξ. Squared differences of the
    step itself come in with the weights `caution`.
    """
    m[:] = 0.0
    t, y, qt = np.empty((3, 6)), np.empty(6), np.empty((3, 6))
    root2 = np.sqrt(2.0)
    for i in range(PAD, by_v.shape[0] - PAD):
        for j in range(PAD, by_v.shape[1] - PAD):
            right, left = link[0, i, j], link[0, i, j - 1]
            below, above = link[1, i, j], link[1, i - 1, j]
            w = weight[i, j]
            if w > 0:
                u = by_v_u[i, j] / max(right + left, 1)
                v = by_v_v[i, j] / max(below + above, 1)
                c = by_v[i, j] + u * (left - right) + v * (above - below)
                e, we, s, n = u * right, -u * left, v * below, -v * above
                m[CENTRE, i, j] += w * c * c
                m[CENTRE, i, j + 1] += w * e * e
                m[CENTRE, i, j - 1] += w * we * we
                m[CENTRE, i + 1, j] += w * s * s
                m[CENTRE, i - 1, j] += w * n * n
                m[E, i, j] += w * c * e
                m[E, i, j - 1] += w * c * we
                m[EE, i, j - 1] += w * e * we
                m[S, i, j] += w * c * s
                m[S, i - 1, j] += w * c * n
                m[SS, i - 1, j] += w * s * n
                m[SE, i - 1, j] += w * n * e
                m[SW, i - 1, j] += w * n * we
                m[SE, i, j - 1] += w * we * s
                m[SW, i, j + 1] += w * e * s
            if right and caution[0, i, j] > 0:
                m[CENTRE, i, j] += caution[0, i, j]
                m[CENTRE, i, j + 1] += caution[0, i, j]
                m[E, i, j] -= caution[0, i, j]
            if below and caution[1, i, j] > 0:
                m[CENTRE, i, j] += caution[1, i, j]
                m[CENTRE, i + 1, j] += caution[1, i, j]
                m[S, i, j] -= caution[1, i, j]
            q = smoothness[0, i, j]
            if kind == CURVATURE and q > 0:
                form_stencils(rays, link, i, j, t)
                for k in range(6):
                    y[k] = slope[i + ROWS[k], j + COLUMNS[k]]
                    a, b, c = t[0, k] * y[k], t[1, k] * y[k], t[2, k] * y[k]
                    t[0, k], t[1, k], t[2, k] = a, b, c
                    qt[0, k] = q * a + smoothness[1, i, j] * b + smoothness[2, i, j] * c
                    qt[1, k] = smoothness[1, i, j] * a + smoothness[3, i, j] * b + smoothness[4, i, j] * c
                    qt[2, k] = smoothness[2, i, j] * a + smoothness[4, i, j] * b + smoothness[5, i, j] * c
                for n in range(PAIRS.shape[0]):
                    k, other, entry = PAIRS[n]
                    product = t[0, k] * qt[0, other] + t[1, k] * qt[1, other] + t[2, k] * qt[2, other]
                    m[entry, i + ROWS[k], j + COLUMNS[k]] += product
            elif q > 0:
                x = slope[i, j]
                if kind == SECOND:
                    if right and left:
                        e, we, c = slope[i, j + 1], slope[i, j - 1], -2 * x
                        m[CENTRE, i, j] += q * c * c
                        m[CENTRE, i, j + 1] += q * e * e
                        m[CENTRE, i, j - 1] += q * we * we
                        m[E, i, j] += q * c * e
                        m[E, i, j - 1] += q * c * we
                        m[EE, i, j - 1] += q * e * we
                    if below and above:
                        s, n, c = slope[i + 1, j], slope[i - 1, j], -2 * x
                        m[CENTRE, i, j] += q * c * c
                        m[CENTRE, i + 1, j] += q * s * s
                        m[CENTRE, i - 1, j] += q * n * n
                        m[S, i, j] += q * c * s
                        m[S, i - 1, j] += q * c * n
                        m[SS, i - 1, j] += q * s * n
                    if right and below and link[0, i + 1, j] and link[1, i, j + 1]:
                        c, e = root2 * x, -root2 * slope[i, j + 1]
                        s, d = -root2 * slope[i + 1, j], root2 * slope[i + 1, j + 1]
                        m[CENTRE, i, j] += q * c * c
                        m[CENTRE, i, j + 1] += q * e * e
                        m[CENTRE, i + 1, j] += q * s * s
                        m[CENTRE, i + 1, j + 1] += q * d * d
                        m[E, i, j] += q * c * e
                        m[S, i, j] += q * c * s
                        m[SE, i, j] += q * c * d
                        m[SW, i, j + 1] += q * e * s
                        m[S, i, j + 1] += q * e * d
                        m[E, i + 1, j] += q * s * d
                else:
                    if right:
                        e = slope[i, j + 1]
                        m[CENTRE, i, j] += q * x * x
                        m[CENTRE, i, j + 1] += q * e * e
                        m[E, i, j] -= q * x * e
                    if below:
                        s = slope[i + 1, j]
                        m[CENTRE, i, j] += q * x * x
                        m[CENTRE, i + 1, j] += q * s * s
                        m[S, i, j] -= q * x * s


@dataclass(frozen=True)
class Coefficients:
    """What the normal equations are made of; padded arrays, see `assemble`."""

    by_v: FloatArray
    by_v_u: FloatArray
    by_v_v: FloatArray
    weight: FloatArray
    slope: FloatArray
    smoothness: FloatArray
    caution: (
        FloatArray  # (2, ...), of squared differences of the step itself to the right and below: see `Grid`
    )
    link: Any
    whole: Any  # the links that there would be without cuts: the same array where nothing is torn
    active: Any
    rays: FloatArray  # see `grid.Grid`
    kind: int  # which of `problem.REGULARISERS`

    @property
    def pixels(self) -> int:
        """Rows times columns, without the padding."""
        return inner(self.by_v).size

    def matrix(self, damping: float, out: FloatArray | None = None) -> FloatArray:
        """Matrix of the normal equations; a share `damping` of a² W is added to its diagonal."""
        m = np.empty((9, *self.by_v.shape)) if out is None else out
        first = (self.by_v, self.by_v_u, self.by_v_v, self.weight)
        assemble(*first, self.slope, self.smoothness, self.caution, self.link, self.rays, self.kind, m)
        m[CENTRE] += damping * self.weight * self.by_v**2
        return m

    @cached_property
    def main(self) -> Any:
        """Pixels for which the coarser grid's blocks stand, see `tears`; all, where nothing is torn."""
        return main_parts(self.active, self.link, self.whole)

    def coarser(self) -> Coefficients:
        """The same on half the pixels: a derivative per coarse pixel is twice one per fine pixel."""
        kept = 1 if self.link is self.whole else self.main
        weight, slope = self.weight * kept, self.slope * kept
        count = np.maximum(block_sums(weight > 0), 1)  # of the pixels that data speak for
        known = slope != 0
        inside = np.maximum(block_sums(known), 1)
        share = 1 / (4 if self.kind == FIRST else 16)
        link, whole = coarser_links(self.main, self.link, self.whole)
        active = halved(self.main)
        return Coefficients(
            by_v=block_sums(self.by_v * kept) / count,
            by_v_u=block_sums(self.by_v_u * kept) / (2 * count),
            by_v_v=block_sums(self.by_v_v * kept) / (2 * count),
            weight=block_sums(weight),
            slope=block_sums(slope) / inside,
            smoothness=np.stack([block_sums(one * kept) for one in self.smoothness]) * share,
            caution=np.stack([block_sums(one * kept) for one in self.caution]) / 4,
            link=link,
            whole=whole,
            active=active if link is whole else active & held(link, self.kind != FIRST),
            rays=np.stack([block_sums(one * known) / inside for one in self.rays])
            if self.rays.size
            else self.rays,
            kind=self.kind,
        )
