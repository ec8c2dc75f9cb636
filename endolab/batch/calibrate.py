"""Frames of a target in, endoscope.json and its report out; and simulated frames of a target."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from endolab._extras import need
from endolab.calibration.session import Session, calibrate, check_names
from endolab.calibration.simulation.sheet_image import Sensor
from endolab.calibration.simulation.trajectory import Movement
from endolab.calibration.simulation.video import PAPER_SHEET, simulate_video
from endolab.calibration.targets import Target
from endolab.io.atomic import PathLike, as_json, check_new, stage_folder, write_atomically
from endolab.io.descriptions import make_calibration, read_target, write_calibration
from endolab.io.images import write_image
from endolab.io.video import Frames, write_video
from endolab.model.brdf import TabulatedBRDF
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import FloatArray
from endolab.workbench.reports.calibration_page import write_report


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
    record: bool = False,
    overwrite: bool = False,
    channel: str = "grey",
    **options: Any,
) -> Session:
    """Calibrate an endoscope from frames of a target; write its file and a folder with the report.

    `out` is `endoscope.json`, with a nominal light if that was refused. Beside it are `report_folder`, with
    the page, `camera.json` and, with `record`, a recording for the Rerun viewer. What is there is replaced
    only if `overwrite`. The rest, camera, every, leave_out and the light's options, is as for `calibrate`.
    Raises `MissingPackage` at once if a recording is wanted and cannot be written.
    """
    if record:
        need("rerun")
    check_names(options.get("leave_out", ()), frames.names)  # before a long search
    check_new(out, overwrite)
    with stage_folder(report_folder(out), overwrite=overwrite) as staging:
        session = calibrate(frames, target, channel=channel, **options)
        write_report(session, frames, staging, channel)
        if record:
            from endolab.workbench.recording.calibration import record_calibration

            record_calibration(session, frames, staging / "recording.rrd")
    write_calibration(make_calibration(session, str(frames.path), channel), out)
    return session


def save_sheet_video(
    folder: PathLike,
    name: str,
    endoscope: Calibration,
    count: int,
    video: bool,
    overwrite: bool,
    progress: Callable[[int], object],
    *,
    noise: float,
    seed: int,
) -> Target:
    """Write a simulated calibration video, pictures or `sheet.mkv`, with `truth.json`; return its target.

    Its `name` is as for `read_target`; one with a fold is folded by 20°, and the paper is `PAPER_SHEET`. What
    is there already is replaced as by `stage_folder`.
    """
    target = read_target(name)
    fold = 0.0 if target.fold is None else math.radians(20)
    light = replace(endoscope.photometry, brdf=PAPER_SHEET)
    frames = simulate_video(
        target,
        endoscope.camera,
        light,
        count,
        movement=Movement(fold),
        sensor=Sensor(noise),
        seed=seed,
    )
    truth: list[dict[str, Any]] = []

    def images() -> Iterator[FloatArray]:
        for frame in frames:
            poses = [pose.vector.tolist() for pose in frame.poses]
            truth.append({"gain": frame.gain, "poses": poses})
            progress(len(truth))
            yield frame.image

    with stage_folder(folder, overwrite=overwrite, last="truth.json") as staging:
        if video:
            write_video(staging / "sheet.mkv", images())
        else:
            for number, image in enumerate(images()):
                write_image(staging / f"{number:06d}.png", image)
        theta = np.linspace(0, np.pi / 2, 181)
        value = PAPER_SHEET.value(np.cos(theta), np.cos(theta))
        paper = TabulatedBRDF(tuple(theta), tuple(value))
        known = replace(endoscope, photometry=replace(light, brdf=paper))
        facts = known.to_dict() | {"target": name, "fold": fold, "frames": truth}
        write_atomically(staging / "truth.json", as_json(facts))
    return target
