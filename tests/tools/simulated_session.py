"""A calibration session without pictures to search: real fits of simulated detections and samples."""

from dataclasses import replace
from functools import cache

import numpy as np

import endolab as el
from endolab.calibration.detection.detect import Detection
from endolab.calibration.photometric.fit import calibrate_light
from endolab.calibration.simulation.trajectory import trajectory
from endolab.calibration.simulation.video import PAPER_SHEET, simulate_samples
from tests.tools.sheet_views import centroids_on_panels

# frames that were located; px
COUNT = 20
NOISE = 0.05
LOST = ("frame_3", "frame_9")  # in one nothing is found, in the other no pose


@cache
def simulated(name="vicalib_small", **light):
    """Return a session and its frames."""
    target = el.TARGETS[name]
    camera = el.load_calibration("paper", width=160).camera
    fold = np.deg2rad(30) if target.fold else 0.0
    how = {"fold": fold, "distance": (30.0, 60.0), "seed": 1}
    samples, _ = simulate_samples(
        target, camera, el.Photometry(brdf=PAPER_SHEET), COUNT, per_frame=60, **how
    )
    rng = np.random.default_rng(0)
    true = iter(trajectory(target, camera, COUNT, **how))
    names = [f"frame_{number}" for number in range(COUNT + len(LOST))]
    few = Detection(np.arange(5), rng.uniform(20, 100, (5, 2)))
    nothing = Detection(few.ids[:0], few.pixels[:0], "too dark")
    lost = dict(zip(LOST, (nothing, few), strict=True))
    detections = {}
    for name in names:
        if name in LOST:
            detections[name] = lost[name]
            continue
        pixels = centroids_on_panels(camera, target, next(true))
        inside = np.flatnonzero(((pixels >= 0) & (pixels <= [159, 119])).all(axis=1))
        error = NOISE * rng.standard_normal((len(inside), 2))
        error[rng.random(len(inside)) < 0.03] *= 30
        detections[name] = Detection(inside, pixels[inside] + error)
    pictures = [(name, rng.uniform(0, 1, (120, 160))) for name in names]
    how = {"detections": detections, "size": (160, 120), "every": 1}
    session = el.calibrate(pictures, target, lens="fisheye", **how)
    lit = {
        "light": calibrate_light(samples, **light),
        "samples": samples,
    }
    return replace(session, refused="", **lit), pictures


def refused(session):
    """Return the session as if the light could not be told."""
    reason = "γ cannot be told from <one> flat sheet & free gains"
    return replace(session, light=None, refused=reason)
