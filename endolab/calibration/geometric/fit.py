"""Geometric calibration: a fisheye or Brown-Conrady camera and the poses of a flat target, from its views.

Residuals are measured less predicted pixels, minimised robustly by `least_squares`; the camera is
common to all views, the pose is each view's own. No guess is needed: for several focal lengths of
an equidistant camera the poses follow linearly from the rays (`planar_pose`), the best one grows into
the full model. A Brown-Conrady camera begins where the fisheye ends; between the two decide views that were
held out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import compress

import numpy as np
from scipy.spatial.transform import Rotation

from endolab.calibration.geometric.planar_pose import LEAST_POINTS
from endolab.calibration.geometric.pose import Pose
from endolab.calibration.geometric.projection import (
    CAMERA_NAMES,
    Lens,
    camera_names,
    camera_of,
    camera_vector,
)
from endolab.calibration.geometric.reprojection import (
    FINEST,
    Geometry,
    Reprojection,
    View,
    find_pose,
    linear_pose,
)
from endolab.calibration.least_squares import Fit, fit
from endolab.calibration.targets import Target
from endolab.model.cameras import BrownConrady, KannalaBrandt
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.checks import unknown_name
from endolab.numerics.iteration import Status

LEAST_VIEWS = 3
VIEWS_NEEDED = f"a calibration needs {LEAST_VIEWS} views from different directions at least"
LENSES = ("auto", "fisheye", "brown")
# rad off the axis: a lens that was seen farther out is a fisheye, and to there it is imitated to begin.
WIDEST_BROWN = 1.2
# Another lens than the fisheye has to predict views held out better by this share: six views of
# `chessboard_storz` gain 2 %, and its published focal length is nearer to the fisheye's.
LEAST_GAIN = 0.05
# A Brown-Conrady lens is not tried if it is farther off from a fisheye, in root mean square errors of that.
FARTHEST_BROWN = 3.0
HOLD_OUT = 6  # parts of the views, of which each is held out once


@dataclass(frozen=True)
class GeometricFit:
    """What a geometric calibration found.

    A view that did not take part goes by the name of its frame, on a folded target by that and its panel.
    The calibration holds to `max_angle_seen`; `camera.max_angle` may be less than the picture's corners need.
    """

    camera: Lens
    views: tuple[View, ...]  # those that took part
    poses: tuple[Pose, ...]  # of each view
    dropped: dict[str, str]  # view that did not take part → why
    residuals: tuple[FloatArray, ...]  # (n, 2) each: measured less predicted, px
    inliers: tuple[BoolArray, ...]  # (n,) each: points that count
    sigma: (
        float  # standard deviation of one coordinate, px; never below that of `PointErrors`
    )
    rmse: float  # root mean square distance of the inliers, px, as ``cv2`` counts it: √2 σ or so
    covariance: FloatArray  # (8, 8) or (12, 12), of fx, fy, cx, cy (px) and k
    max_angle_seen: float  # largest angle off the axis of an inlier, rad
    status: Status
    # Lens that was tried → root mean square error of views held out, px.
    held_out: dict[str, float] = field(default_factory=dict)

    @property
    def standard_errors(self) -> dict[str, float]:
        """Of fx, fy, cx, cy (px) and k, by their names."""
        errors = np.sqrt(np.diag(self.covariance)).tolist()
        return dict(zip(camera_names(self.camera), errors, strict=True))

    @property
    def agreement(self) -> float:
        """Share of the points that count; below 0.95 or so, the lens is of another kind or the sheet bent."""
        return float(np.mean(np.concatenate(self.inliers)))


def _label(view: View, target: Target) -> str:
    return view.name if target.panels == 1 else f"{view.name}, panel {view.panel}"


def _first_poses(
    views: Sequence[View], target: Target, camera: Lens
) -> tuple[list[View], list[Pose], dict[str, str]]:
    """Linear poses of the views that have one; why others have none."""
    kept = []
    poses = []
    dropped = {}
    for view in views:
        try:
            poses.append(linear_pose(view, target, camera))
            kept.append(view)
        except ValueError as error:
            dropped[_label(view, target)] = str(error)
    return kept, poses, dropped


def _start(views: Sequence[View], target: Target, width: int, height: int) -> KannalaBrandt:
    """Return the equidistant camera that explains a dozen of the views best, by its focal length."""
    some = views[:: -(-len(views) // 12)]
    best = np.inf
    for focal in width * np.geomspace(0.2, 3.0, 10):
        camera = KannalaBrandt(
            width, height, focal, focal, (width - 1) / 2, (height - 1) / 2
        )
        kept, poses, dropped = _first_poses(some, target, camera)
        misses = np.full(len(some), np.inf)
        if kept:
            model = Reprojection(kept, target, 0, np.zeros(4))
            geometry = Geometry.of(camera_vector(camera), poses)
            misses[: len(kept)] = model.medians(geometry)
        # The lower median: half of the views may be useless.
        miss = np.sort(misses)[(len(some) - 1) // 2]
        if miss < best:
            best = miss
            start = camera
    if np.isinf(best):
        raise ValueError(f"most views are of no use: {_reasons(dropped)}")
    return start


def _fit_views(
    views: Sequence[View],
    geometry: Geometry,
    target: Target,
    usual: FloatArray,
    near: bool = False,
) -> tuple[Fit, list[View], dict[str, str]]:
    """Fit, leave out the views of which fewer than half the points agree, until all agree."""
    dropped: dict[str, str] = {}
    while True:
        _refuse_few(len(views), dropped, least=1)
        model = Reprojection(views, target, min(4 + len(usual), 9), usual)
        fitted = fit(model, geometry, FINEST, near)
        geometry = fitted.unknowns
        good = []
        for number, view in enumerate(views):
            used = fitted.used[model.group == number]
            why = ""
            if not geometry.facing[number]:
                why = "it shows the paper from behind"
            elif used.sum() < max(LEAST_POINTS, len(used) / 2):
                share = f"{used.sum()} of its {len(used)}"
                why = f"only {share} points agree with the other views"
            good.append(not why)
            if why:
                dropped[_label(view, target)] = why
        views = list(compress(views, good))
        if all(good):
            return fitted, views, dropped
        geometry = geometry.only(good)


def _reasons(dropped: dict[str, str]) -> str:
    shown = "; ".join(f"{name}: {why}" for name, why in list(dropped.items())[:3])
    return shown + ("; …" if len(dropped) > 3 else "")


def calibrate_camera(
    views: Sequence[View],
    target: Target,
    width: int,
    height: int,
    *,
    lens: str = "fisheye",
    start: Lens | None = None,
) -> GeometricFit:
    """Calibrate a camera from views of a target.

    Parameters
    ----------
    views : sequence of View
        Three at least, from different directions, some tilted; see `views_of`.
    target : Target
    width, height : int
        Of the pictures, px.
    lens : {"fisheye", "brown", "auto"}
        `KannalaBrandt`, `BrownConrady`, or what predicts views that were held out
        best; a fisheye where they go beyond 69° off the axis, or the other is far from what it sees.
    start : KannalaBrandt or BrownConrady, optional
        A camera near the truth, whose kind is fitted whatever the `lens`. Then one view is enough, and
        what it cannot tell shows in the
        standard errors.

    Returns
    -------
    GeometricFit
        Camera, poses, residuals and standard errors. These cover how far the cameras of other views are
        apart, and where both lenses fit as well, how far these are.

    Raises
    ------
    ValueError
        If the views cannot tell the camera: too few, none tilted, or a standard error that is
        too large; the sentence says what was found and what is needed.
    """
    if lens not in LENSES:
        raise unknown_name("lens", lens, LENSES)
    size = width, height
    if start is not None:
        return _calibrate(views, target, size, start)
    _refuse_few(len(views), {})
    fitted = _calibrate(views, target, size, _start(views, target, *size))
    _refuse_untold(fitted)
    begin, off = _begin_brown(fitted)
    is_wide = fitted.max_angle_seen > WIDEST_BROWN or not off < FARTHEST_BROWN * fitted.rmse
    if lens == "fisheye" or (lens == "auto" and is_wide):
        return _hold_out(fitted, target)[0]
    brown = _calibrate(views, target, size, begin)
    _refuse_untold(brown)
    brown, error = _hold_out(brown, target)
    if lens == "brown":
        return brown
    fitted, other = _hold_out(fitted, target)
    errors = {"fisheye": other, "brown": error}
    if error < (1 - LEAST_GAIN) * other:
        return replace(brown, held_out=errors)
    if error < (1 + LEAST_GAIN) * other:
        apart = camera_vector(brown.camera)[:4] - camera_vector(fitted.camera)[:4]
        fitted.covariance[:4, :4] += np.outer(apart, apart)
    return replace(fitted, held_out=errors)


def _begin_brown(fitted: GeometricFit) -> tuple[BrownConrady, float]:
    """Return the Brown-Conrady camera that is likest to a fisheye, as far as it was seen.

    And how far off it is along a row, rms, px; nan if it has no such rays.
    """
    camera = fitted.camera
    theta = np.linspace(0.02, min(fitted.max_angle_seen, WIDEST_BROWN), 100)
    ray = np.stack([np.sin(theta), 0 * theta, np.cos(theta)], axis=-1)
    h = (camera.project(ray)[:, 0] - camera.cx) / camera.fx
    r = np.tan(theta)
    odd = r[:, None] ** [3, 5, 7]
    k1, k2, k3 = np.linalg.lstsq(odd, h - r)[0].tolist()
    size = camera.width, camera.height
    focal = camera.fx, camera.fy, camera.cx, camera.cy
    likest = BrownConrady(*size, *focal, (k1, k2, 0.0, 0.0, k3))
    off = likest.project(ray) - camera.project(ray)
    return likest, float(np.sqrt(np.mean(off**2)))


def _hold_out(fitted: GeometricFit, target: Target) -> tuple[GeometricFit, float]:
    """Hold views out, in turn, and widen the standard errors to how far the cameras of the others are apart.

    A detector's errors are not independent within a view, so that the covariance C of the fit is too small.
    By the jackknife over g parts, whose cameras are off that of all by Δ, its p numbers have

        q = (g - 1) median(Δᵀ C⁻¹ Δ) / (p - 2/3)

    times that variance: the median of χ² of p degrees of freedom is p - 2/3. Returns the fit, and the root
    mean square error, px, of the views as others predict them, but for the worst points; inf if they cannot.
    """
    geometry = Geometry.of(camera_vector(fitted.camera), fitted.poses)
    names = list(dict.fromkeys(view.name for view in fitted.views))
    parts = min(HOLD_OUT, len(names))
    squares = []
    cameras = []
    for part in range(parts):
        known = [view.name not in names[part::parts] for view in fitted.views]
        views = list(compress(fitted.views, known))
        size = fitted.camera.width, fitted.camera.height
        try:
            begin = geometry.only(known)
            there = _fit_views(views, begin, target, begin.vector[4:], near=True)[0]
            vector = there.unknowns.vector
            for view, is_known in zip(fitted.views, known, strict=True):
                if not is_known:
                    residual = find_pose(view, target, camera_of(vector, *size))[2]
                    squares.append(np.sum(residual**2, axis=1))
        except (ValueError, ArithmeticError):
            return fitted, np.inf
        cameras.append(vector)
    determined = np.diag(fitted.covariance) > 0
    determined &= np.isfinite(np.diag(fitted.covariance))
    inverse = np.linalg.inv(fitted.covariance[np.ix_(determined, determined)])
    off = (np.array(cameras) - geometry.vector)[:, determined]
    lengths = np.sum(off @ inverse * off, axis=1)
    q = float((parts - 1) * np.median(lengths) / (determined.sum() - 2 / 3))
    ordered = np.sort(np.concatenate(squares))
    error = float(np.sqrt(np.mean(ordered[: int(0.95 * len(ordered))])))
    return replace(fitted, covariance=max(1.0, q) * fitted.covariance), error


def _calibrate(
    views: Sequence[View], target: Target, size: tuple[int, int], start: Lens
) -> GeometricFit:
    """Calibrate a camera of the kind of `start`."""
    views, poses, dropped = _first_poses(views, target, start)
    _refuse_few(len(views), dropped, least=1)
    begin = Geometry.of(camera_vector(start), poses)
    fitted, views, disagreeing = _fit_views(views, begin, target, begin.vector[4:])
    geometry: Geometry = fitted.unknowns
    cuts = np.cumsum([len(view.ids) for view in views])[:-1]
    covariance = np.zeros((len(geometry.vector),) * 2)
    free = len(fitted.covariance.common)
    covariance[:free, :free] = fitted.covariance.common
    angles = Reprojection(views, target, 0, begin.vector[4:]).angles(geometry)
    squares = np.sum(fitted.residual[fitted.used] ** 2, axis=1)
    return GeometricFit(
        camera=camera_of(geometry.vector, *size),
        views=tuple(views),
        poses=tuple(geometry.poses),
        dropped=dropped | disagreeing,
        residuals=tuple(np.split(fitted.residual, cuts)),
        inliers=tuple(np.split(fitted.used, cuts)),
        sigma=fitted.sigma,
        rmse=float(np.sqrt(np.mean(squares))),
        covariance=covariance,
        max_angle_seen=float(angles[fitted.used].max()),
        status=fitted.status,
    )


def _refuse_few(count: int, dropped: dict[str, str], least: int = LEAST_VIEWS) -> None:
    if count < least:
        why = f" ({_reasons(dropped)})" if dropped else ""
        raise ValueError(f"{VIEWS_NEEDED}, got {count}{why}")


def _is_elsewhere(pose: Pose, other: Pose) -> bool:
    """Whether two poses differ by a degree, or a fiftieth of the distance."""
    shift = np.linalg.norm(pose.translation - other.translation)
    turn = Rotation.from_matrix(pose.rotation.T @ other.rotation).magnitude()
    return bool(turn > np.radians(1) or shift > 0.02 * np.linalg.norm(pose.translation))


def _refuse_untold(result: GeometricFit) -> None:
    """Refuse a camera that its views do not tell."""
    _refuse_few(len(result.views), result.dropped)
    places: list[Pose] = []
    for pose in result.poses:
        if all(_is_elsewhere(pose, place) for place in places):
            places.append(pose)
    if len(places) < LEAST_VIEWS:
        hardly = f"the sheet hardly moves in the {len(result.poses)} views"
        raise ValueError(f"{VIEWS_NEEDED}, got {len(places)}: {hardly}")
    tilt = max(pose.tilt for pose in result.poses)
    fact = f"the sheet's largest tilt is {np.degrees(tilt):.1f}°"
    if tilt < np.radians(5):
        square = "views square to the axis cannot tell the focal length from the distance"
        raise ValueError(f"{square}: {fact}; tilt the sheet by 20° or more in some views")
    focal = np.sqrt(result.camera.fx * result.camera.fy)
    for name in CAMERA_NAMES[:4]:
        error = result.standard_errors[name]
        if not error < 0.05 * focal:
            lie = f"points lie up to {np.degrees(result.max_angle_seen):.0f}° off the axis"
            why = f"its standard error is {error:.0f} px; {fact}, and {lie}"
            ways = "add tilted views that fill the picture"
            raise ValueError(f"the views do not tell {name}: {why}; {ways}")
