"""Adjoints of the derivatives on a masked grid: (n, H, W) to (H, W), 0 outside the mask; and cuts."""

import numpy as np

from endolab.numerics.derivatives import hessian_stencils, links, shift


def _links(shape, mask, cuts):
    return links(np.ones(shape, dtype=bool) if mask is None else mask, cuts)


def between(labels):
    """Cuts wherever the labels of neighbours differ."""
    cuts = np.zeros((2, *labels.shape), dtype=bool)
    cuts[0, :, :-1] = labels[:, 1:] != labels[:, :-1]
    cuts[1, :-1] = labels[1:] != labels[:-1]
    return cuts


def gradient_adjoint(both, mask=None, cuts=None):
    """Of `gradient` with ``edge_order=1``."""
    out = np.zeros(both[0].shape)
    for p, joined, axis in zip(
        both, _links(out.shape, mask, cuts), (1, 0), strict=True
    ):
        before = shift(joined, -1, axis, False)
        # The derivative is the mean of the differences that there are: each has its share of p.
        share = np.where(joined | before, p, 0.0) / np.maximum(
            1.0 * joined + before, 1.0
        )
        step = joined * (share + shift(share, 1, axis, 0.0))
        out += shift(step, -1, axis, 0.0) - step
    return out


def forward_gradient_adjoint(p, mask=None, cuts=None):
    """Of `forward_gradient`, minus the divergence."""
    steps = np.where(_links(p[0].shape, mask, cuts), p, 0.0)
    return sum(
        shift(steps[i], -1, axis, 0.0) - steps[i] for i, axis in ((0, 1), (1, 0))
    )


def differences_adjoint(p, mask=None, cuts=None):
    """Of `differences`."""
    behind = [shift(q, 1, axis, 0.0) for q, axis in zip(p[2:], (1, 0), strict=True)]
    return forward_gradient_adjoint((p[:2] + np.stack(behind)) / np.sqrt(2), mask, cuts)


def hessian_adjoint(p, mask=None, cuts=None):
    """Of `hessian`."""
    below = p[2:4] + np.stack([shift(q, 1, 0, 0.0) for q in p[4:]])
    mixed = below[0] + shift(below[1], 1, 1, 0.0)
    return second_differences_adjoint((p[0], mixed / np.sqrt(2), p[1]), mask, cuts)


def second_differences_adjoint(p, mask=None, cuts=None):
    """Of f_uu, f_uv and f_vv, the second of the square to the lower right."""
    stencils = hessian_stencils(_links(p[0].shape, mask, cuts))
    uu, uv, vv = (np.where(whole, q, 0.0) for whole, q in zip(stencils, p, strict=True))
    out = sum(
        shift(q, 1, a, 0.0) - 2 * q + shift(q, -1, a, 0.0)
        for q, a in ((uu, 1), (vv, 0))
    )
    lower = shift(uv, -1, 0, 0.0) - uv
    return out + shift(lower, -1, 1, 0.0) - lower
