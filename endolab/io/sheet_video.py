"""Simulated calibration videos in files, with their truth."""

from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from endolab.calibration.session import Progress, silent
from endolab.calibration.simulation.trajectory import MOVEMENT
from endolab.calibration.simulation.video import PAPER_SHEET, simulate_video
from endolab.io.atomic import (
    PathLike,
    as_json,
    files_of_report,
    stage_folder,
    write_atomically,
)
from endolab.io.descriptions import read_target
from endolab.io.images import write_image
from endolab.io.video import PICTURES, write_video
from endolab.model.brdf import TabulatedBRDF
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import FloatArray

SHEET_TRUTH = "truth.json"


def save_sheet_video(
    folder: PathLike,
    target: str,
    endoscope: Calibration,
    count: int,
    *,
    video: bool = False,
    overwrite: bool = False,
    inputs: Collection[PathLike | None] = (),
    progress: Progress = silent,
    **options: Any,
) -> None:
    """Write a simulated calibration video, as pictures or as `sheet.mkv`, and `truth.json`.

    `target` is as for `read_target`. The paper is that of `PAPER_SHEET`; movement, sensor and seed are as for
    `simulate_video`. What is there already is replaced as by `stage_folder`. ValueError, if there are
    pictures of others, which would be taken for more of these frames.
    """
    out = Path(folder)
    names = [f"{number:06d}.png" for number in range(count)]
    replaced = {*files_of_report(out, SHEET_TRUTH), *(out / name for name in names)}
    for path in [] if video else sorted(out.glob("[!.]*")):
        if path.suffix.lower() in PICTURES and path not in replaced:
            raise ValueError(
                f"{path} would be taken for one of the frames; choose another folder"
            )
    sheet = read_target(target)
    light = replace(endoscope.photometry, brdf=PAPER_SHEET)
    frames = simulate_video(
        sheet,
        endoscope.camera,
        light,
        count,
        **options,
    )
    truth: list[dict[str, Any]] = []

    def images() -> Iterator[FloatArray]:
        for frame in frames:
            poses = [pose.vector.tolist() for pose in frame.poses]
            truth.append({"gain": frame.gain, "poses": poses})
            progress("rendering", len(truth), count)
            yield frame.image

    with stage_folder(
        folder, overwrite=overwrite, inputs=inputs, report=SHEET_TRUTH
    ) as staging:
        if video:
            write_video(staging / "sheet.mkv", images())
        else:
            for name, image in zip(names, images(), strict=True):
                write_image(staging / name, image)
        theta = np.linspace(0, np.pi / 2, 181)
        value = PAPER_SHEET.value(np.cos(theta), np.cos(theta))
        paper = TabulatedBRDF(tuple(theta), tuple(value))
        known = replace(endoscope, photometry=replace(endoscope.photometry, brdf=paper))
        fold = options.get("movement", MOVEMENT).fold
        facts = known.to_dict() | {"target": target, "fold": fold, "frames": truth}
        write_atomically(staging / SHEET_TRUTH, as_json(facts))
