"""The form of `solvers.curvature` and what it costs in plain NumPy, to read and to test against."""

import numpy as np

from endolab.numerics.derivatives import (
    gradient,
    hessian,
    hessian_stencils,
    links,
    shift,
)
from endolab.solvers.curvature import ANGLE, SLIGHT
from tests.tools.adjoints import gradient_adjoint, hessian_adjoint


def _derivatives(f, mask, cuts):
    """First (2, H, W) and second differences (3, H, W) of a map: u, v; uu, uv, vv."""
    first = np.stack(gradient(f, mask, cuts, edge_order=1))
    uu, vv, *mixed = hessian(f, mask, cuts)
    uv = np.sqrt(2) * np.sum(mixed, axis=0) / np.maximum(_squares(links(mask, cuts)), 1)
    return np.nan_to_num(first), np.stack([uu, uv, vv])


def _squares(link):
    """How many squares of four joined pixels a pixel is in, (H, W)."""
    pairs = hessian_stencils(link)[1].astype(np.int64)
    pairs = pairs + shift(pairs, -1, 1, 0)
    return np.asarray(pairs + shift(pairs, -1, 0, 0))


def valid_stencil(mask, cuts=None):
    """Where a second difference is known, (3, H, W): all its steps are there, and one on the other axis.

    The mixed one is the mean of those of the squares around the pixel, one at least.
    """
    link = links(mask, cuts)
    beside_u, beside_v = (
        link[i] | shift(link[i], -1, axis, False) for i, axis in ((0, 1), (1, 0))
    )
    uu, _, vv = hessian_stencils(link)
    return np.stack([uu & beside_v, _squares(link) > 0, vv & beside_u])


def plane_shares(field, mask, cuts=None):
    """a, b and c of each second difference of the rays, (uu, uv, vv; a, b, c; H, W); 0 where not known."""
    rays = np.where(mask[..., None], field.rays, 0.0)
    pairs = [_derivatives(rays[..., i], mask, cuts) for i in range(3)]
    (ray_u, ray_v), second = (
        np.stack(parts, axis=-1) for parts in zip(*pairs, strict=True)
    )
    known = valid_stencil(mask, cuts)
    basis = np.stack([ray_u, ray_v, rays], axis=-1)
    basis[~known.any(axis=0)] = np.eye(3)
    shares = [np.linalg.solve(basis, parts[..., None])[..., 0] for parts in second]
    return np.moveaxis(np.where(known[..., None], shares, 0.0), -1, 1)


def second_form(w, mask, cuts, field):
    """Second differences uu, uv, vv of w = 1/d that are 0 on planes, (3, H, W), and where not known."""
    w = np.where(mask, w, 0.0)
    first, second = _derivatives(w, mask, cuts)
    a, b, c = np.moveaxis(plane_shares(field, mask, cuts), 1, 0)
    form = second - a * first[0] - b * first[1] - c * w
    return np.where(valid_stencil(mask, cuts), form, 0.0)


def second_form_adjoint(p, mask, cuts, field):
    """Of `second_form`."""
    p = np.where(valid_stencil(mask, cuts), p, 0.0)
    a, b, c = np.einsum("klij,kij->lij", plane_shares(field, mask, cuts), p)
    # The mean of the squares around a pixel.
    mixed = np.sqrt(2) * p[1] / np.maximum(_squares(links(mask, cuts)), 1)
    straight = hessian_adjoint(np.stack([p[0], p[2], *4 * [mixed]]), mask, cuts)
    return straight - gradient_adjoint((a, b), mask, cuts) - c


def size_and_twofold(form, inverse_metric, known):
    """What is charged, (2, H, W); the second is 0 where not all of the form is known."""
    uu, uv, vv = form * ANGLE**2
    guu, guv, gvv = np.moveaxis(inverse_metric, -1, 0)
    mixed = [
        [uu * guu + uv * guv, uu * guv + uv * gvv],
        [uv * guu + vv * guv, uv * guv + vv * gvv],
    ]
    size = np.sqrt(mixed[0][0] ** 2 + 2 * mixed[0][1] * mixed[1][0] + mixed[1][1] ** 2)
    product = (uu * vv - uv * uv) * (guu * gvv - guv * guv)
    return np.stack(
        [size, np.where(known.all(axis=0), product / np.hypot(size, SLIGHT), 0.0)]
    )
