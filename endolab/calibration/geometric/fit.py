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

from endolab.calibration.geometric.planar_pose import PLANE
from endolab.calibration.geometric.pose import Pose
from endolab.calibration.geometric.projection import (
    CAMERA_NAMES,
    Lens,
    camera_names,
    camera_of,
    camera_vector,
)
from endolab.calibration.geometric.reprojection import (
    POINT_ERRORS,
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


@dataclass(frozen=True)
class CameraFitRules:
    """Where the fit of a camera begins, and which views and cameras are refused."""

    # Focal lengths to begin with, of the picture's width: so many between these, in ratio.
    shortest_focal: float = 0.2
    longest_focal: float = 3.0
    focal_lengths: int = 10
    views_to_start: int = 12  # are enough to choose among these
    least_views: int = 3
    least_tilt: float = float(np.radians(5.0))
    # Standard error of a focal length or centre, of the focal length.
    largest_error: float = 0.05
    # Lenses are told apart by views held out, one in so many, and the points of these but the worst; another
    # than the fisheye has to predict them better by that share: six views of `chessboard_storz` gain 2 %, and
    # its published focal length is nearer to the fisheye's.
    hold_out: int = 3
    points_scored: float = 0.95
    least_gain: float = 0.05
    # rad off the axis: a lens that was seen farther out is a fisheye, and to there it is imitated to begin.
    widest_brown: float = 1.2


CAMERA_FIT = CameraFitRules()
VIEWS_NEEDED = (
    f"a calibration needs {CAMERA_FIT.least_views} views from different directions at least"
)
LENSES = ("auto", "fisheye", "brown")


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
    standard_errors: dict[str, float]  # of fx, fy, cx, cy (px) and k
    covariance: FloatArray  # (8, 8) or (12, 12), of the same
    max_angle_seen: float  # largest angle off the axis of an inlier, rad
    status: Status
    # Lens that was tried → root mean square error of views held out, px.
    held_out: dict[str, float] = field(default_factory=dict)

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


def _misfit(views: Sequence[View], target: Target, camera: KannalaBrandt) -> float:
    """How far off, px, views are in the median; inf if half of them have no pose."""
    kept, poses, _ = _first_poses(views, target, camera)
    misses = np.full(len(views), np.inf)
    if kept:
        model = Reprojection(kept, target, 0, np.zeros(4))
        misses[: len(kept)] = model.medians(Geometry.of(camera_vector(camera), poses))
    # The lower median: half of the views may be useless.
    return float(np.sort(misses)[(len(views) - 1) // 2])


def _start(views: Sequence[View], target: Target, width: int, height: int) -> KannalaBrandt:
    """Return the equidistant camera that explains the views best."""
    some = views[:: -(-len(views) // CAMERA_FIT.views_to_start)]
    focal_lengths = width * np.geomspace(
        CAMERA_FIT.shortest_focal, CAMERA_FIT.longest_focal, CAMERA_FIT.focal_lengths
    )
    centre = (width - 1) / 2, (height - 1) / 2
    cameras = [KannalaBrandt(width, height, f, f, *centre) for f in focal_lengths]
    misfits = [_misfit(some, target, camera) for camera in cameras]
    best = cameras[int(np.argmin(misfits))]
    if np.isinf(min(misfits)):
        reasons = _reasons(_first_poses(some, target, best)[2])
        raise ValueError(f"most views are of no use: {reasons}")
    return best


def _find_disagreeing(fitted: Fit, model: Reprojection) -> list[str]:
    """Say of which views fewer than half the points agree with the fit."""
    why = []
    for number, facing in enumerate(fitted.unknowns.facing):
        used = fitted.used[model.group == number]
        if not facing:
            why.append("it shows the paper from behind")
        elif used.sum() < max(PLANE.least_points, len(used) / 2):
            share = f"{used.sum()} of its {len(used)}"
            why.append(f"only {share} points agree with the other views")
        else:
            why.append("")
    return why


def _fit_views(
    views: list[View],
    geometry: Geometry,
    target: Target,
    usual: FloatArray,
) -> tuple[Fit, list[View], dict[str, str]]:
    """Fit, leave out the views that disagree, until all agree."""
    dropped: dict[str, str] = {}
    while True:
        _refuse_few(len(views), dropped, least=1)
        model = Reprojection(views, target, min(4 + len(usual), 9), usual)
        fitted = fit(model, geometry, POINT_ERRORS.finest)
        why = _find_disagreeing(fitted, model)
        if not any(why):
            return fitted, views, dropped
        labels = [_label(view, target) for view in views]
        dropped |= {
            name: reason for name, reason in zip(labels, why, strict=True) if reason
        }
        good = [not reason for reason in why]
        views = list(compress(views, good))
        geometry = fitted.unknowns
        poses = {
            "rotation": geometry.rotation[good],
            "translation": geometry.translation[good],
        }
        geometry = replace(geometry, **poses)


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
        best; a fisheye where they go beyond 69° off the axis.
    start : KannalaBrandt or BrownConrady, optional
        A camera near the truth, whose kind is fitted whatever the `lens`. Then one view is enough, and
        what it cannot tell shows in the
        standard errors.

    Returns
    -------
    GeometricFit
        Camera, poses, residuals and standard errors.

    Raises
    ------
    ValueError
        If the views cannot tell the camera: too few, none tilted, or a standard error that is
        too large; the sentence says what was found and what is needed.
    """
    if lens not in LENSES:
        raise unknown_name("lens", lens, LENSES)
    fitted = _calibrate(views, target, (width, height), start)
    too_wide = lens == "auto" and fitted.max_angle_seen > CAMERA_FIT.widest_brown
    if lens == "fisheye" or start is not None or too_wide:
        return fitted
    brown = _calibrate(views, target, (width, height), _begin_brown(fitted))
    _refuse_untold(brown)
    if lens == "brown":
        return brown
    fits = {"fisheye": fitted, "brown": brown}
    errors = {name: _predict(fit, target) for name, fit in fits.items()}
    better = errors["brown"] < (1 - CAMERA_FIT.least_gain) * errors["fisheye"]
    return replace(fits["brown" if better else "fisheye"], held_out=errors)


def _begin_brown(fitted: GeometricFit) -> BrownConrady:
    """Return the Brown-Conrady camera that is likest to a fisheye, as far as it was seen."""
    camera = fitted.camera
    theta = np.linspace(0.02, min(fitted.max_angle_seen, CAMERA_FIT.widest_brown), 100)
    ray = np.stack([np.sin(theta), 0 * theta, np.cos(theta)], axis=-1)
    h = (camera.project(ray)[:, 0] - camera.cx) / camera.fx
    r = np.tan(theta)
    odd = r[:, None] ** [3, 5, 7]
    k1, k2, k3 = np.linalg.lstsq(odd, h - r)[0].tolist()
    size = camera.width, camera.height
    focal = camera.fx, camera.fy, camera.cx, camera.cy
    return BrownConrady(*size, *focal, (k1, k2, 0.0, 0.0, k3))


def _predict(fitted: GeometricFit, target: Target) -> float:
    """Root mean square error of views that a fit of the others predicts, px; inf if it cannot."""
    camera = fitted.camera
    names = list(dict.fromkeys(view.name for view in fitted.views))
    squares = []
    for part in range(CAMERA_FIT.hold_out):
        outside = set(names[part :: CAMERA_FIT.hold_out])
        known = [view for view in fitted.views if view.name not in outside]
        try:
            size = camera.width, camera.height
            there = _calibrate(known, target, size, camera).camera
            for view in fitted.views:
                if view.name in outside:
                    residual = find_pose(view, target, there)[2]
                    squares.append(np.sum(residual**2, axis=1))
        except (ValueError, ArithmeticError):
            return np.inf
    ordered = np.sort(np.concatenate(squares))
    count = int(CAMERA_FIT.points_scored * len(ordered))
    return float(np.sqrt(np.mean(ordered[:count])))


def _calibrate(
    views: Sequence[View],
    target: Target,
    size: tuple[int, int],
    start: Lens | None,
) -> GeometricFit:
    """Calibrate a camera of the kind of `start`, or a fisheye without a guess."""
    if start is None:
        _refuse_few(len(views), {})
    camera = start or _start(views, target, *size)
    kept, poses, dropped = _first_poses(views, target, camera)
    _refuse_few(len(kept), dropped, least=1)
    geometry = Geometry.of(camera_vector(camera), poses)
    k = np.array(camera.k)
    fitted, kept, disagreeing = _fit_views(kept, geometry, target, k)
    result = _result(fitted, kept, dropped | disagreeing, target, size)
    if start is None:
        _refuse_few(len(result.views), result.dropped)
        _refuse_untold(result)
    return result


def _result(
    fitted: Fit,
    views: Sequence[View],
    dropped: dict[str, str],
    target: Target,
    size: tuple[int, int],
) -> GeometricFit:
    geometry: Geometry = fitted.unknowns
    used = fitted.used
    residual = fitted.residual
    cuts = np.cumsum([len(view.ids) for view in views])[:-1]
    camera = camera_of(geometry.vector, *size)
    covariance = np.zeros((len(geometry.vector),) * 2)
    free = len(fitted.covariance.common)
    covariance[:free, :free] = fitted.covariance.common
    errors = np.sqrt(np.diag(covariance)).tolist()
    angles = Reprojection(views, target, 0, np.array(camera.k)).angles(geometry)
    return GeometricFit(
        camera=camera,
        views=tuple(views),
        poses=tuple(geometry.poses),
        dropped=dropped,
        residuals=tuple(np.split(residual, cuts)),
        inliers=tuple(np.split(used, cuts)),
        sigma=fitted.sigma,
        rmse=float(np.sqrt(np.mean(np.sum(residual[used] ** 2, axis=1)))),
        standard_errors=dict(zip(camera_names(camera), errors, strict=True)),
        covariance=covariance,
        max_angle_seen=float(angles[used].max()),
        status=fitted.status,
    )


def _refuse_few(
    count: int, dropped: dict[str, str], least: int = CAMERA_FIT.least_views
) -> None:
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
    places: list[Pose] = []
    for pose in result.poses:
        if all(_is_elsewhere(pose, place) for place in places):
            places.append(pose)
    if len(places) < CAMERA_FIT.least_views:
        hardly = f"the sheet hardly moves in the {len(result.poses)} views"
        raise ValueError(f"{VIEWS_NEEDED}, got {len(places)}: {hardly}")
    tilt = max(pose.tilt for pose in result.poses)
    fact = f"the sheet's largest tilt is {np.degrees(tilt):.1f}°"
    if tilt < CAMERA_FIT.least_tilt:
        square = "views square to the axis cannot tell the focal length from the distance"
        raise ValueError(f"{square}: {fact}; tilt the sheet by 20° or more in some views")
    focal = np.sqrt(result.camera.fx * result.camera.fy)
    for name in CAMERA_NAMES[:4]:
        error = result.standard_errors[name]
        if not error < CAMERA_FIT.largest_error * focal:
            lie = f"points lie up to {np.degrees(result.max_angle_seen):.0f}° off the axis"
            why = f"its standard error is {error:.0f} px; {fact}, and {lie}"
            ways = "add tilted views that fill the picture"
            raise ValueError(f"the views do not tell {name}: {why}; {ways}")
