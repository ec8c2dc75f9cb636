"""Simulated calibration videos in files, with their truth."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from endolab.calibration.session import Progress, silent
from endolab.calibration.simulation.video import PAPER_SHEET, simulate_video
from endolab.io.atomic import PathLike, as_json, staged_folder
from endolab.io.descriptions import read_target
from endolab.io.images import write_image
from endolab.io.video import write_video
from endolab.model.brdf import TabulatedBRDF
from endolab.model.endoscope import Endoscope
from endolab.numerics.arrays import FloatArray


def save_sheet_video(
    folder: PathLike,
    target: str,
    endoscope: Endoscope,
    count: int,
    *,
    fold: float = 0.0,
    video: bool = False,
    progress: Progress = silent,
    **how: Any,
) -> None:
    """Write a simulated calibration video, as pictures or as `sheet.mkv`, and `truth.json`.

    `target` is as for `read_target`; `fold`, rad, is that of a target that has one. The paper is that of
    `PAPER_SHEET`; `how` are options of `simulate_video`.
    """
    sheet = read_target(target)
    fold = fold if sheet.fold is not None else 0.0
    light = replace(endoscope.photometry, brdf=PAPER_SHEET)
    frames = simulate_video(sheet, endoscope.camera, light, count, fold=fold, **how)
    truth: list[dict[str, Any]] = []

    def images() -> Iterator[FloatArray]:
        for frame in frames:
            truth.append({"gain": frame.gain, "poses": [pose.vector.tolist() for pose in frame.poses]})
            progress("rendering", len(truth), count)
            yield frame.image

    with staged_folder(folder) as staging:
        if video:
            write_video(staging / "sheet.mkv", images())
        else:
            for number, image in enumerate(images()):
                write_image(staging / f"{number:06d}.png", image)
        theta = np.linspace(0, np.pi / 2, 181)
        paper = TabulatedBRDF(tuple(theta), tuple(PAPER_SHEET.value(np.cos(theta), np.cos(theta))))
        known = replace(endoscope, photometry=replace(endoscope.photometry, brdf=paper))
        facts = known.to_dict() | {"target": target, "fold": fold, "frames": truth}
        (staging / "truth.json").write_bytes(as_json(facts))
