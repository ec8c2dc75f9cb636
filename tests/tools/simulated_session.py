"""A calibration session without pictures to search: detections, poses and samples as simulated."""

from dataclasses import replace
from functools import cache

import numpy as np

import endolab as el
from endolab import datasets
from endolab.calibration.detection.detect import Detection
from endolab.calibration.geometric.fit import GeometricFit
from endolab.calibration.geometric.projection import NAMES, predict_view
from endolab.calibration.geometric.reprojection import views_of
from endolab.calibration.session import Session, score
from endolab.calibration.simulation.trajectory import trajectory
from endolab.calibration.simulation.video import PAPER_SHEET, simulate_samples

COUNT, NOISE = 20, 0.05  # frames that were located; px
LOST = ("frame_3", "frame_9")  # in one nothing is found, in the other no pose


@cache
def simulated(name="vicalib_small", **light):
    """Return a session, its frames and the steps of the light's fit."""
    target, camera = el.TARGETS[name], datasets.load_calibration("paper", width=160).camera
    fold = np.deg2rad(30) if target.fold else 0.0
    how = {"fold": fold, "distance": (30.0, 60.0), "seed": 1}
    poses = trajectory(target, camera, COUNT, **how)
    samples, _ = simulate_samples(target, camera, el.Photometry(brdf=PAPER_SHEET), COUNT, per_frame=60, **how)
    rng = np.random.default_rng(0)
    names = [f"frame_{number}" for number in range(COUNT + len(LOST))]
    located = [name for name in names if name not in LOST]
    detections, views, residuals, inliers = {}, [], [], []
    panel = target.panel_of(target.points)
    for name in names:
        if name in LOST:
            few, reason = (5, "") if name == LOST[1] else (0, "too dark")
            detections[name] = Detection(np.arange(few), rng.uniform(20, 100, (few, 2)), reason)
            continue
        exact = np.empty((len(target.points), 2))
        for number, pose in enumerate(poses[located.index(name)]):
            here = panel == number
            exact[here] = predict_view(camera, pose, target.points[here], target.radii[here])
        inside = np.flatnonzero(((exact >= 0) & (exact <= [159, 119])).all(axis=1))
        error = NOISE * rng.standard_normal(exact.shape)
        wild = rng.random(len(exact)) < 0.03
        error[wild] *= 30
        detections[name] = Detection(inside, (exact + error)[inside])
        for view in views_of(name, detections[name], target):
            views.append(view)
            residuals.append(error[view.ids])
            inliers.append(~wild[view.ids])
    seen = np.concatenate([view.pixels[good] for view, good in zip(views, inliers, strict=True)])
    geometry = GeometricFit(
        camera=camera,
        views=tuple(views),
        poses=tuple(poses[located.index(view.name)][view.panel] for view in views),
        dropped={"frame_5": "its points are mirrored"},
        residuals=tuple(residuals),
        inliers=tuple(inliers),
        sigma=NOISE,
        rmse=NOISE * np.sqrt(2),
        standard_errors=dict.fromkeys(NAMES, 0.012),
        covariance=0.012**2 * np.eye(8),
        pose_covariances=np.zeros((len(views), 6, 6)),
        max_angle_seen=float(np.nanmax(np.arccos(camera.unproject(seen)[:, 2]))),
        status=el.Status.CONVERGED,
    )
    steps = []
    light = {"gamma": 2.2, **light}
    session = Session(
        target=target,
        detections=detections,
        geometry=geometry,
        camera=camera,
        poses=dict(zip(located, poses, strict=True)),
        samples=samples,
        light=el.calibrate_light(samples, observers=[steps.append], **light),
        scores=score(samples, **light),
        dropped={LOST[0]: "too dark", LOST[1]: "too few points"},
    )
    frames = [(name, rng.uniform(0, 1, (120, 160))) for name in names]
    return session, frames, steps


def refused(session):
    """Return the session as if the light could not be told."""
    said = "γ cannot be told from <one> flat sheet & free gains"
    return replace(session, light=None, scores=None, refused=said)
