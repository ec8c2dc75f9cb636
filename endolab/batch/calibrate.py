"""Frames of a target in, endoscope.json and its report out; a call that was cut off goes on where it was."""

from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

from endolab._extras import need
from endolab.calibration.least_squares import FitIterate
from endolab.calibration.session import Progress, Session, calibrate, silent
from endolab.calibration.targets import Target
from endolab.io.atomic import PathLike, staged_folder
from endolab.io.descriptions import make_calibration
from endolab.io.detection_cache import detect_cached
from endolab.io.video import Frames
from endolab.reports.calibration_page import REPORT, write_report

CALIBRATION = "endoscope.json"  # what the report's folder knows CAL.json by


def report_folder(out: PathLike) -> Path:
    """Name the folder that goes with a calibration: CAL_report beside CAL.json."""
    path = Path(out)
    if path.suffix != ".json":
        raise ValueError(f"the calibration's name ends in .json, got {path.name}")
    return path.with_name(f"{path.stem}_report")


def calibrate_to_files(
    frames: Frames,
    target: Target,
    out: PathLike,
    *,
    channel: str = "grey",
    record: bool = False,
    overwrite: bool = False,
    inputs: Collection[PathLike | None] = (),
    progress: Progress = silent,
    say: Callable[[str], None] | None = None,
    **options: Any,
) -> Session:
    """Calibrate an endoscope from frames of a target; write its file and a folder with the report.

    `out` is `endoscope.json`, not written if the light was refused. Beside it, in `report_folder`, are
    what was detected (kept between calls), the page, `camera.json` and, with `record`, a recording for
    the Rerun viewer. Files that endolab did not write, or that were changed since, are replaced only if
    `overwrite`; the frames and `inputs`, what else was read for this, never. `say` is told, in a sentence,
    what an earlier call had done; the rest, camera, every and the light's options, is as for `calibrate`.
    Raises `MissingPackage` at once if a recording is wanted and cannot be written.
    """
    if record:
        need("rerun")
    folder = report_folder(out)
    files = (CALIBRATION, *REPORT, *("recording.rrd",) * record)
    read = [frames.path] if frames.is_video else [frames.path / name for name in frames.names]
    where: dict[str, Any] = {"inputs": [*read, *inputs], "elsewhere": {CALIBRATION: Path(out)}}
    steps: list[FitIterate] = []
    options["light_observers"] = [steps.append] if record else []
    with staged_folder(folder, files, overwrite=overwrite, **where) as staging:
        cache = folder / "detections.jsonl"  # which is no part of what moves in at the end
        how: dict[str, Any] = {"camera": options.get("camera"), "progress": progress, "say": say}
        found = detect_cached(frames, target, cache, overwrite=overwrite, **how)
        options["detections"], options["size"] = found
        session = calibrate(frames, target, channel=channel, progress=progress, **options)
        write_report(session, frames, staging, channel)
        if record:
            from endolab.recording.calibration import record_calibration

            record_calibration(session, frames, staging / "recording.rrd", light_steps=steps)
        if session.light is not None:
            make_calibration(session, str(frames.path), channel).save(staging / CALIBRATION)
    return session
