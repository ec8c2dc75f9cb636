"""Adjoints of the derivatives on a masked grid: (n, H, W) to (H, W), 0 outside the mask; and cuts."""

import numpy as np

from endolab.numerics.derivatives import hessian_stencils, links, shifted


def _links(shape, mask, discontinuities):
    return links(np.ones(shape, dtype=bool) if mask is None else mask, discontinuities)


def between(labels):
    """Cuts wherever the labels of neighbours differ."""
    discontinuities = np.zeros((2, *labels.shape), dtype=bool)
    discontinuities[0, :, :-1] = labels[:, 1:] != labels[:, :-1]
    discontinuities[1, :-1] = labels[1:] != labels[:-1]
    return discontinuities


def gradient_adjoint(both, mask=None, discontinuities=None):
    """Of `gradient` with ``edge_order=1``."""
    out = np.zeros(both[0].shape)
    for p, joined, axis in zip(both, _links(out.shape, mask, discontinuities), (1, 0), strict=True):
        before = shifted(joined, -1, axis, False)
        # The derivative is the mean of the differences that there are: each has its share of p.
        share = np.where(joined | before, p, 0.0) / np.maximum(1.0 * joined + before, 1.0)
        step = joined * (share + shifted(share, 1, axis, 0.0))
        out += shifted(step, -1, axis, 0.0) - step
    return out


def forward_gradient_adjoint(p, mask=None, discontinuities=None):
    """Of `forward_gradient`, minus the divergence."""
    steps = np.where(_links(p[0].shape, mask, discontinuities), p, 0.0)
    return sum(shifted(steps[i], -1, axis, 0.0) - steps[i] for i, axis in ((0, 1), (1, 0)))


def differences_adjoint(p, mask=None, discontinuities=None):
    """Of `differences`."""
    behind = [shifted(q, 1, axis, 0.0) for q, axis in zip(p[2:], (1, 0), strict=True)]
    return forward_gradient_adjoint((p[:2] + np.stack(behind)) / np.sqrt(2), mask, discontinuities)


def hessian_adjoint(p, mask=None, discontinuities=None):
    """Of `hessian`."""
    below = p[2:4] + np.stack([shifted(q, 1, 0, 0.0) for q in p[4:]])
    mixed = below[0] + shifted(below[1], 1, 1, 0.0)
    return second_differences_adjoint((p[0], mixed / np.sqrt(2), p[1]), mask, discontinuities)


def second_differences_adjoint(p, mask=None, discontinuities=None):
    """Of f_uu, f_uv and f_vv, the second of the square to the lower right."""
    stencils = hessian_stencils(_links(p[0].shape, mask, discontinuities))
    uu, uv, vv = (np.where(whole, q, 0.0) for whole, q in zip(stencils, p, strict=True))
    out = sum(shifted(q, 1, a, 0.0) - 2 * q + shifted(q, -1, a, 0.0) for q, a in ((uu, 1), (vv, 0)))
    lower = shifted(uv, -1, 0, 0.0) - uv
    return out + shifted(lower, -1, 1, 0.0) - lower


def second_form_adjoint(p, shares, known, mask=None, discontinuities=None):
    """Of `second_form`, whose `plane_shares` and `whole` are given."""
    p = np.where(known, p, 0.0)
    a, b, c = np.einsum("klij,kij->lij", shares, p)
    squares = hessian_stencils(_links(p[0].shape, mask, discontinuities))[1].astype(float)
    for axis in (1, 0):
        squares = squares + shifted(squares, -1, axis, 0.0)
    mixed = np.sqrt(2) * p[1] / np.maximum(squares, 1)  # the mean of the squares around a pixel
    straight = hessian_adjoint(np.stack([p[0], p[2], *4 * [mixed]]), mask, discontinuities)
    return straight - gradient_adjoint((a, b), mask, discontinuities) - c
