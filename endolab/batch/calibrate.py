"""Frames of a target in, endoscope.json and its report out; a call that was cut off goes on where it was."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from endolab._extras import need
from endolab.calibration.least_squares import FitIterate
from endolab.calibration.session import Progress, Session, calibrate, silent
from endolab.calibration.targets import Target
from endolab.io.atomic import PathLike
from endolab.io.descriptions import make_calibration
from endolab.io.detection_cache import detect_cached
from endolab.io.video import Frames
from endolab.reports.calibration_page import write_report


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
    progress: Progress = silent,
    say: Callable[[str], None] | None = None,
    **options: Any,
) -> Session:
    """Calibrate an endoscope from frames of a target; write its file and a folder with the report.

    `out` is `endoscope.json`, not written if the light was refused. Beside it, in `report_folder`, are
    what was detected (kept between calls), the page, `camera.json` and, with `record`, a recording for
    the Rerun viewer. `say` is told, in a sentence, what an earlier call had done; the rest, camera, every
    and the light's options, is as for `calibrate`. Raises `MissingPackage` at once if a recording is
    wanted and cannot be written.
    """
    if record:
        need("rerun")
    folder = report_folder(out)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(f"cannot write to the folder {folder}: {error.strerror or error}") from error
    detections, size = detect_cached(frames, target, folder / "detections.jsonl", progress=progress, say=say)
    steps: list[FitIterate] = []
    options |= {"detections": detections, "size": size, "light_observers": [steps.append] if record else []}
    session = calibrate(frames, target, channel=channel, progress=progress, **options)
    write_report(session, frames, folder, channel)
    if record:
        from endolab.recording.calibration import record_calibration

        record_calibration(session, frames, folder / "recording.rrd", light_steps=steps)
    if session.light is not None:
        make_calibration(session, str(frames.path), channel).save(out)
    return session
