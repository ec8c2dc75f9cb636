"""Normals and slants of every n-th pixel of a map, compiled: what is only shown need not be made whole.

Each pixel's value is that of the whole map; `surface.normals` and `surface.slant` are the twins in NumPy.
"""

import numpy as np

from endolab.model.cameras import RayField
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.compiled import PAD, kernel, pad_maps
from endolab.numerics.derivatives import links


@kernel
def _derivative(
    f: tuple[float, float, float, float, float],
    link: tuple[bool, bool, bool, bool],
    order: int,
) -> float:
    """See `derivatives.gradient`, from five values in a row and the four links between them."""
    forward = f[3] - f[2]
    backward = f[2] - f[1]
    if link[1] and link[2]:
        return 0.5 * (forward + backward)
    if link[2]:
        return (
            forward + 0.5 * (forward - (f[4] - f[3])) if order == 2 and link[3] else forward
        )
    if link[1]:
        return (
            backward + 0.5 * (backward - (f[1] - f[0]))
            if order == 2 and link[0]
            else backward
        )
    return 0.0


@kernel
def _fill_slopes(
    f: FloatArray,
    right: BoolArray,
    below: BoolArray,
    step: int,
    order: int,
    f_u: FloatArray,
    f_v: FloatArray,
) -> None:
    for row in range(f_u.shape[0]):
        for column in range(f_u.shape[1]):
            i = row * step + PAD
            j = column * step + PAD
            values = f[i, j - 2], f[i, j - 1], f[i, j], f[i, j + 1], f[i, j + 2]
            joined = right[i, j - 2], right[i, j - 1], right[i, j], right[i, j + 1]
            f_u[row, column] = _derivative(values, joined, order)
            values = f[i - 2, j], f[i - 1, j], f[i, j], f[i + 1, j], f[i + 2, j]
            joined = below[i - 2, j], below[i - 1, j], below[i, j], below[i + 1, j]
            f_v[row, column] = _derivative(values, joined, order)


@kernel
def _fill_normals(
    f_u: FloatArray,
    f_v: FloatArray,
    rays: FloatArray,
    jacobian: FloatArray,
    metric: FloatArray,
    out: FloatArray,
) -> None:
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            guu = metric[i, j, 0]
            guv = metric[i, j, 1]
            gvv = metric[i, j, 2]
            u = f_u[i, j]
            v = f_v[i, j]
            raised_u = guu * u + guv * v
            raised_v = guv * u + gvv * v
            length = np.sqrt(1 + (guu * u * u + 2 * guv * u * v + gvv * v * v))
            for k in range(3):
                tangent = raised_u * jacobian[i, j, k, 0] + raised_v * jacobian[i, j, k, 1]
                out[i, j, k] = (tangent - rays[i, j, k]) / length


@kernel
def _fill_slant(
    f_u: FloatArray, f_v: FloatArray, metric: FloatArray, out: FloatArray
) -> None:
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            u = f_u[i, j]
            v = f_v[i, j]
            out[i, j] = (
                metric[i, j, 0] * u * u
                + 2 * metric[i, j, 1] * u * v
                + metric[i, j, 2] * v * v
            )


class ThinnedMaps:
    """Normals and slants of every `step`-th pixel, of any number of surfaces seen by one camera in one mask.

    Maps of v = log d, (H, W), in; (h, w, ...) out, nan outside the mask.
    """

    def __init__(
        self, field: RayField, mask: BoolArray, cuts: BoolArray | None, step: int
    ) -> None:
        self._field = field
        self._step = step
        self._every = np.s_[::step, ::step]
        self._facing = field.valid & mask
        self._slanted = mask
        self._links_of_normals = pad_maps(links(self._facing, None))
        self._links_of_slant = pad_maps(links(mask, cuts))

    def normals(self, log_distance: FloatArray) -> FloatArray:
        """Unit normals in the camera frame, (h, w, 3); see `surface.normals`."""
        f_u, f_v = self._slopes(log_distance, self._facing, self._links_of_normals, 2)
        field = self._field
        every = self._every
        out = np.empty((*f_u.shape, 3))
        _fill_normals(
            f_u,
            f_v,
            field.rays[every],
            field.jacobian[every],
            field.inverse_metric[every],
            out,
        )
        return out

    def slant(self, log_distance: FloatArray) -> FloatArray:
        """P = tan²θ, (h, w), as the energy sees it; see `surface.slant`."""
        f_u, f_v = self._slopes(log_distance, self._slanted, self._links_of_slant, 1)
        out = np.empty(f_u.shape)
        _fill_slant(f_u, f_v, self._field.inverse_metric[self._every], out)
        return out

    def _slopes(
        self,
        log_distance: FloatArray,
        inside: BoolArray,
        joined: BoolArray,
        edge_order: int,
    ) -> tuple[FloatArray, FloatArray]:
        """Derivatives along columns and rows; nan outside the mask."""
        seen, (right, below) = inside[self._every], joined
        f_u = np.empty(seen.shape)
        f_v = np.empty(seen.shape)
        whole = pad_maps(np.asarray(log_distance, np.float64))
        _fill_slopes(whole, right, below, self._step, edge_order, f_u, f_v)
        f_u[~seen] = f_v[~seen] = np.nan
        return f_u, f_v


def thin_normals(
    log_distance: FloatArray, field: RayField, mask: BoolArray, step: int
) -> FloatArray:
    """Unit normals of every `step`-th pixel of one surface, (h, w, 3); see `ThinnedMaps.normals`."""
    return ThinnedMaps(field, mask, None, step).normals(log_distance)
