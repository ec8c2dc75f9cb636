"""From the folder of a calibration's report back to the calibration itself."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from endolab.calibration.session import Session, calibrate, detect_all
from endolab.calibration.targets import Target
from endolab.io.atomic import PathLike, read_bytes
from endolab.io.descriptions import KINDS, Calibration, read_camera
from endolab.io.detection_cache import DetectionCache
from endolab.io.video import Frames, open_frames
from endolab.model.cameras import KannalaBrandt


def session_of_report(folder: PathLike) -> tuple[Session, Frames, dict[str, Any]]:
    """Calibrate again what a report is of, from what was detected then; nothing is written.

    Returns the session, its frames, which must still be where they were, and the options of the light's fit.
    ValueError or OSError, in one sentence, if the folder holds no report or its frames are gone.
    """
    place = Path(folder)
    try:
        facts = json.loads(read_bytes(place / "report.json", "report of a calibration"))
        source, target = facts["source"], _target(facts["target"])
        light, camera = _options(facts["photometry"], place), facts["camera"]
        channel = facts["photometry"].get("channel", "grey")
        searched = {*facts["frames"]["used"], *facts["frames"]["dropped"]}
    except (KeyError, TypeError, AttributeError, RecursionError, json.JSONDecodeError) as error:
        raise ValueError(f"{place / 'report.json'}: not the report of a calibration") from error
    frames = open_frames(source)
    frames = Frames(frames.path, tuple(name for name in frames.names if name in searched))
    if not len(frames):
        raise ValueError(f"{source}: holds none of the frames that {place} reports on")
    known = DetectionCache(place / "detections.jsonl", frames, target)
    missing = [name for name in frames.names if name not in known.known]
    found, size = detect_all(frames.read(missing), target, size=known.size)
    every = known.known | found
    given = None
    if camera is None:
        given = read_camera(place / "camera.json")
        if not isinstance(given, KannalaBrandt):
            raise ValueError(f"{place / 'camera.json'}: expected kannala_brandt, found {given.model}")
    detections = {name: every[name] for name in frames.names}
    how: dict[str, Any] = {"camera": given, "detections": detections, "size": size, "channel": channel}
    return calibrate(frames, target, **how, **light), frames, light


def _target(told: Mapping[str, Any]) -> Target:
    """Make the target that a report describes."""
    values = {key: value for key, value in told.items() if key not in ("kind", "description")}
    return KINDS[told["kind"]](**values)


def _options(facts: Mapping[str, Any], place: Path) -> dict[str, Any]:
    """Tell how the light was fitted, as far as it shows; the γ that was given stands in the calibration."""
    if "refused" in facts:
        return {}
    names, gains = facts["correlation"]["names"], set(facts["gains"].values())
    reflectance = [
        None if f"reflectance {m}" in names else value for m, value in enumerate(facts["reflectance"]) if m
    ]
    options: dict[str, Any] = {
        "gain": "locked" if len(gains) == 1 and len(facts["gains"]) > 1 else "free",
        "brdf": "tabulated" if any(name.startswith("brdf") for name in names) else "lambertian",
        "light": "free" if "light x" in names else "centred",
        "reflectance": reflectance,
    }
    if "gamma" in names:
        return options | {"gamma": "free"}
    calibration = place.with_name(place.name.removesuffix("_report") + ".json")
    return options | (
        {"gamma": Calibration.load(calibration).photometry.gamma} if calibration.is_file() else {}
    )
