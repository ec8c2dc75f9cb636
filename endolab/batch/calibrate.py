"""Frames of a target in, endoscope.json and its report out."""

from collections.abc import Collection
from contextlib import suppress
from pathlib import Path
from typing import Any

from endolab._extras import need
from endolab.calibration.session import Progress, Session, calibrate, check_names, silent
from endolab.calibration.targets import Target
from endolab.io.atomic import (
    PathLike,
    as_path,
    check_file,
    read_json,
    stage_file,
    stage_folder,
)
from endolab.io.descriptions import make_calibration, write_calibration
from endolab.io.video import Frames
from endolab.workbench.reports.calibration_page import write_report


def report_folder(out: PathLike) -> Path:
    """Name the folder that goes with a calibration: CAL_report beside CAL.json."""
    path = as_path(out)
    if path.suffix != ".json":
        raise ValueError(f"the calibration's name ends in .json, got {path.name}")
    return path.with_name(f"{path.stem}_report")


def _is_calibration(path: Path) -> bool:
    """Whether a file is an endoscope.json of endolab's."""
    with suppress(OSError, ValueError, AttributeError):
        return bool(read_json(path, "calibration").get("endolab") == 1)
    return False


def calibrate_to_files(
    frames: Frames,
    target: Target,
    out: PathLike,
    *,
    record: bool = False,
    overwrite: bool = False,
    inputs: Collection[PathLike | None] = (),
    progress: Progress = silent,
    **options: Any,
) -> Session:
    """Calibrate an endoscope from frames of a target; write its file and a folder with the report.

    `out` is `endoscope.json`, with a nominal light if that was refused. Beside it are `report_folder`, with
    the page, `camera.json` and, with `record`, a recording for the Rerun viewer. A file that is no
    calibration of endolab's, and a folder that is no such report, are replaced only if `overwrite`; the
    frames and `inputs`, what else was read for this, never. The rest, camera, channel, every, leave_out and
    the light's options, is as for `calibrate`. Raises `MissingPackage` at once if a recording is wanted and
    cannot be written.
    """
    if record:
        need("rerun")
    folder = report_folder(out)
    calibration = Path(out)
    channel = options.setdefault("channel", "grey")
    check_names(options.get("leave_out", ()), frames.names)  # before a long search
    pictures = [frames.path / name for name in frames.names]
    read = [*inputs, frames.path, *pictures]
    overwrite_file = overwrite or _is_calibration(calibration)
    check_file(calibration, overwrite=overwrite_file, inputs=read)
    with stage_folder(folder, overwrite=overwrite, inputs=read) as staging:
        session = calibrate(
            frames,
            target,
            progress=progress,
            **options,
        )
        write_report(
            session,
            frames,
            staging,
            channel,
        )
        if record:
            from endolab.workbench.recording.calibration import record_calibration

            record_calibration(session, frames, staging / "recording.rrd")
    with stage_file(calibration, inputs=read) as temporary:
        write_calibration(make_calibration(session, str(frames.path), channel), temporary)
    return session
