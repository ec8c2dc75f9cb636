"""Normals and slants of every n-th pixel of a map, compiled: what is only shown need not be made whole.

Each pixel's value is that of the whole map; `surface.normals` and `surface.slant` are the twins in NumPy.
"""

import numpy as np

from endolab.model.cameras import RayField
from endolab.model.surface import slant
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.compiled import PAD, kernel, pad_maps
from endolab.numerics.derivatives import links


@kernel
def _fill_slopes(
    f: FloatArray, link: BoolArray, step: int, order: int, out: FloatArray
) -> None:
    """Derivatives along the rows of padded maps; see `derivatives.gradient`."""
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            i = row * step + PAD
            j = column * step + PAD
            forward = f[i, j + 1] - f[i, j]
            backward = f[i, j] - f[i, j - 1]
            value = 0.0
            if link[i, j] and link[i, j - 1]:
                value = 0.5 * (forward + backward)
            elif link[i, j]:
                value = forward
                if order == 2 and link[i, j + 1]:
                    value += 0.5 * (forward - (f[i, j + 2] - f[i, j + 1]))
            elif link[i, j - 1]:
                value = backward
                if order == 2 and link[i, j - 2]:
                    value += 0.5 * (backward - (f[i, j - 1] - f[i, j - 2]))
            out[row, column] = value


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


class ThinnedMaps:
    """Normals and slants of every `step`-th pixel, of any number of surfaces seen by one camera in one mask.

    Maps of v = log d, (H, W), in; (h, w, ...) out, nan outside the mask.
    """

    def __init__(
        self, field: RayField, mask: BoolArray, cuts: BoolArray | None, step: int
    ) -> None:
        every = np.s_[::step, ::step]
        facing = field.valid & mask
        self._step = step
        self._seen = mask[every]
        self._facing = facing[every]
        self._links_of_normals = pad_maps(links(facing))
        self._links_of_slant = pad_maps(links(mask, cuts))
        self._field = RayField(
            field.rays[every],
            field.jacobian[every],
            field.inverse_metric[every],
            field.valid[every],
        )

    def normals(self, log_distance: FloatArray) -> FloatArray:
        """Unit normals in the camera frame, (h, w, 3); see `surface.normals`."""
        f_u, f_v = self._slopes(log_distance, self._facing, self._links_of_normals, 2)
        field = self._field
        out = np.empty((*f_u.shape, 3))
        _fill_normals(f_u, f_v, field.rays, field.jacobian, field.inverse_metric, out)
        return out

    def slant(self, log_distance: FloatArray) -> FloatArray:
        """P = tan²θ, (h, w), as the energy sees it; see `surface.slant`."""
        f_u, f_v = self._slopes(log_distance, self._seen, self._links_of_slant, 1)
        return slant(f_u, f_v, self._field)

    def _slopes(
        self, log_distance: FloatArray, inside: BoolArray, link: BoolArray, order: int
    ) -> tuple[FloatArray, FloatArray]:
        """Derivatives along columns and rows; nan outside the mask."""
        f = pad_maps(np.asarray(log_distance, np.float64))
        f_u = np.empty(inside.shape)
        f_v = np.empty(inside.shape)
        _fill_slopes(f, link[0], self._step, order, f_u)
        _fill_slopes(f.T, link[1].T, self._step, order, f_v.T)
        f_u[~inside] = np.nan
        f_v[~inside] = np.nan
        return f_u, f_v
