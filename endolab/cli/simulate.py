"""The command that renders: a frame, or a calibration video, with its truth."""

import shlex
from dataclasses import replace
from functools import partial
from typing import Any, Literal

from endolab.cli.solving import show_progress


def simulate(
    scene: Literal["plane", "curved", "tube", "colon", "sheet"],
    /,
    *,
    out: str,
    overwrite: bool = False,
    calibration: str = "paper",
    width: int = 640,
    noise: float = 1.0,
    seed: int = 0,
    highlights: float | None = None,
    target: str | None = None,
    frames: int | None = None,
    video: bool = False,
) -> None:
    """Render a scene: a frame with its truth.

    - endolab simulate colon --out sim
    - endolab simulate tube --calibration simple --width 320 --noise 0 --out sim
    - endolab simulate sheet --target vicalib_folded --video --out v

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
    target : str
        Of a calibration video: its name, as for `target` (vicalib_small).
    frames : int
        Of a calibration video: how many (300).
    video : bool
        Of a calibration video: write one video instead of pictures.
    """
    import endolab as el
    from endolab.batch.calibrate import save_sheet_video
    from endolab.io.atomic import as_json, stage_folder, write_atomically
    from endolab.io.images import write_image
    from endolab.io.surfaces import save_depth

    if (highlights is not None) if scene == "sheet" else (target or frames or video):
        frames_only = "--highlights is of a frame, --target, --frames and --video"
        raise ValueError(f"{frames_only} are of a calibration video")
    known = el.load_calibration(calibration, width)
    random: Any = {"noise": noise, "seed": seed}
    if scene == "sheet":
        target = target or "vicalib_small"
        frames = 300 if frames is None else frames
        with show_progress("frame") as show:
            progress = partial(show, total=frames)
            made = save_sheet_video(
                out, target, known, frames, video, overwrite, progress, **random
            )
        gamma = " --gamma free" if made.fold else ""
        source = shlex.quote(f"{out}/sheet.mkv" if video else out)
        given = f"{source} --target {shlex.quote(target)}{gamma}"
        print(f"written to {out}; next: endolab calibrate {given} --out endoscope.json")
        return
    random["highlights"] = highlights or 0.0
    with stage_folder(out, overwrite=overwrite, read=[calibration]) as folder:
        shown = el.render(el.SCENES[scene], known.camera, known.photometry, **random)
        write_image(folder / "frame.png", shown.image)
        used = replace(known, photometry=shown.photometry)
        el.write_calibration(used, folder / "endoscope.json")
        save_depth(folder / "truth.npz", shown, True)
        facts = {"endolab": 1, "scene": scene} | random
        write_atomically(folder / "report.json", as_json(facts))
    print(f"written to {out}: endoscope.json, frame.png, report.json, truth.npz")
