"""Simple scenes with exact distance and normals, and the frames an endoscope makes of them.

01 a tilted plane, 02 the inside of a ball, 03 a tube and 04 a haustral colon, whose folds
occlude one another. The first three play the parts of the paper's simple scenes (Section
VI-A, Table I): mean distances of about 110, 60 and 40 mm. `Bump` is a plane with a bump or a dent.

Each is a surface in the camera frame (mm), whatever the camera. 1 to 3 are met by a ray in
closed form, 4 by marching to the first root and polishing it with Newton's method.
"""

from typing import Annotated, Protocol, runtime_checkable

import numpy as np
from pydantic import Field

from endolab.numerics.arrays import FloatArray
from endolab.numerics.checked_types import checked
from endolab.numerics.side_by_side import side_by_side

Length = Annotated[float, Field(ge=1e-3, le=1e6)]  # mm

SIDEWAYS = 0.3  # of its swing in x, that a colon makes in y


@runtime_checkable
class Scene(Protocol):
    """A surface that a camera at the origin looks at along z."""

    def distance(self, rays: FloatArray) -> FloatArray:
        """Distance along unit rays (..., 3) to the surface, mm; nan where a ray meets nothing."""
        ...

    def normals(self, points: FloatArray) -> FloatArray:
        """Unit normals (..., 3) at surface points (..., 3), towards the camera."""
        ...


def _tilt_matrix(degrees: float) -> FloatArray:
    """Turn about the y axis: a direction along z leans to the right."""
    c = np.cos(np.deg2rad(degrees))
    s = np.sin(np.deg2rad(degrees))
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


@checked
class Plane:
    """Scene 01: a plane, turned about the vertical.

    Parameters
    ----------
    depth : float
        z where the optical axis meets it, mm.
    tilt : float
        Angle between its normal and the axis, degrees.
    """

    depth: Length = 85.0
    tilt: Annotated[float, Field(ge=-89.9, le=89.9)] = 20.0

    @property
    def _normal(self) -> FloatArray:
        return -_tilt_matrix(self.tilt)[:, 2]

    def distance(self, rays: FloatArray) -> FloatArray:
        """See `Scene.distance`."""
        facing = rays @ self._normal
        return self.depth * self._normal[2] / np.where(facing < 0, facing, np.nan)

    def normals(self, points: FloatArray) -> FloatArray:
        """See `Scene.normals`."""
        return np.broadcast_to(self._normal, points.shape).copy()


@checked
class Bowl:
    """Scene 02: a curved surface, the inside of a ball that the camera looks at off centre.

    Parameters
    ----------
    radius : float
        Of the ball, mm.
    centre : three floats
        Of the ball, in the camera frame, mm; the camera must lie inside.
    """

    radius: Length = 115.0
    centre: tuple[float, float, float] = (40.0, -23.0, -52.0)

    def __post_init__(self) -> None:
        if not np.linalg.norm(self.centre) < self.radius:
            raise ValueError(
                f"the camera must lie inside the ball of radius {self.radius} mm"
            )

    def distance(self, rays: FloatArray) -> FloatArray:
        """See `Scene.distance`."""
        centre = np.asarray(self.centre)
        along = rays @ centre
        return along + np.sqrt(along**2 + self.radius**2 - centre @ centre)

    def normals(self, points: FloatArray) -> FloatArray:
        """See `Scene.normals`."""
        return (np.asarray(self.centre) - points) / self.radius


@checked
class Tube:
    """Scene 03: a straight tube that a wall closes at its far end.

    Parameters
    ----------
    radius : float
        mm.
    length : float
        From the camera to the wall along the tube, mm.
    tilt : float
        Angle between the tube and the optical axis, degrees.
    offset : two floats
        Where the camera sits in the tube's cross-section, mm from its middle.
    """

    radius: Length = 18.5
    length: Length = 130.0
    tilt: float = 0.0
    offset: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if not np.hypot(*self.offset) < self.radius:
            raise ValueError(
                f"the camera must lie inside the tube of radius {self.radius} mm"
            )

    def distance(self, rays: FloatArray) -> FloatArray:
        """See `Scene.distance`."""
        inside = rays @ _tilt_matrix(self.tilt)
        across = inside[..., :2]
        along = inside[..., 2]
        offset = np.asarray(self.offset)
        a = np.sum(across**2, axis=-1)
        b = across @ offset
        with np.errstate(divide="ignore", invalid="ignore"):
            side = (-b + np.sqrt(b * b + a * (self.radius**2 - offset @ offset))) / a
            wall = np.where(along > 0, self.length / along, np.inf)
        nearest = np.fmin(side, wall)
        return np.where(np.isfinite(nearest), nearest, np.nan)

    def normals(self, points: FloatArray) -> FloatArray:
        """See `Scene.normals`."""
        turn = _tilt_matrix(self.tilt)
        inside = points @ turn
        side = np.append(self.offset, 0.0) + inside
        side[..., 2] = 0.0
        is_wall = inside[..., 2] > self.length * (1 - 1e-12)
        normal = np.where(is_wall[..., None], [0.0, 0.0, -1.0], -side / self.radius)
        return normal @ turn.T


@checked
class Colon:
    """Scene 04: a haustral colon, a winding tube with folds that hide what lies behind them.

    In the tube's own frame the wall is at R(φ, s) = R₀ (1 - h b(s) (0.6 + 0.4 cos 3φ′)) from a
    centre line that winds to the side, b(s) = exp(κ (cos 2πs/L - 1)) being the row of folds.

    Parameters
    ----------
    radius : float
        R₀ between the folds, mm.
    fold_height : float
        h, as a share of the radius, at most 0.8.
    fold_spacing : float
        L, mm.
    sharpness : float
        κ: how thin the folds are.
    winding : float
        How far the centre line swings to the side, mm.
    length : float
        To the wall that closes the far end, mm.
    """

    radius: Length = 22.0
    fold_height: Annotated[float, Field(ge=0, le=0.8)] = 0.38
    fold_spacing: Length = 27.0
    sharpness: float = 7.0
    winding: float = 13.0
    length: Length = 170.0

    def __post_init__(self) -> None:
        if not self._inside(*self._camera)[0] > 0:
            raise ValueError(
                f"the camera must lie inside the colon, of radius {self.radius} mm"
            )

    _period = 230.0  # of the winding, mm
    _phase = 11.0  # of the folds, mm: the camera sits between two of them
    _twist = 2.2 / 27.0  # of the folds about the centre line, rad/mm
    _camera = np.array([2.0, -1.5, 0.0])

    def _shape(
        self, s: FloatArray, cos3: FloatArray, sin3: FloatArray
    ) -> tuple[FloatArray, ...]:
        """R and its derivatives by s and φ, given the cosine and sine of 3φ′."""
        wave = 2 * np.pi / self.fold_spacing
        bump = np.exp(self.sharpness * (np.cos(wave * (s - self._phase)) - 1))
        bump_s = -self.sharpness * wave * np.sin(wave * (s - self._phase)) * bump
        height = self.radius * self.fold_height
        lobe = 0.6 + 0.4 * cos3
        rho_phi = height * bump * 1.2 * sin3
        rho_s = rho_phi * self._twist - height * bump_s * lobe
        return self.radius - height * bump * lobe, rho_s, rho_phi

    def _winding(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """How far the centre line swings in x, and its derivative by s; in y it is `SIDEWAYS` of both."""
        w = 2 * np.pi / self._period
        return self.winding * (1 - np.cos(w * s)), self.winding * w * np.sin(w * s)

    def _inside(
        self, x: FloatArray, y: FloatArray, s: FloatArray
    ) -> tuple[FloatArray, ...]:
        """How far inside the tube points of its frame are (mm, not a distance), and its three derivatives.

        Map by map: in arrays of triples, each step takes several times as long.
        """
        swing, slope = self._winding(s)
        x = x - swing
        y = y - SIDEWAYS * swing
        rho = np.maximum(np.hypot(x, y), 1e-9)
        x = x / rho
        y = y / rho
        angle = 3 * (np.arctan2(y, x) + self._twist * s)
        wall, wall_s, wall_phi = self._shape(s, np.cos(angle), np.sin(angle))
        turn = wall_phi / rho
        by_x = -turn * y - x
        by_y = turn * x - y
        return wall - rho, by_x, by_y, wall_s - (by_x * slope + by_y * (SIDEWAYS * slope))

    def distance(self, rays: FloatArray) -> FloatArray:
        """See `Scene.distance`; the first root along the ray, to rounding."""
        flat = rays.reshape(-1, 3)
        # What is computed of so many rays stays in a core's cache.
        parts = np.array_split(flat, -(-len(flat) // 16_000) or 1)
        # Each ray takes many steps, so that threads pay sooner than for a pixel.
        found = side_by_side(self._first_roots, parts, 30 * len(flat))
        return np.concatenate(found).reshape(rays.shape[:-1])

    def _first_roots(self, flat: FloatArray) -> FloatArray:
        """Distances along rays (n, 3)."""
        with np.errstate(divide="ignore"):
            end = np.where(flat[:, 2] > 0, self.length / flat[:, 2], 4 * self.length)
        # Bounds on the first and second derivative of F along a ray, beyond half the lumen;
        # within, the wall is at least a quarter of the lumen away.
        height = self.radius * self.fold_height
        wave = 2 * np.pi / self.fold_spacing
        narrowest = self.radius - height
        steepest = (
            np.hypot(1.0, 2.4 * height / narrowest)
            + 0.62 * height * wave * np.sqrt(self.sharpness)
            + 2.2 * np.pi * self.winding / self._period
            + 1.2 * height * self._twist
        )
        bend = (
            1.5 * height * self.sharpness * wave**2
            + 4 / narrowest
            + 16 * height / narrowest**2
        )
        is_ray = np.isfinite(flat).all(axis=-1)
        t = np.where(is_ray, 0.0, np.nan)
        rays = np.ascontiguousarray(flat.T)
        busy = np.flatnonzero(is_ray)
        while busy.size:
            now = t[busy]
            ray = rays[:, busy]
            places = self._camera[:, None] + now * ray
            inside, by_x, by_y, by_s = self._inside(*places)
            inside = np.maximum(inside, 0.0)
            slope = by_x * ray[0] + by_y * ray[1] + by_s * ray[2]
            # Steps that cannot cross a wall: F ≥ F₀ - steepest·t, and F ≥ F₀ + F₀'t - bend·t²/2,
            # whose root becomes Newton's step as F₀ → 0.
            root = np.sqrt(slope**2 + 2 * bend * inside)
            with np.errstate(invalid="ignore"):
                curved = np.where(
                    slope < 0, 2 * inside / (root - slope), (slope + root) / bend
                )
            step = np.minimum(np.maximum(curved, inside / steepest), narrowest / 4)
            now = t[busy] = now + step
            busy = busy[(step > 1e-14 * self.length) & (inside > 0) & (now < end[busy])]
        t = np.minimum(t, end)
        return np.where(t < 4 * self.length, t, np.nan)

    def normals(self, points: FloatArray) -> FloatArray:
        """See `Scene.normals`."""
        inside = points + self._camera
        gradient = np.stack(self._inside(*np.moveaxis(inside, -1, 0))[1:], axis=-1)
        gradient[inside[..., 2] > self.length * (1 - 1e-12)] = [0.0, 0.0, -1.0]
        return gradient / np.linalg.norm(gradient, axis=-1, keepdims=True)


@checked
class Bump:
    """A plane across the optical axis with a bump on it or, where its height is negative, a dent.

    The surface is z = depth - height exp(-(x² + y²) / (2 width²)); it hides nothing of itself.

    Parameters
    ----------
    depth : float
        z of the plane, mm.
    height : float
        Of the bump, mm; at most half the depth.
    width : float
        From its middle to where it is steepest, mm.
    """

    depth: Length = 60.0
    height: float = 8.0
    width: Length = 10.0

    def _bump_height(self, squared: FloatArray) -> FloatArray:
        """How far the wall stands out at squared distances from the axis."""
        return self.height * np.exp(-squared / (2 * self.width**2))

    def distance(self, rays: FloatArray) -> FloatArray:
        """See `Scene.distance`; by bisection, as z + raised(z) grows along every ray."""
        ahead = rays[..., 2]
        cosine = np.where(ahead > 0, ahead, np.nan)
        spread = (rays[..., 0] ** 2 + rays[..., 1] ** 2) / cosine**2
        low = np.full(ahead.shape, self.depth - max(self.height, 0.0))
        high = low + abs(self.height)
        for _ in range(60):
            middle = (low + high) / 2
            beyond = middle + self._bump_height(spread * middle**2) > self.depth
            low = np.where(beyond, low, middle)
            high = np.where(beyond, middle, high)
        return (low + high) / 2 / cosine

    def normals(self, points: FloatArray) -> FloatArray:
        """See `Scene.normals`."""
        across = points[..., :2]
        raised = self._bump_height(np.sum(across**2, axis=-1))[..., None]
        normal = np.concatenate(
            [raised * across / self.width**2, -np.ones_like(raised)], axis=-1
        )
        return normal / np.linalg.norm(normal, axis=-1, keepdims=True)


SCENES: dict[str, Scene] = {
    "plane": Plane(),
    "curved": Bowl(),
    "tube": Tube(),
    "colon": Colon(),
}
