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

from endolab.calibration import constants
from endolab.calibration.geometric.planar_pose import planar_pose
from endolab.calibration.geometric.pose import Pose
from endolab.calibration.geometric.projection import (
    CAMERA_NAMES,
    Lens,
    camera_names,
    camera_of,
    camera_vector,
)
from endolab.calibration.geometric.reprojection import (
    Reprojection,
    View,
    check_agreement,
)
from endolab.calibration.least_squares import (
    Row,
    fit,
    hold_out,
    is_better,
    jackknife,
    list_rows,
)
from endolab.calibration.refusals import Doubt, Refusal
from endolab.calibration.targets import Target
from endolab.model.cameras import BrownConrady, KannalaBrandt
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.checks import unknown_name
from endolab.numerics.iteration import Status

LENSES = ("auto", "fisheye", "brown")


@dataclass(frozen=True, eq=False)
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
    sigma: float  # standard deviation of one coordinate, px; never below `FINEST`
    rmse: float  # root mean square distance of the inliers, px, as ``cv2`` counts it: √2 σ or so
    covariance: FloatArray  # (8, 8) or (12, 12), of fx, fy, cx, cy (px) and k
    max_angle_seen: float  # largest angle off the axis of an inlier, rad
    status: Status
    # Lens that was tried → root mean square error of views held out, px.
    held_out: dict[str, float] = field(default_factory=dict)
    doubts: tuple[Doubt, ...] = ()

    @property
    def standard_errors(self) -> dict[str, float]:
        """Of fx, fy, cx, cy (px) and k, by their names."""
        errors = np.sqrt(np.diag(self.covariance)).tolist()
        return dict(zip(camera_names(self.camera), errors, strict=True))

    def table(self) -> list[Row]:
        """Name, value, standard error and unit of what was found; of how well it fits, without error (nan).

        An error of inf is that of a number that the views do not tell.
        """
        names = camera_names(self.camera)
        values: dict[str, tuple[float, str]] = {
            name: (value, "" if name[0] in "kp" else "px")
            for name, value in zip(names, camera_vector(self.camera).tolist(), strict=True)
        }
        values["reprojection"] = self.rmse, "px"
        values |= {f"{lens}, held out": (off, "px") for lens, off in self.held_out.items()}
        values["seen to"] = float(np.rad2deg(self.max_angle_seen)), "°"
        return list_rows(values, self.standard_errors)

    @property
    def agreement(self) -> float:
        """Share of the points that count; below 0.95 or so, the lens is of another kind or the sheet bent."""
        return float(np.mean(np.concatenate(self.inliers)))


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
        Camera, poses, residuals and standard errors: how far the cameras of other views would be apart.

    Raises
    ------
    ValueError
        If the views cannot tell the camera: too few, none tilted, or a standard error that is
        too large; the sentence says what was found and what is needed.
    """
    if lens not in LENSES:
        raise unknown_name("lens", lens, LENSES)
    if start is not None:
        return _calibrate(views, target, start)[0]
    _refuse_few(len(views), {})
    fisheye, squares = _calibrate(views, target, _start(views, target, width, height))
    _refuse_untold(fisheye)
    is_wide = fisheye.max_angle_seen > 1.2  # rad
    if lens == "fisheye" or (lens == "auto" and is_wide):
        return fisheye
    found = fisheye.camera
    start = BrownConrady(width, height, found.fx, found.fy, found.cx, found.cy)
    brown, of_brown = _calibrate(views, target, start, fisheye.sigma)
    _refuse_untold(brown)
    if lens == "brown":
        return brown
    names = squares.keys() & of_brown.keys()
    theirs, others = (
        np.array([one[name] for name in names]) for one in (squares, of_brown)
    )
    best = brown if is_better(others, than=theirs) else fisheye
    alike = best is fisheye and not is_better(theirs, than=others)
    doubts = (Doubt.LENSES_ALIKE,) * alike
    return replace(best, held_out=fisheye.held_out | brown.held_out, doubts=doubts)


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
            poses.append(planar_pose(view.pixels, target.points[view.ids], camera))
            kept.append(view)
        except ValueError as error:
            dropped[_label(view, target)] = str(error)
    return kept, poses, dropped


def _start(views: Sequence[View], target: Target, width: int, height: int) -> KannalaBrandt:
    """Return the equidistant camera that explains a dozen of the views best, by its focal length."""
    some = views[:: -(-len(views) // 12)]
    best = np.inf
    for focal in width * np.geomspace(0.2, 3.0, 10):
        centre = (width - 1) / 2, (height - 1) / 2
        camera = KannalaBrandt(width, height, focal, focal, *centre)
        kept, poses, dropped = _first_poses(some, target, camera)
        misses = [np.inf] * len(dropped)
        for view, pose in zip(kept, poses, strict=True):
            off = camera.project(pose.transform(target.points[view.ids])) - view.pixels
            misses.append(float(np.nanmedian(np.linalg.norm(off, axis=1))))
        # The lower median: half of the views may be useless.
        miss = sorted(misses)[(len(some) - 1) // 2]
        if miss < best:
            best = miss
            start = camera
    Refusal.USELESS_VIEWS.if_(np.isinf(best), why=_reasons(dropped))
    return start


def _calibrate(
    views: Sequence[View], target: Target, start: Lens, sigma: float | None = None
) -> tuple[GeometricFit, dict[str, float]]:
    """Fit a camera of the kind of `start`, from linear poses.

    Views of which fewer than half the points agree are left out, until all agree. Returns mean squares of
    the frames held out, too, of which outliers are beyond 3.5 times `sigma`, that of the fit by default.
    """
    views, poses, dropped = _first_poses(views, target, start)
    camera = start
    good = [False]
    while not all(good):
        _refuse_few(len(views), dropped, least=1)
        begin = camera_vector(camera), np.array([pose.vector for pose in poses])
        model = Reprojection.of(views, target, start, free=9)
        fitted = fit(model, *begin)
        camera = camera_of(fitted.common, start.width, start.height)
        cuts = np.cumsum([len(view.ids) for view in views])[:-1]
        inliers = np.split(fitted.used, cuts)
        for view, used in zip(views, inliers, strict=True):
            try:
                check_agreement(used)
            except ValueError as why:
                dropped[_label(view, target)] = str(why)
        good = [_label(view, target) not in dropped for view in views]
        views = list(compress(views, good))
        poses = [Pose.of(vector) for vector in fitted.own[good]]
    frames = list(dict.fromkeys(view.name for view in views))
    frame = np.array([frames.index(view.name) for view in views])[model.group]
    squares, off = hold_out(model, fitted, frame, sigma or fitted.sigma)
    covariance, _ = jackknife(model, fitted, frame, model.sd)
    name = "fisheye" if isinstance(camera, KannalaBrandt) else "brown"
    found = GeometricFit(
        camera=camera,
        views=tuple(views),
        poses=tuple(poses),
        dropped=dropped,
        residuals=tuple(np.split(fitted.residual, cuts)),
        inliers=tuple(inliers),
        sigma=fitted.sigma,
        rmse=float(np.sqrt(np.mean(np.sum(fitted.residual[fitted.used] ** 2, axis=1)))),
        covariance=covariance,
        max_angle_seen=float(model.angles(fitted.own)[fitted.used].max()),
        status=fitted.status,
        held_out={name: off},
    )
    return found, dict(zip(frames, squares.tolist(), strict=True))


def _reasons(dropped: dict[str, str]) -> str:
    shown = "; ".join(f"{name}: {why}" for name, why in list(dropped.items())[:3])
    return shown + ("; …" if len(dropped) > 3 else "")


def _refuse_few(
    count: int, dropped: dict[str, str], least: int = constants.LEAST_VIEWS
) -> None:
    why = f" ({_reasons(dropped)})" if dropped else ""
    Refusal.FEW_VIEWS.if_(count < least, count=count, why=why)


def _refuse_untold(result: GeometricFit) -> None:
    """Refuse a camera that its views do not tell."""
    _refuse_few(len(result.views), result.dropped)
    # Places that differ by a degree, or by a fiftieth of the distance.
    places: list[FloatArray] = []
    for pose in result.poses:
        far = np.linalg.norm(pose.translation)
        place = np.append(pose.rotation * far / np.sqrt(2), pose.translation)
        if all(np.linalg.norm(place - other) > 0.02 * far for other in places):
            places.append(place)
    still = len(places) < constants.LEAST_VIEWS
    Refusal.STILL.if_(still, count=len(places), views=len(result.poses))
    tilt = np.degrees(max(pose.tilt for pose in result.poses))
    Refusal.SQUARE.if_(tilt < 5, tilt=tilt)
    facts = {"tilt": tilt, "seen": np.degrees(result.max_angle_seen)}
    for name in CAMERA_NAMES[:4]:
        error = result.standard_errors[name]
        is_sure = error < 0.05 * result.camera.fx
        Refusal.UNSURE_CAMERA.if_(not is_sure, name=name, error=error, **facts)
