"""Cameras: points to pixels, pixels to unit rays, and the ray field that the solvers use.

All models map the angle ϑ off the axis to a radius h on a plane and that plane to the picture, so
one class does the work: a model supplies h(ϑ) and ϑ(h), where they are not a pinhole's, and the map of
the plane, where it is not affine.

Frame: x right, y down, z forward. Pixel coordinates are (column, row), the origin at the
centre of the top-left pixel.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike
from pydantic import AfterValidator, Field

from endolab.numerics.arrays import BoolArray, ComplexArray, FloatArray, nan_if_undefined
from endolab.numerics.checked_types import Whole, checked
from endolab.numerics.roots import invert_increasing, smallest_positive_root
from endolab.numerics.side_by_side import by_rows

Size = Annotated[Whole, Field(ge=1, le=100_000)]  # px
FocalLength = Annotated[float, Field(ge=1e-2, le=1e7)]  # px
Centre = Annotated[float, Field(ge=-1e6, le=1e6)]  # px
Coefficient = Annotated[float, Field(ge=-1e4, le=1e4)]  # of a distortion
Degree = Annotated[float, Field(ge=-1e7, le=1e7)]  # of a polynomial in px, its coefficient
Affine = Annotated[float, Field(ge=-1e3, le=1e3)]
WithSlope = tuple[FloatArray, FloatArray]  # a value and its derivative


@dataclass(frozen=True, eq=False)
class RayField:
    """The rays of every pixel of a camera and the metric that they induce on the grid.

    With J = ∂r/∂u the metric is G = JᵀJ. A map of log-distance v with gradient ∇v is a surface
    with tan²θ = ∇vᵀ G⁻¹ ∇v, whatever the camera.
    """

    rays: FloatArray  # (H, W, 3), unit rays r in the camera frame; nan outside the field
    jacobian: FloatArray  # (H, W, 3, 2), ∂r/∂(column, row), per pixel
    inverse_metric: (
        FloatArray  # (H, W, 3), the entries (uu, uv, vv) of G⁻¹, in pixels squared
    )
    valid: BoolArray  # (H, W), pixels that see something: inside the monotone range of the model

    @property
    def cos_alpha(self) -> FloatArray:
        """Cosine of the angle α between each ray and the axis: the rays' z."""
        return self.rays[..., 2]

    def every(self, step: int) -> Self:
        """Return the field of every `step`-th row and column."""
        maps = {name: values[::step, ::step] for name, values in vars(self).items()}
        return type(self)(**maps)


@checked
class Camera:
    """A central camera that is symmetric about its axis up to a smooth map of the image.

    Use a model: `KannalaBrandt`, `Pinhole`, `BrownConrady` or `Scaramuzza`.
    """

    model: str = field(kw_only=True, repr=False)
    width: Size
    height: Size

    # Parameters that scale with the columns (0) or rows (1).
    _in_pixels: ClassVar[dict[str, int]]

    @property
    def _affine(self) -> tuple[FloatArray, FloatArray]:
        """Return the 2×2 map from the model's plane to pixels, and the centre, px."""
        raise NotImplementedError

    @property
    def _max_radius(self) -> float:
        """The largest radius h that the model maps one to one."""
        return 1e15  # below 90°

    @property
    def max_angle(self) -> float:
        """The largest angle off the axis that the model maps one to one, rad."""
        return float(self._angle(np.asarray(self._max_radius))[0])

    def _radius(self, theta: FloatArray) -> FloatArray:
        """Return h(ϑ) for angles within the range."""
        return np.tan(theta)

    def _angle(self, radius: FloatArray) -> WithSlope:
        """Return ϑ(h) and dϑ/dh for radii within the range."""
        return np.arctan(radius), 1 / (1 + radius * radius)

    def _to_pixels(self, plane: FloatArray) -> FloatArray:
        """Bring points of the model's plane (..., 2) within its range to the picture, px."""
        matrix, centre = self._affine
        return plane @ matrix.T + centre

    def _to_plane(self, pixels: FloatArray) -> WithSlope:
        """Bring pixels (..., 2) to the model's plane, nan if it has none; the derivative, (..., 2, 2)."""
        matrix, centre = self._affine
        to_plane = np.asarray(np.linalg.inv(matrix), float)
        return (pixels - centre) @ to_plane.T, to_plane

    def project(self, points: ArrayLike) -> FloatArray:
        """Project points or directions (..., 3) in the camera frame, mm, to columns and rows (..., 2), px.

        nan for points outside the model's range and for the centre; a pixel outside the picture is returned
        as it is.
        """
        points = np.asarray(points, float)
        side = np.hypot(points[..., 0], points[..., 1])
        z = points[..., 2]
        theta = np.arctan2(side, z)
        inside = (theta <= self.max_angle) & ((side > 0) | (z > 0))
        radius = self._radius(np.where(inside, theta, 0.0))
        # h/side → 0·(anything) on the axis, where x and y vanish too.
        ratio = radius / np.where(side > 0, side, 1.0)
        pixels = self._to_pixels(points[..., :2] * ratio[..., None])
        return np.where(inside[..., None], pixels, np.nan)

    def unproject(self, pixels: ArrayLike) -> FloatArray:
        """Unit rays (..., 3) in the camera frame through columns and rows (..., 2), px; nan where none is."""
        return self._rays_at(np.asarray(pixels, float))[0]

    def _rays_at(self, pixels: FloatArray) -> WithSlope:
        """Return the unit rays (…, 3) and their derivatives by the pixel (…, 3, 2)."""
        plane, to_plane = self._to_plane(pixels)
        radius = np.hypot(plane[..., 0], plane[..., 1])
        inside = radius <= self._max_radius
        theta, turn = self._angle(np.where(inside, radius, 0.0))
        theta = np.where(inside, theta, np.nan)
        sin = np.sin(theta)
        cos = np.cos(theta)
        on_axis = radius == 0
        radius = np.where(on_axis, 1.0, radius)
        cphi = plane[..., 0] / radius + on_axis
        sphi = plane[..., 1] / radius
        rays = np.empty((*radius.shape, 3))
        rays[..., 0] = sin * cphi
        rays[..., 1] = sin * sphi
        rays[..., 2] = cos
        # Moving out by dh turns the ray by ϑ'dh; moving sideways by h dφ turns it by sin ϑ dφ.
        out = turn * cos
        side = np.where(on_axis, turn, sin / radius)
        by_plane = np.empty((*radius.shape, 3, 2))
        by_plane[..., 0, 0] = out * cphi**2 + side * sphi**2
        by_plane[..., 0, 1] = by_plane[..., 1, 0] = (out - side) * cphi * sphi
        by_plane[..., 1, 1] = out * sphi**2 + side * cphi**2
        by_plane[..., 2, 0] = -turn * sin * cphi
        by_plane[..., 2, 1] = -turn * sin * sphi
        return rays, by_plane @ to_plane

    @cached_property
    def field(self) -> RayField:
        """The ray field of every pixel, that of an equal camera if it was asked for lately."""
        remember = _few_pixels if self.width * self.height <= 400 * 400 else _one_size
        return remember(self)

    def _find_field(self) -> RayField:
        shape = (self.height, self.width)
        rays = np.empty((*shape, 3))
        jacobian = np.empty((*shape, 3, 2))
        inverse = np.empty((*shape, 3))
        valid = np.empty(shape, dtype=bool)

        def fill(band: slice) -> None:
            rows, columns = np.mgrid[band, : self.width].astype(np.float64)
            rays[band], jacobian[band] = self._rays_at(np.stack([columns, rows], axis=-1))
            by_u = jacobian[band, ..., 0]
            by_v = jacobian[band, ..., 1]
            guu = np.einsum("hwi,hwi->hw", by_u, by_u)
            guv = np.einsum("hwi,hwi->hw", by_u, by_v)
            gvv = np.einsum("hwi,hwi->hw", by_v, by_v)
            determinant = guu * gvv - guv * guv
            inverse[band] = np.stack([gvv, -guv, guu], axis=-1) / determinant[..., None]
            # At the very edge of a model the ray turns infinitely fast: no metric, no surface.
            valid[band] = np.isfinite(determinant)

        by_rows(fill, shape)
        return RayField(rays, jacobian, inverse, valid)

    def resize(self, width: int, height: int) -> Self:
        """Return the camera of the same picture resampled to another size, px; its outer edges stay."""
        if (width, height) == (self.width, self.height):
            return self
        scale = (width / self.width, height / self.height)
        scaled = {
            name: getattr(self, name) * scale[axis]
            for name, axis in self._in_pixels.items()
        }
        scaled["cx"] += 0.5 * scale[0] - 0.5
        scaled["cy"] += 0.5 * scale[1] - 0.5
        return replace(self, width=width, height=height, **scaled)


# Ray fields that outlive their cameras, 97 bytes a pixel: some of few pixels, as light, contours and σ are
# found on, and one of any size, at which the next picture may be solved.
_few_pixels = lru_cache(maxsize=3)(Camera._find_field)
_one_size = lru_cache(maxsize=1)(Camera._find_field)


@checked
class _FocalCamera(Camera):
    """A camera with focal lengths and a principal point, px."""

    fx: FocalLength
    fy: FocalLength
    cx: Centre
    cy: Centre

    _in_pixels: ClassVar = {"fx": 0, "fy": 1, "cx": 0, "cy": 1}

    @property
    def _affine(self) -> tuple[FloatArray, FloatArray]:
        return np.diag([self.fx, self.fy]), np.array([self.cx, self.cy])


@checked
class Pinhole(_FocalCamera):
    """Pinhole camera: h = tan ϑ.

    Parameters
    ----------
    width, height : int
        Size of the picture, px.
    fx, fy, cx, cy : float
        Focal lengths and principal point, px.

    Examples
    --------
    >>> import endolab as el
    >>> camera = el.Pinhole(320, 240, fx=160, fy=160, cx=159.5, cy=119.5)
    >>> camera.project([10.0, 0.0, 20.0])  # a point, mm, to a pixel
    array([239.5, 119.5])
    """

    model: Literal["pinhole"] = field(default="pinhole", kw_only=True, repr=False)


def distort(
    z: ArrayLike, k: Sequence[float] | FloatArray
) -> tuple[ComplexArray, FloatArray, ComplexArray]:
    """Distort points x + iy of a pinhole's plane as Brown, Conrady and OpenCV do.

    Returns where they come to, w, and the parts of the derivative dw = a dz + b dz̄. a is real, so that its
    matrix is symmetric, with eigenvalues a ± |b|.
    """
    z = np.asarray(z, dtype=np.complex128)
    k1, k2, p1, p2, k3, k4, k5, k6 = k
    p = p2 + 1j * p1
    s = z.real**2 + z.imag**2
    below = 1 + s * (k4 + s * (k5 + s * k6))
    ratio = (1 + s * (k1 + s * (k2 + s * k3))) / below
    slope = k1 + s * (2 * k2 + s * 3 * k3) - ratio * (k4 + s * (2 * k5 + s * 3 * k6))
    slope /= below
    shift = 2 * (p.conjugate() * z).real
    w = z * (ratio + shift) + p * s
    return w, ratio + s * slope + 2 * shift, z * (z * slope + 2 * p)


def _all_eight(k: tuple[float, ...]) -> tuple[float, ...]:
    if len(k) not in (4, 5, 8):
        raise ValueError(f"must hold 4, 5 or 8 coefficients, got {list(k)}")
    return k + (0.0,) * (8 - len(k))


@checked
class BrownConrady(_FocalCamera):
    """Pinhole camera whose picture is distorted: OpenCV's usual model, by Brown and Conrady.

    Parameters
    ----------
    width, height : int
        Size of the picture, px.
    fx, fy, cx, cy : float
        Focal lengths and principal point, px.
    k : 4, 5 or 8 floats
        k1, k2, p1, p2, k3, k4, k5, k6, as OpenCV orders them; those left out are 0.

    Notes
    -----
    The model is used as far as it is one to one whatever the direction, at most to 89°: beyond that a pixel
    has no ray and a point no pixel. With h = r (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶)
    it ends where dh/dr falls to 6 r |(p1, p2)|, or at a pole.

    References
    ----------
    .. [1] Brown, "Close-range camera calibration", Photogrammetric Engineering 37(8), 1971.

    Examples
    --------
    >>> import endolab as el
    >>> camera = el.BrownConrady(320, 240, 160, 160, 159.5, 119.5, (-0.2, 0.05, 0, 0))
    >>> camera.project([10.0, 0.0, 20.0])  # a point, mm, to a pixel
    array([235.75, 119.5 ])
    """

    model: Literal["brown_conrady"] = field(
        default="brown_conrady", kw_only=True, repr=False
    )
    k: Annotated[tuple[Coefficient, ...], AfterValidator(_all_eight)] = (0.0,) * 8

    @cached_property
    def _max_radius(self) -> float:
        # Eigenvalues of the derivative are dh/dr and h/r but for p1 and p2, which take off 6 r |p| at most,
        # along the radius. While all are positive in a disc, no two of its points meet.
        k1, k2, p1, p2, k3, k4, k5, k6 = self.k
        r = Polynomial([0.0, 1.0])
        above = Polynomial([0.0, 1.0, 0.0, k1, 0.0, k2, 0.0, k3])
        below = Polynomial([1.0, 0.0, k4, 0.0, k5, 0.0, k6])
        slope = above.deriv() * below - above * below.deriv()
        slope -= 6 * np.hypot(p1, p2) * r * below * below
        # Not quite to the end, where there is no slope, or no end.
        return (1 - 1e-9) * min(
            smallest_positive_root(end.coef, 100.0) for end in (slope, below)
        )

    def _to_pixels(self, plane: FloatArray) -> FloatArray:
        w = distort(plane[..., 0] + 1j * plane[..., 1], self.k)[0]
        return super()._to_pixels(w[..., None].view(float))

    def _to_plane(self, pixels: FloatArray) -> WithSlope:
        w, to_plane = super()._to_plane(pixels)
        z, a, b = self._undistort(w[..., 0] + 1j * w[..., 1])
        inverse = np.stack([a - b.real, -b.imag, -b.imag, a + b.real], axis=-1)
        inverse /= (a * a - np.abs(b) ** 2)[..., None]
        return z[..., None].view(float), inverse.reshape(*z.shape, 2, 2) @ to_plane

    def _undistort(self, w: ComplexArray) -> tuple[ComplexArray, FloatArray, ComplexArray]:
        """Invert `distort`, by Newton's steps from a table of h: z, nan if there is none, a and b."""
        end = self._max_radius
        k1, k2, p1, p2, *others = self.k
        table = np.linspace(0.0, end, 4096)
        h = distort(table, (k1, k2, 0.0, 0.0, *others))[0].real
        radius = np.abs(w)
        reach = h[-1] + 3 * np.hypot(p1, p2) * end**2  # beyond it there is nothing to try
        w = np.where(radius <= reach, w, np.nan)
        z = w * (np.interp(radius, h, table) / np.where(radius > 0, radius, 1.0))
        for _ in range(20):  # three are enough but at the very end
            there, a, b = distort(z, self.k)
            miss = w - there
            if not np.any(np.abs(miss) > 1e-14 * (1 + radius)):
                break
            with nan_if_undefined():
                inverse = 1 / (a * a - np.abs(b) ** 2)
                z = z + inverse * (a * miss - b * miss.conjugate())
            z *= end / np.maximum(np.abs(z), end)
        return np.where(np.abs(miss) < 1e-9 * (1 + radius), z, np.nan), a, b


@checked
class KannalaBrandt(_FocalCamera):
    """Kannala-Brandt fisheye: h = ϑ + k1 ϑ³ + k2 ϑ⁵ + k3 ϑ⁷ + k4 ϑ⁹ (paper, Section III-A).

    Parameters
    ----------
    width, height : int
        Size of the picture, px.
    fx, fy, cx, cy : float
        Focal lengths and principal point, px.
    k : four floats
        Distortion coefficients k1 to k4.

    Notes
    -----
    The polynomial is used as far as it grows, at most to π: beyond that a pixel has no ray
    and a point no pixel. Agrees with ``cv2.fisheye`` below 90°, and goes on where that ends.

    Examples
    --------
    >>> import endolab as el, numpy as np
    >>> camera = el.load_calibration("paper", width=320).camera
    >>> ray = camera.unproject([100.0, 50.0])
    >>> np.allclose(camera.project(ray), [100, 50])
    True
    """

    model: Literal["kannala_brandt"] = field(
        default="kannala_brandt", kw_only=True, repr=False
    )
    k: tuple[Coefficient, Coefficient, Coefficient, Coefficient] = (0.0, 0.0, 0.0, 0.0)

    @cached_property
    def max_angle(self) -> float:  # noqa: D102
        k1, k2, k3, k4 = self.k
        slope_in_square = [1.0, 3 * k1, 5 * k2, 7 * k3, 9 * k4]
        return float(np.sqrt(smallest_positive_root(slope_in_square, np.pi**2)))

    @cached_property
    def _max_radius(self) -> float:
        return float(self._radius(np.asarray(self.max_angle)))

    def _polynomial(self, theta: FloatArray) -> WithSlope:
        k1, k2, k3, k4 = self.k
        s = theta * theta
        value = theta * (1 + s * (k1 + s * (k2 + s * (k3 + s * k4))))
        return value, 1 + s * (3 * k1 + s * (5 * k2 + s * (7 * k3 + s * 9 * k4)))

    def _radius(self, theta: FloatArray) -> FloatArray:
        return self._polynomial(theta)[0]

    def _angle(self, radius: FloatArray) -> WithSlope:
        theta = invert_increasing(self._polynomial, radius, 0.0, self.max_angle)
        with np.errstate(divide="ignore"):
            return theta, 1 / self._polynomial(theta)[1]


@checked
class Scaramuzza(Camera):
    """Scaramuzza's omnidirectional camera (OCamCalib), with z forward.

    The pixel is ``[[c, d], [e, 1]] p + (cx, cy)`` and its ray is parallel to
    (p, a0 + a1 r + a2 r² + a3 r³ + a4 r⁴), r = |p| in px.

    Parameters
    ----------
    width, height : int
        Size of the picture, px.
    cx, cy : float
        Centre of distortion, px.
    a : five floats
        The polynomial, lowest degree first; a0 is positive (z forward) and a1 is zero.
    c, d, e : float
        Affine map of the sensor.

    References
    ----------
    .. [1] Scaramuzza, Martinelli, Siegwart, "A toolbox for easily calibrating omnidirectional
       cameras", IROS 2006.
    """

    model: Literal["scaramuzza"] = field(default="scaramuzza", kw_only=True, repr=False)
    cx: Centre
    cy: Centre
    # a0 is positive, so that z is forward; a1 is 0: the lens is smooth.
    a: tuple[FocalLength, Annotated[float, Field(ge=0, le=0)], Degree, Degree, Degree]
    c: Affine = 1.0
    d: Affine = 0.0
    e: Affine = 0.0
    row_scale: Affine = 1.0  # the lower right entry of the affine map: 1 until a resize

    _in_pixels: ClassVar = {"cx": 0, "cy": 1, "c": 0, "d": 0, "e": 1, "row_scale": 1}

    @property
    def _affine(self) -> tuple[FloatArray, FloatArray]:
        matrix = np.array([[self.c, self.d], [self.e, self.row_scale]])
        return matrix, np.array([self.cx, self.cy])

    @cached_property
    def _max_radius(self) -> float:
        # ϑ = atan2(r, a(r)) grows while a - r a' > 0; work in r/a0 to keep the roots near one.
        a0, _, a2, a3, a4 = self.a
        scaled = [1.0, 0.0, -a2 * a0, -2 * a3 * a0**2, -3 * a4 * a0**3]
        return a0 * smallest_positive_root(scaled, 100.0)

    def _angle(self, radius: FloatArray) -> WithSlope:
        a0, _, a2, a3, a4 = self.a
        r = radius
        height = a0 + r * r * (a2 + r * (a3 + r * a4))
        turn = a0 - r * r * (a2 + r * (2 * a3 + r * 3 * a4))
        return np.arctan2(r, height), turn / (r * r + height * height)

    def _radius(self, theta: FloatArray) -> FloatArray:
        return invert_increasing(self._angle, theta, 0.0, self._max_radius)
