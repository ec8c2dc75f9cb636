"""What came of a calibration, in numbers and in words: the evidence of `endoscope.json`, a summary."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from endolab.calibration.geometric.fit import GeometricFit
from endolab.calibration.geometric.projection import CAMERA_NAMES, camera_vector
from endolab.calibration.photometric.result import PhotometricFit
from endolab.calibration.photometric.samples import Samples
from endolab.calibration.session import Session, describe_target
from endolab.calibration.uncertainty import (
    fall_off_uncertainty,
    ray_uncertainty,
    values_within,
)
from endolab.model.brdf import TabulatedBRDF
from endolab.model.cameras import Camera, KannalaBrandt
from endolab.numerics.arrays import FloatArray, IntArray

LEAST_SCORED = 10  # samples of a bin of the held-out frames that are worth a word


# Facts ----------------------------------------------------------------------------------
def _plain(facts: dict[str, Any]) -> dict[str, Any]:
    """Make JSON of anything numerical; what is not finite becomes null."""
    text = json.dumps(facts, default=lambda array: array.tolist())
    plain: dict[str, Any] = json.loads(text, parse_constant=lambda name: None)
    return plain


def _accuracy_within(values: FloatArray, camera: Camera, seen: float) -> dict[str, float]:
    """Median and largest of a map at `places`, of what lies within an angle off the axis, rad."""
    inside = values_within(values, camera, seen)
    return (
        {"median": float(np.median(inside)), "largest": float(inside.max())}
        if inside.size
        else {}
    )


def _camera_facts(geometry: GeometricFit) -> dict[str, Any]:
    seen = geometry.max_angle_seen
    good = np.concatenate(geometry.inliers)
    rays = ray_uncertainty(geometry.camera, geometry.covariance, max_angle=seen)
    return {
        "rmse_px": geometry.rmse,
        "sigma_px": geometry.sigma,
        "standard_errors": geometry.standard_errors,
        "rays_mrad": _accuracy_within(rays.mrad_shape, geometry.camera, seen),
        "rays_turn_mrad": rays.mrad_turn,
        "views": len(geometry.views),
        "views_dropped": geometry.dropped,
        "points": int(good.sum()),
        "outliers": int(np.sum(~good)),
        "max_angle_deg": np.rad2deg(seen),
        "status": geometry.status.value,
    }


def _light_facts(light: PhotometricFit, session: Session, channel: str) -> dict[str, Any]:
    names = [list(session.poses)[frame] for frame in light.frames]
    scores = session.scores
    fall_off = fall_off_uncertainty(light, session.camera)
    held_out = scores and {
        "edges_deg": np.rad2deg(scores.edges),
        "error": scores.error,
        "standard_error": scores.standard_error,
        "samples": scores.count,
        "sigma_grey": scores.sigma,
    }
    return {
        "standard_errors": light.standard_errors,
        "fall_off_percent": _accuracy_within(
            fall_off, session.camera, light.alpha_range[1]
        ),
        "k/gamma": light.ratio,
        "correlation": {"names": light.names, "matrix": light.correlation},
        "reflectance": light.reflectance,
        "sigma_grey": light.sigma,
        "mean_grey": light.mean,
        "samples": int(light.used.sum()),
        "samples_left_out": int(np.sum(~light.used)),
        "alpha_range_deg": np.rad2deg(light.alpha_range),
        "theta_range_deg": np.rad2deg(light.theta_range),
        "distance_range_mm": light.distance_range,
        "verdict": light.verdict,
        "status": light.status.value,
        "gains": dict(zip(names, light.gains, strict=True)),
        "gain_errors": dict(zip(names, light.gain_errors, strict=True)),
        "held_out": held_out,
        "channel": channel,
        "brdf_of": "the calibration sheet",
    }


def evidence(session: Session, source: str = "", channel: str = "grey") -> dict[str, Any]:
    """Return all that is known of a calibration beside its result, fit for JSON: null for what is not finite.

    Angles are in degrees where the key says so. "camera" is null if it was given; "photometry" holds
    nothing but "refused" and that it is "nominal" if the samples could not tell it. `source`: where the
    frames came from.
    """
    target = session.target
    light = session.light
    refused = {"refused": session.refused, "nominal": True}
    detected = sum(len(detection.ids) > 0 for detection in session.detections.values())
    return _plain(
        {
            "source": source,
            "target": {"description": describe_target(target), "kind": target.kind}
            | asdict(target),
            "camera": session.geometry and _camera_facts(session.geometry),
            "photometry": _light_facts(light, session, channel) if light else refused,
            "frames": {
                "searched": len(session.detections),
                "found": detected,
                "used": list(session.poses),
                "dropped": session.dropped,
                "errors_px": session.errors,
                "errors_grey": light_errors(session),
            },
        }
    )


# In words -------------------------------------------------------------------------------
def _digits(error: float) -> int:
    """Decimals at which a standard error has two digits."""
    return int(max(0, 1 - np.floor(np.log10(error)))) if 0 < error < np.inf else 0


def plus_minus(value: float, error: float) -> str:
    """Write a value and its standard error with as many digits as the error is good for."""
    if error == 0:
        return f"{value:.6g} (given)"
    if not np.isfinite(error):
        return f"{value:.6g} ± ?"
    return f"{value:.{_digits(error)}f} ± {error:.{_digits(error)}f}"


def by_reason(dropped: Mapping[str, str]) -> list[str]:
    """Say which frames were dropped and why, one line a reason, most frequent first."""
    groups: dict[str, list[str]] = {}
    for name, reason in dropped.items():
        groups.setdefault(reason, []).append(name)
    lines = []
    for reason, names in sorted(groups.items(), key=lambda group: -len(group[1])):
        first = names[:8]
        rest = len(names) - len(first)
        more = f" and {rest} more" if rest else ""
        lines.append(f"{len(names)}: {reason} ({', '.join(first)}{more})")
    return lines


def camera_values(session: Session) -> list[tuple[str, float, float, str]]:
    """Name, value, standard error and unit of the camera's numbers."""
    camera = session.camera
    geometry = session.geometry
    if geometry is None or not isinstance(camera, KannalaBrandt):
        return []
    errors = geometry.standard_errors
    values = camera_vector(camera).tolist()
    return [
        (n, v, errors[n], "" if n[0] == "k" else "px")
        for n, v in zip(CAMERA_NAMES, values, strict=True)
    ]


def light_values(light: PhotometricFit) -> list[tuple[str, float, float, str]]:
    """Name, value, standard error and unit of the light's numbers."""
    errors = light.standard_errors
    values = {"k": light.k, "gamma": light.photometry.gamma, "k/gamma": light.ratio}
    values |= {f"reflectance {m}": float(a) for m, a in enumerate(light.reflectance) if m}
    return [
        (name.replace("gamma", "γ"), value, errors[name], "")
        for name, value in values.items()
    ]


def _accuracy_line(what: str, known: Mapping[str, float], unit: str, to: float) -> str:
    """Say how well a map of the picture is known within `to` degrees off the axis."""
    if not known:
        return f"{what}: not told by these frames"
    median, worst = (
        f"{float(f'{known[name]:.2g}'):g} {unit}" for name in ("median", "largest")
    )
    return (
        f"σ of {what}: {median} in the median, {worst} at worst, to {to:.0f}° off the axis"
    )


def _camera_lines(session: Session) -> list[str]:
    geometry = session.geometry
    if geometry is None:
        return [f"camera: as given, {session.camera.model}"]
    rows = [
        f"{name} {plus_minus(value, error)}"
        for name, value, error, _ in camera_values(session)
    ]
    facts = _camera_facts(geometry)
    seen = facts["max_angle_deg"]
    lines = [
        f"camera: {', '.join(rows[:4])} px",
        f"        {', '.join(rows[4:])}",
        f"reprojection: RMSE {geometry.rmse:.3f} px of {facts['points']} points "
        f"in {count_of(facts['views'], 'view')}, {count_of(facts['outliers'], 'outlier')}; "
        f"seen to {seen:.0f}° off the axis",
        _accuracy_line("a ray", facts["rays_mrad"], "mrad", seen),
    ]
    if facts["rays_mrad"]:
        lines[-1] += (
            f"; beside a turn of {facts['rays_turn_mrad']:.2g} mrad that all rays share"
        )
    if geometry.agreement < 0.85:
        why = "the lens is of another kind, or the sheet was not flat"
        lines.append(
            f"  only {100 * geometry.agreement:.0f} % of the points agree with this camera: {why}"
        )
    if geometry.dropped:
        lines.append(f"left out of the camera: {count_of(len(geometry.dropped), 'view')}")
        lines += [f"  {line}" for line in by_reason(geometry.dropped)]
    return lines


def _light_lines(session: Session) -> list[str]:
    light = session.light
    scores = session.scores
    if light is None:
        return [f"light: refused: {session.refused}"]
    values = light_values(light)
    rows = [
        f"{name} = {plus_minus(value, error)} {unit}".rstrip()
        for name, value, error, unit in values
    ]
    facts = _light_facts(light, session, "")
    nearest, farthest = light.distance_range
    lines = [
        f"light: {', '.join(rows)}",
        f"residuals: {light.sigma:.2f} grey levels, of {count_of(facts['samples'], 'sample')}, "
        f"{nearest:.0f} to {farthest:.0f} mm away; {facts['samples_left_out']} left out",
        _accuracy_line(
            "the fall-off μ′", facts["fall_off_percent"], "%", facts["alpha_range_deg"][1]
        ),
    ]
    known = scores is not None and scores.count >= LEAST_SCORED
    if scores is not None and np.any(known):
        worst = 100 * np.abs(scores.error[known]).max()
        to = np.rad2deg(scores.edges[1:][known].max())
        agreement = (
            f"their light is as predicted within {worst:.2g} %, to {to:.0f}° off the axis"
        )
        lines.append(f"frames held out: {agreement}")
    return lines + light.verdict


def account(session: Session) -> list[str]:
    """Sum a calibration up, in lines to print."""
    detected = sum(len(detection.ids) > 0 for detection in session.detections.values())
    located = f"located in {len(session.poses)}; {len(session.dropped)} dropped"
    lines = [
        f"{count_of(len(session.detections), 'frame')}: the target was found in {detected} and {located}"
    ]
    lines += [f"  {line}" for line in by_reason(session.dropped)]
    return lines + _camera_lines(session) + _light_lines(session)


def light_errors(session: Session) -> dict[str, float]:
    """Root mean square residual of the samples that counted in each frame, grey levels; nan without any."""
    light = session.light
    frame = session.samples.frame
    if light is None:
        return {}
    counts = np.bincount(frame, light.used, len(session.poses))
    squares = np.bincount(frame, light.used * light.residuals**2, len(session.poses))
    with np.errstate(invalid="ignore"):
        return dict(zip(session.poses, np.sqrt(squares / counts).tolist(), strict=True))


def mean_distances(samples: Samples, frames: IntArray) -> FloatArray:
    """Mean distance of the samples of each of `frames`, mm; nan where there are none."""
    size = int(max(samples.frame.max(initial=0), frames.max(initial=0))) + 1
    total = np.bincount(samples.frame, samples.distance, size)
    count = np.bincount(samples.frame, minlength=size)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)[frames]


def count_of(number: int, what: str) -> str:
    """Say how many there are of something."""
    return f"{number} {what}" + ("" if number == 1 else "s")


def brdf_of(light: PhotometricFit) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the BRDF's nodes θ, rad, its values relative to the node that is not fitted, their errors.

    Two nodes of 1 ± 0 at the ends of the range if the surface was taken to be matt.
    """
    brdf = light.photometry.brdf
    if not isinstance(brdf, TabulatedBRDF):
        return np.array(light.theta_range), np.ones(2), np.zeros(2)
    values = np.array(brdf.values)
    errors = np.array(
        [light.standard_errors[f"brdf {node}"] for node in range(len(values))]
    )
    pinned = values[np.argmin(errors)]
    return np.array(brdf.theta), values / pinned, errors / pinned
