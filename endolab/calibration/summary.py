"""What came of a calibration, in numbers and in words: the evidence of `endoscope.json`, a summary."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from endolab.calibration.geometric.fit import GeometricFit
from endolab.calibration.photometric.result import PhotometricFit
from endolab.calibration.photometric.samples import Samples
from endolab.calibration.session import Session, describe_target
from endolab.calibration.uncertainty import (
    fall_off_uncertainty,
    ray_uncertainty,
    values_within,
)
from endolab.model.brdf import TabulatedBRDF
from endolab.model.cameras import Camera
from endolab.numerics.arrays import FloatArray, IntArray, nan_if_undefined

LEAST_SCORED = 10  # samples of a bin of the held-out frames that are worth a word
# Share of the points that agree with a camera which suits its lens; of simulated ones, all but 2 to 8 %.
LEAST_AGREEMENT = 0.85


# Facts ----------------------------------------------------------------------------------
def _plain(facts: dict[str, Any]) -> dict[str, Any]:
    """Make JSON of anything numerical; what is not finite becomes null."""
    text = json.dumps(facts, default=lambda array: array.tolist())
    plain: dict[str, Any] = json.loads(text, parse_constant=lambda name: None)
    return plain


def _accuracy_within(values: FloatArray, camera: Camera, seen: float) -> dict[str, float]:
    """Median and largest of a map at `places`, of what lies within an angle off the axis, rad."""
    inside = values_within(values, camera, seen)
    if not inside.size:
        return {}
    return {"median": float(np.median(inside)), "largest": float(inside.max())}


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
        "held_out_px": geometry.held_out,
        "status": geometry.status.value,
    }


def _light_facts(
    light: PhotometricFit,
    session: Session,
    channel: str,
) -> dict[str, Any]:
    names = np.array(list(session.poses))[light.frames].tolist()
    scores = session.scores
    fall_off = fall_off_uncertainty(light, session.camera)
    widest = light.alpha_range[1]
    held_out = scores and {
        "edges_deg": np.rad2deg(scores.edges),
        "error": scores.error,
        "standard_error": scores.standard_error,
        "samples": scores.count,
        "sigma_grey": scores.sigma,
    }
    return {
        "standard_errors": light.standard_errors,
        "fall_off_percent": _accuracy_within(fall_off, session.camera, widest),
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


def evidence(
    session: Session,
    source: str = "",
    channel: str = "grey",
) -> dict[str, Any]:
    """Return all that is known of a calibration beside its result, fit for JSON: null for what is not finite.

    Angles are in degrees where the key says so. "camera" is null if it was given; "photometry" holds
    nothing but "refused" and that it is "nominal" if the samples could not tell it. `source`: where the
    frames came from.
    """
    target = session.target
    light = session.light
    sheet = {"description": describe_target(target), "kind": target.kind}
    refused = {"refused": session.refused, "nominal": True}
    frames = {
        "searched": len(session.detections),
        "found": _count_detected(session),
        "used": list(session.poses),
        "dropped": session.dropped,
        "errors_px": session.errors,
        "errors_grey": light_errors(session),
    }
    return _plain(
        {
            "source": source,
            "table": [
                {"name": name, "value": value, "error": error, "unit": unit}
                for name, value, error, unit in session.table()
            ],
            "target": sheet | asdict(target),
            "camera": session.geometry and _camera_facts(session.geometry),
            "photometry": _light_facts(light, session, channel) if light else refused,
            "frames": frames,
        }
    )


def _count_detected(session: Session) -> int:
    return sum(len(detection.ids) > 0 for detection in session.detections.values())


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
        first = ", ".join(names[:8])
        more = f" and {len(names) - 8} more" if len(names) > 8 else ""
        lines.append(f"{len(names)}: {reason} ({first}{more})")
    return lines


def symbol_of(name: str) -> str:
    """Write the name of one of the light's unknowns as pages do: γ, and f3 for the BRDF's node 3."""
    return name.replace("gamma", "γ").replace("brdf ", "f")


def table_lines(session: Session) -> list[str]:
    """Write the numbers that were found one a line, each with its standard error."""
    return [
        f"  {symbol_of(name):14} {plus_minus(value, error)} {unit}".rstrip()
        for name, value, error, unit in session.table()
    ]


def verdict(session: Session) -> str:
    """Say in one sentence whether a calibration can be used, and how sure its numbers are."""
    geometry = session.geometry
    light = session.light
    rows = {name: plus_minus(value, error) for name, value, error, _ in session.table()}
    camera = "the camera was given"
    if geometry is not None:
        camera = f"the camera fits to {geometry.rmse:.2g} px (fx = {rows['fx']} px)"
        if geometry.agreement < LEAST_AGREEMENT:
            agree = f"{100 * geometry.agreement:.0f} % of the points"
            return f"Do not use it: only {agree} agree with the camera."
    if light is None:
        return f"Use the camera alone: {camera}, and the light could not be told."
    fits = (
        f"the light to {light.sigma:.2g} grey levels (k = {rows['k']}, γ = {rows['gamma']})"
    )
    return f"It can be used: {camera}, and {fits}."


def _accuracy_line(
    what: str,
    known: Mapping[str, float],
    unit: str,
    to: float,
) -> str:
    """Say how well a map of the picture is known within `to` degrees off the axis."""
    if not known:
        return f"{what}: not told by these frames"
    median, worst = (f"{float(f'{value:.2g}'):g} {unit}" for value in known.values())
    return (
        f"σ of {what}: {median} in the median, {worst} at worst, to {to:.0f}° off the axis"
    )


def _camera_lines(session: Session) -> list[str]:
    geometry = session.geometry
    if geometry is None:
        return [f"camera: as given, {session.camera.model}"]
    facts = _camera_facts(geometry)
    seen = facts["max_angle_deg"]
    lines = [
        f"reprojection: RMSE {geometry.rmse:.3f} px of {facts['points']} points "
        f"in {count_of(facts['views'], 'view')}, {count_of(facts['outliers'], 'outlier')}; "
        f"seen to {seen:.0f}° off the axis",
        _accuracy_line("a ray", facts["rays_mrad"], "mrad", seen),
    ]
    if geometry.held_out:
        tried = (f"{name} {error:.3f} px" for name, error in geometry.held_out.items())
        lines.insert(
            0,
            f"lens: {session.camera.model}, by the error of views held out: {', '.join(tried)}",
        )
    if facts["rays_mrad"]:
        lines[-1] += (
            f"; beside a turn of {facts['rays_turn_mrad']:.2g} mrad that all rays share"
        )
    if geometry.agreement < LEAST_AGREEMENT:
        lines.append(
            f"  only {100 * geometry.agreement:.0f} % of the points agree with this camera: "
            "the lens is of another kind, or the sheet was not flat"
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
    facts = _light_facts(light, session, "")
    nearest, farthest = light.distance_range
    lines = [
        f"residuals: {light.sigma:.2f} grey levels, of {count_of(facts['samples'], 'sample')}, "
        f"{nearest:.0f} to {farthest:.0f} mm away; {facts['samples_left_out']} left out",
        _accuracy_line(
            "the fall-off μ′", facts["fall_off_percent"], "%", facts["alpha_range_deg"][1]
        ),
    ]
    if scores is not None and scores.count.max() >= LEAST_SCORED:
        known = scores.count >= LEAST_SCORED
        worst = 100 * np.abs(scores.error[known]).max()
        to = np.rad2deg(scores.edges[1:][known].max())
        lines.append(
            f"frames held out: their light is as predicted within {worst:.2g} %, "
            f"to {to:.0f}° off the axis"
        )
    return lines + light.verdict


def account(session: Session) -> list[str]:
    """Sum a calibration up, in lines to print."""
    first = (
        f"{count_of(len(session.detections), 'frame')}: the target was found in "
        f"{_count_detected(session)} and located in {len(session.poses)}; "
        f"{len(session.dropped)} dropped"
    )
    dropped = [f"  {line}" for line in by_reason(session.dropped)]
    sheet = f"the target: {describe_target(session.target)}"
    lines = [*_camera_lines(session), *table_lines(session), *_light_lines(session)]
    return [sheet, first, *dropped, *lines]


def light_errors(session: Session) -> dict[str, float]:
    """Root mean square residual of the samples that counted in each frame, grey levels; nan without any."""
    light = session.light
    if light is None:
        return {}
    frame = session.samples.frame[light.used]
    squares = light.residuals[light.used] ** 2
    errors = np.sqrt(_means(squares, frame, len(session.poses)))
    return dict(zip(session.poses, errors.tolist(), strict=True))


def mean_distances(samples: Samples, frames: IntArray) -> FloatArray:
    """Mean distance of the samples of each of `frames`, mm; nan where there are none."""
    size = int(frames.max(initial=0)) + 1
    return _means(samples.distance, samples.frame, size)[frames]


def _means(
    values: FloatArray,
    group: IntArray,
    least: int,
) -> FloatArray:
    """Mean of the values of each group, of which there are `least` or more; nan where there are none."""
    with nan_if_undefined():
        return np.bincount(group, values, least) / np.bincount(group, minlength=least)


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
    names = [f"brdf {node}" for node in range(len(values))]
    errors = np.array([light.standard_errors[name] for name in names])
    pinned = values[np.argmin(errors)]
    return np.array(brdf.theta), values / pinned, errors / pinned
