"""The command that renders: a frame, or a calibration video, with its truth."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from endolab.cli.solving import Count, Lamps, show_progress

if TYPE_CHECKING:
    from endolab.model.endoscope import Calibration
    from endolab.numerics.arrays import FloatArray


def simulate(
    scene: Literal["plane", "curved", "tube", "colon", "sheet"],
    /,
    *,
    out: str,
    overwrite: bool = False,
    calibration: str = "paper",
    width: Count = 640,
    noise: float = 1.0,
    seed: int = 0,
    highlights: float | None = None,
    lamp: Lamps = None,
    target: str | None = None,
    frames: Count | None = None,
    video: bool = False,
) -> None:
    """Render a scene: a frame with its truth.

    - endolab simulate colon --out sim
    - endolab simulate tube --calibration simple --width 320 --noise 0 --out sim
    - endolab simulate sheet --target vicalib_folded --video --out v
    - endolab simulate sheet --lamp 4,-2 --frames 60 --out v

    Parameters
    ----------
    scene : str
        What is seen; sheet is a calibration video.
    out : path
        Folder for the results.
    overwrite : bool
        Write even where there are files of others.
    calibration : path
        endoscope.json, or a name.
    width : int
        Of the frame, px.
    noise : float
        Its standard deviation, grey levels of 255.
    seed : int
        Of all that is random.
    highlights : float
        Of a frame: share of light that a wet film mirrors (0).
    lamp : X,Y[,Z]
        Where a lamp stands, mm: x right, y down of the lens; once for each, instead of those listed.
    target : str
        Of a calibration video: as for `target` (vicalib_small).
    frames : int
        Of a calibration video: how many (300).
    video : bool
        Of a calibration video: write one video instead of pictures.
    """
    import endolab as el
    from endolab.io.atomic import as_json, stage_folder, write_atomically
    from endolab.io.images import write_image
    from endolab.io.surfaces import save_depth

    if (highlights is not None) if scene == "sheet" else (target or frames or video):
        frames_only = "--highlights is of a frame, --target, --frames and --video"
        raise ValueError(f"{frames_only} are of a calibration video")
    known = el.load_calibration(calibration, width)
    if lamp:
        known = replace(known, photometry=known.photometry.with_lamps(lamp))
    random: Any = {"noise": noise, "seed": seed}
    with stage_folder(out, overwrite=overwrite, read=[calibration]) as folder:
        if scene == "sheet":
            target = target or "vicalib_small"
            count = 300 if frames is None else frames
            fold = film_sheet(folder, target, known, count, video, **random)
        else:
            random["highlights"] = highlights or 0.0
            shown = el.render(el.SCENES[scene], known.camera, known.photometry, **random)
            write_image(folder / "frame.png", shown.image)
            used = replace(known, photometry=shown.photometry)
            el.write_calibration(used, folder / "endoscope.json")
            save_depth(folder / "truth.npz", shown, True)
            facts = {"endolab": 1, "scene": scene} | random
            write_atomically(folder / "report.json", as_json(facts))
    if scene == "sheet":
        source = shlex.quote(f"{out}/sheet.mkv" if video else out)
        given = f"{source} --target {shlex.quote(str(target))}"
        given += " --gamma free" if fold else ""
        print(f"written to {out}; next: endolab calibrate {given} --out endoscope.json")
    else:
        print(f"written to {out}: endoscope.json, frame.png, report.json, truth.npz")


def film_sheet(
    folder: Path,
    target: str,
    endoscope: Calibration,
    count: int,
    video: bool,
    *,
    noise: float,
    seed: int,
) -> float:
    """Write a simulated calibration video, pictures or `sheet.mkv`, with `truth.json`; return its fold, rad.

    A target that has a fold is folded by 20°, and the paper is `PAPER_SHEET`.
    """
    import numpy as np

    from endolab.calibration.simulation.video import PAPER_SHEET, simulate_video
    from endolab.io.atomic import as_json, write_atomically
    from endolab.io.descriptions import read_target
    from endolab.io.images import write_image
    from endolab.io.video import write_video
    from endolab.model.brdf import TabulatedBRDF

    sheet = read_target(target)
    fold = math.radians(20) if sheet.fold else 0.0
    light = replace(endoscope.photometry, brdf=PAPER_SHEET)
    how: Any = {"fold": fold, "noise": noise, "seed": seed}
    truth = []

    def pictures() -> Iterator[FloatArray]:
        with show_progress("frame") as show:
            for frame in simulate_video(sheet, endoscope.camera, light, count, **how):
                poses = [pose.vector.tolist() for pose in frame.poses]
                truth.append({"gain": frame.gain, "poses": poses})
                show(len(truth), count)
                yield frame.image

    if video:
        write_video(folder / "sheet.mkv", pictures())
    else:
        for number, image in enumerate(pictures()):
            write_image(folder / f"{number:06d}.png", image)
    theta = np.linspace(0, np.pi / 2, 181)
    value = PAPER_SHEET.value(np.cos(theta), np.cos(theta))
    paper = TabulatedBRDF(tuple(theta), tuple(value))
    known = replace(endoscope, photometry=replace(light, brdf=paper))
    facts = known.to_dict() | {"target": target, "fold": fold, "frames": truth}
    write_atomically(folder / "truth.json", as_json(facts))
    return fold
