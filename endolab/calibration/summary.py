"""What came of a calibration: the evidence of `endoscope.json`, and lines to print."""

import json
from dataclasses import asdict
from typing import Any

import numpy as np
import scipy

from endolab.calibration.photometric.samples import Samples
from endolab.calibration.session import Session, by_reason, describe_target
from endolab.numerics.arrays import FloatArray, IntArray, nan_if_undefined


def evidence(session: Session, source: str = "", channel: str = "grey") -> dict[str, Any]:
    """Return all that is known of a calibration beside its result, fit for JSON: null for what is not finite.

    "camera" is empty if it was given; "photometry" holds nothing but "refused" and that it is "nominal" if
    the samples could not tell it. `source`: where the frames came from.
    """
    target = session.target
    light = session.light
    geometry = session.geometry
    row = ("name", "value", "error", "unit")
    camera: dict[str, Any] = {}
    if geometry is not None:
        good = np.concatenate(geometry.inliers)
        camera = {
            "views": len(geometry.views),
            "views_dropped": geometry.dropped,
            "points": good.sum(),
            "outliers": np.sum(~good),
        }
    photometry = {"refused": session.refused, "nominal": True}
    if light is not None:
        names = np.array(list(session.poses))[light.frames].tolist()
        photometry = {
            "standard_errors": light.standard_errors,
            "correlation": {"names": light.names, "matrix": light.correlation},
            "samples": light.used.sum(),
            "alpha_range_deg": np.rad2deg(light.alpha_range),
            "theta_range_deg": np.rad2deg(light.theta_range),
            "gains": dict(zip(names, light.gains, strict=True)),
            "gain_errors": dict(zip(names, light.gain_errors, strict=True)),
            "errors_by_angle": asdict(light.errors_by_angle(session.samples)),
        }
    facts = {
        "source": source,
        "channel": channel,
        "verdict": session.verdict.value,
        "remarks": session.remarks,
        "table": [dict(zip(row, values, strict=True)) for values in session.table()],
        "target": {"description": describe_target(target), **asdict(target)},
        "camera": camera,
        "photometry": photometry,
        "frames": {
            "searched": len(session.detections),
            "used": list(session.poses),
            "dropped": session.dropped,
            "errors_px": session.errors,
            "errors_grey": light_errors(session),
        },
    }
    text = json.dumps(facts, default=lambda array: array.tolist())
    plain: dict[str, Any] = json.loads(text, parse_constant=lambda name: None)
    return plain


# In words -------------------------------------------------------------------------------
def plus_minus(value: float, error: float) -> str:
    """Write a value and its standard error with as many digits as the error is good for."""
    if np.isnan(error):
        return f"{value:.3g}"
    if error == 0:
        return f"{value:.6g} (given)"
    if np.isinf(error):
        return f"{value:.6g} ± ?"
    digits = int(max(0, 1 - np.floor(np.log10(error))))
    return f"{value:.{digits}f} ± {error:.{digits}f}"


def account(session: Session) -> list[str]:
    """Sum a calibration up, in lines to print."""
    lines = [
        session.verdict.value,
        f"the target: {describe_target(session.target)}",
        f"located in {len(session.poses)} of {count_of(len(session.detections), 'frame')}",
        *by_reason(session.dropped),
    ]
    if session.geometry is not None and session.geometry.dropped:
        lines += ["left out of the camera:", *by_reason(session.geometry.dropped)]
    lines += [
        f"  {name:24} {plus_minus(value, error)} {unit}".rstrip()
        for name, value, error, unit in session.table()
    ]
    if session.light is None:
        lines.append(f"light: refused: {session.refused}")
    return lines + session.remarks


def count_of(number: int, what: str) -> str:
    """Say how many there are of something."""
    return f"{number} {what}" + ("" if number == 1 else "s")


# Of frames ------------------------------------------------------------------------------
def light_errors(session: Session) -> dict[str, float]:
    """Root mean square residual of the samples that counted in each frame, grey levels; nan without any."""
    light = session.light
    if light is None:
        return {}
    squares = light.residuals[light.used] ** 2
    numbers = np.arange(len(session.poses))
    errors = np.sqrt(_means(squares, session.samples.frame[light.used], numbers))
    return dict(zip(session.poses, errors.tolist(), strict=True))


def mean_distances(samples: Samples, frames: IntArray) -> FloatArray:
    """Mean distance of the samples of each of `frames`, mm; nan where there are none."""
    return _means(samples.distance, samples.frame, frames)


def _means(values: FloatArray, of: IntArray, frames: IntArray) -> FloatArray:
    with nan_if_undefined():
        return np.asarray(scipy.ndimage.mean(values, of, frames))
