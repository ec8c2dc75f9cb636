"""How a surface bends: second differences of 1/d that are 0 on every plane, and what their size costs.

With w = 1/d and r the unit ray of a pixel, a plane n·x = h has w = n·r/h, linear in the ray. So where the
second differences of the rays are a r_u + b r_v + c r, those of w, less a w_u + b w_v + c w, vanish on
every plane, in every camera. These three are the surface's second fundamental form, but for a factor:
with κ₁, κ₂ the eigenvalues of this form against the metric G, both are 0 on a plane and one is 0 on every
surface that a sheet can be rolled into, a tube, a cone, straight, tilted or off centre. Charged are

    size κ = (κ₁² + κ₂²)^½,    twofold = κ₁ κ₂ / (κ² + SLIGHT²)^½,

the second by `TWOFOLD` times more: a wall bends one way at little cost. Neither needs an eigenvector,
and both are smooth but where nothing bends. κ is per (1/160 rad)², which is a pixel's square in the
middle of a picture 320 px and 90° wide, and of d over its median, as ξ/ξ̃ is.
"""

import numpy as np

from endolab.model.cameras import RayField
from endolab.numerics.arrays import BoolArray, FloatArray, IntArray
from endolab.numerics.derivatives import gradient, hessian, hessian_stencils, links, shift

# What bending both ways costs, beside all bending. Tubes are 0.5 % off with 10, 0.9 % with 4, 3 % with 0; the
# more, the less smooth is along a tube what is smooth across.
TWOFOLD = 4.0
ANGLE = 1 / 160  # rad, the unit of curvatures
CREASE = 3.0  # times ε: where a curvature is charged its size, not its square; walls bend by less
# κ below which bending both ways hardly counts. To prefer one way is not convex: a ball, which bends by 2e-5
# at twice its distance from the middle, would crumple into facets. Tubes bend by 1e-4 and more.
SLIGHT = 5e-5


def _derivatives(
    f: FloatArray, mask: BoolArray, cuts: BoolArray | None
) -> tuple[FloatArray, FloatArray]:
    """First (2, H, W) and second differences (3, H, W) of a map: u, v; uu, uv, vv."""
    first = np.stack(gradient(f, mask, cuts, edge_order=1))
    uu, vv, *mixed = hessian(f, mask, cuts)
    uv = np.sqrt(2) * np.sum(mixed, axis=0) / np.maximum(_squares(links(mask, cuts)), 1)
    return np.nan_to_num(first), np.stack([uu, uv, vv])


def _squares(link: BoolArray) -> IntArray:
    """How many squares of four joined pixels a pixel is in, (H, W)."""
    pairs = hessian_stencils(link)[1].astype(np.int64)
    pairs = pairs + shift(pairs, -1, 1, 0)
    return np.asarray(pairs + shift(pairs, -1, 0, 0))


def valid_stencil(mask: BoolArray, cuts: BoolArray | None = None) -> BoolArray:
    """Where a second difference is known, (3, H, W): all its steps are there, and one on the other axis.

    The mixed one is the mean of those of the squares around the pixel, one at least.
    """
    link = links(mask, cuts)
    beside_u, beside_v = (
        link[i] | shift(link[i], -1, axis, False) for i, axis in ((0, 1), (1, 0))
    )
    uu, _, vv = hessian_stencils(link)
    return np.stack([uu & beside_v, _squares(link) > 0, vv & beside_u])


def plane_shares(
    field: RayField, mask: BoolArray, cuts: BoolArray | None = None
) -> FloatArray:
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


def second_form(
    w: FloatArray, field: RayField, mask: BoolArray, cuts: BoolArray | None = None
) -> FloatArray:
    """Second differences uu, uv, vv of w = 1/d that are 0 on planes, (3, H, W), and where not known."""
    w = np.where(mask, w, 0.0)
    first, second = _derivatives(w, mask, cuts)
    a, b, c = np.moveaxis(plane_shares(field, mask, cuts), 1, 0)
    return np.where(
        valid_stencil(mask, cuts), second - a * first[0] - b * first[1] - c * w, 0.0
    )


def size_and_twofold(
    form: FloatArray, inverse_metric: FloatArray, known: BoolArray
) -> FloatArray:
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
