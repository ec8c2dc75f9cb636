"""The command that renders: a frame, or a calibration video, with its truth."""

import math
import shlex
from dataclasses import replace
from typing import Any, Literal

from endolab.cli.solving import show_progress

SHEET = "sheet"  # the scene that is a video of a target


def simulate(
    scene: str,
    /,
    *,
    out: str,
    overwrite: bool = False,
    calibration: str = "paper",
    width: int = 640,
    noise: float = 1.0,
    bits: Literal[8, 16] = 8,
    seed: int = 0,
    texture: float = 0.0,
    fog: float = 0.0,
    highlights: float = 0.0,
    target: str = "vicalib_small",
    frames: int = 300,
    fold: float = 20.0,
    outliers: float = 0.0,
    video: bool = False,
) -> None:
    """Render a scene: a frame with its truth.

    - endolab simulate colon --out sim
    - endolab simulate tube --calibration simple --width 320 --noise 0 --out sim
    - endolab simulate sheet --target vicalib_folded --video --out v

    Parameters
    ----------
    scene : str
        plane, curved, tube or colon; sheet: a calibration video.
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
    bits : int
        Of each channel.
    seed : int
        Of all that is random.
    texture : float
        Of a frame: standard deviation of the albedo's logarithm.
    fog : float
        Of a frame: attenuation, 1/mm.
    highlights : float
        Of a frame: share of light that a wet film mirrors.
    target : str
        Of a calibration video: its name, as for `target`.
    frames : int
        Of a calibration video: how many.
    fold : float
        Of a calibration video: of a folded target, degrees.
    outliers : float
        Of a calibration video: share of the pixels that are wrong.
    video : bool
        Of a calibration video: write one video instead of pictures.
    """
    import numpy as np

    import endolab as el
    from endolab.batch.calibrate import save_sheet_video
    from endolab.calibration.simulation.sheet_image import Sensor
    from endolab.calibration.simulation.trajectory import Movement
    from endolab.io.atomic import as_json, stage_folder, write_atomically
    from endolab.io.descriptions import read_target
    from endolab.io.images import write_image
    from endolab.io.surfaces import save_depth
    from endolab.numerics.checks import unknown_name

    if scene not in (*el.SCENES, SHEET):
        raise unknown_name("scene", scene, (*el.SCENES, SHEET))
    known = el.load_calibration(calibration)
    height = round(known.camera.height * width / known.camera.width)
    known = known.resize(width, max(1, height))
    if scene == SHEET:
        sheet = read_target(target)
        angle = 0.0 if sheet.fold is None else math.radians(fold)
        with show_progress("frame") as show:
            save_sheet_video(
                out,
                target,
                known,
                frames,
                video=video,
                overwrite=overwrite,
                progress=lambda stage, done, total: show(done, total, stage),
                movement=Movement(fold=angle),
                sensor=Sensor(noise=noise, bits=bits, outliers=outliers),
                seed=seed,
            )
        source = shlex.quote(f"{out}/sheet.mkv" if video else out)
        gamma = "" if sheet.fold is None else " --gamma free"
        given = f"{source} --target {shlex.quote(target)}{gamma}"
        print(f"written to {out}; next: endolab calibrate {given} --out endoscope.json")
        return
    chosen: dict[str, Any] = {
        "noise": noise,
        "bits": bits,
        "seed": seed,
        "texture": texture,
        "fog": fog,
        "highlights": highlights,
    }
    with stage_folder(out, overwrite=overwrite) as folder:
        shown = el.render(el.SCENES[scene], known.camera, known.photometry, **chosen)
        write_image(folder / "frame.png", shown.image, bits)
        used = replace(known, photometry=shown.photometry)
        el.write_calibration(used, folder / "endoscope.json")
        save_depth(folder / "truth.npz", shown, True)
        facts = {"endolab": 1, "scene": scene} | chosen
        write_atomically(folder / "report.json", as_json(facts))
    distance = shown.distance[shown.mask]
    nearest, median, farthest = np.percentile(distance, [0, 50, 100])
    print(f"{scene}: {nearest:.1f} to {farthest:.1f} mm, median {median:.1f} mm")
    print(f"written to {out}: endoscope.json, frame.png, report.json, truth.npz")
