"""How well a calibration knows each ray of the picture, and the light that goes along it.

The covariances of the two fits, of a few numbers each, are brought to the picture by the derivatives of what
these numbers make there: to first order, a change δ of the camera's numbers moves the pixel of a ray by B δ,
and the ray of a pixel by -J B δ, J being the ray's derivative by the pixel.

A turn that all rays share is told apart. A camera calibrated anew has its axis elsewhere by some of that
turn, its targets turn along with it, and no surface changes its shape by it. It is the turn after which the
pixels move least: rays near the end of a lens's range, which move wildly, have little say.
"""

import numpy as np

from endolab.calibration.geometric.projection import Lens, camera_vector, to_pixels
from endolab.calibration.photometric.result import PhotometricFit
from endolab.model.cameras import Camera
from endolab.numerics.arrays import FloatArray


def places(camera: Camera, columns: int = 120) -> FloatArray:
    """Return the places of a map over a camera's picture: (h, w, 2), column and row, px, evenly spaced.

    A map is smooth, so that few `columns` will do.
    """
    columns = min(columns, camera.width)
    rows = max(1, round(camera.height * columns / camera.width))
    row, column = np.indices((rows, columns)) + 0.5
    scale = camera.width / columns, camera.height / rows
    return np.stack([column, row], axis=-1) * scale - 0.5


def values_within(values: FloatArray, camera: Camera, angle: float) -> FloatArray:
    """Return the finite values of a map at `places` that lie within an angle off the axis, rad: (n,)."""
    cosine = camera.unproject(places(camera))[..., 2]
    return values[np.isfinite(values) & (cosine >= np.cos(angle))]


def ray_uncertainty(
    camera: Lens,
    covariance: FloatArray,
    pixels: FloatArray | None = None,
    max_angle: float = np.pi,
) -> FloatArray:
    """Bring the covariance of a camera's numbers to the rays of its picture, without a turn that all share.

    Parameters
    ----------
    camera : KannalaBrandt or BrownConrady
    covariance : (8, 8) or (12, 12) float array
        As in `GeometricFit`: of fx, fy, cx, cy (px) and k; inf on the diagonal of what is not told.
    pixels : (h, w, 2) float array, optional
        Where, column and row, px, all over the picture; `places` by default.
    max_angle : float
        Off the axis, rad, up to which rays tell the turn that all share: beyond what the views have seen
        they may be wild.

    Returns
    -------
    (h, w) float array
        Root mean square of how far the ray of a pixel is off, mrad; nan where there is no ray, inf where it
        hangs on a number of the camera that the views do not tell.
    """
    pixels = places(camera) if pixels is None else pixels
    lost = ~np.isfinite(np.diag(covariance))
    finite = np.where(lost | lost[:, None], 0.0, covariance)
    picture_rays = camera.unproject(pixels)
    seen = np.isfinite(picture_rays).all(axis=-1)
    rays = picture_rays[seen]
    _, by_camera, by_ray = to_pixels(camera_vector(camera), rays)
    # The turn ω that leaves least of the pixels: Σ |B δ - P (ω × r)|².
    inside = rays[:, 2] >= np.cos(max_angle)
    by_turn = np.cross(by_ray, -rays[:, None], axis=-1)
    design = by_turn[inside].reshape(-1, 3)
    turn = np.linalg.lstsq(design, by_camera[inside].reshape(len(design), -1))[0]
    # A pixel moves by no change of a ray's length, so that the least change that undoes it is a turn.
    slopes = np.linalg.pinv(by_ray) @ (by_camera - by_turn @ turn)
    square = np.einsum("nip,pq,niq->n", slopes, finite, slopes)
    untold = (slopes[..., lost] != 0).any(axis=(1, 2))
    mrad = np.full(seen.shape, np.nan)
    mrad[seen] = np.where(untold, np.inf, 1e3 * np.sqrt(np.maximum(square, 0.0)))
    return mrad


def fall_off_uncertainty(light: PhotometricFit, camera: Camera) -> FloatArray:
    """Return how well the light's fall-off μ′ is known at `places`: its standard error, %, (h, w).

    It is that of the light along a ray over the light on the axis, as the gain takes what all rays share:
    ln cos α times that of k. nan where no light can come from.
    """
    cosine = camera.unproject(places(camera))[..., 2]
    logarithm = np.log(np.where(cosine > 0, cosine, np.nan))
    return 100 * np.abs(logarithm) * np.sqrt(light.covariance[0, 0])
