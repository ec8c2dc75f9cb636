"""The commands about calibration: target, calibrate, calibrate-light, convert, and simulate's sheet."""

import argparse
import math
import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from endolab._extras import lacking
from endolab.cli.options import (
    add_command,
    add_overwrite,
    albedo,
    count,
    number,
    progress_bar,
    several,
)

SHEET = "sheet"  # the scene of `simulate` that is a video of a target
# What only that can be told.
SHEET_OPTIONS = ("target", "frames", "fold", "outliers", "video")


@contextmanager
def _bar() -> Iterator[Callable[[str, int, int], None]]:
    """Show the progress of one stage after the other on stderr."""
    with progress_bar("frame") as bar:

        def show(
            stage: str,
            done: int,
            total: int,
        ) -> None:
            if done <= bar.n:
                bar.reset(total)
            bar.set_description(stage)
            bar.update(done - bar.n)

        yield show


def _read_value(text: str) -> float | tuple[float, ...] | str:
    """Read ``2.2``, or ``2.2,0.1``: a value and its standard deviation; or ``free``."""
    if text == "free":
        return text
    values = tuple(several(number)(text))
    if len(values) > 2 or not all(0 < value < math.inf for value in values):
        either = "a positive number, one and its standard deviation (2.2,0.1) or free"
        raise argparse.ArgumentTypeError(f"expected {either}, found {text!r}")
    return values if len(values) == 2 else values[0]


def _target(arguments: argparse.Namespace) -> None:
    from endolab.calibration.session import describe_target
    from endolab.io.atomic import check_new
    from endolab.io.descriptions import read_target
    from endolab.workbench.reports.target_sheet import write_sheet

    target = read_target(arguments.name)
    if not arguments.overwrite:
        check_new(arguments.out)
    write_sheet(target, arguments.out)
    glue = "something flat"
    if target.fold is not None:
        glue = "two boards, folded by 10 to 30°, away from you"
    print(
        f"{describe_target(target)}; print at 100 %, check the ruler, and glue it on {glue}"
    )
    print(f"written to {arguments.out}")


def simulate_sheet(arguments: argparse.Namespace, calibration: Any) -> None:
    """Write a simulated calibration video with its truth."""
    from endolab.batch.calibrate import save_sheet_video
    from endolab.calibration.simulation.sheet_image import Sensor
    from endolab.calibration.simulation.trajectory import Movement
    from endolab.io.descriptions import read_target

    target = arguments.target or "vicalib_small"
    frames = arguments.frames or 300
    is_flat = read_target(target).fold is None
    if arguments.fold is not None and is_flat:
        raise ValueError(f"--fold is of a folded target, and {target} is flat")
    angle = 20.0 if arguments.fold is None else arguments.fold
    sensor = Sensor(
        noise=arguments.noise,
        bits=arguments.bits,
        outliers=arguments.outliers or 0.0,
    )
    with _bar() as bar:
        save_sheet_video(
            arguments.out,
            target,
            calibration,
            frames,
            video=bool(arguments.video),
            overwrite=arguments.overwrite,
            progress=bar,
            movement=Movement(fold=0.0 if is_flat else math.radians(angle)),
            sensor=sensor,
            seed=arguments.seed,
        )
    out = Path(arguments.out)
    source = out / "sheet.mkv" if arguments.video else out
    what = source.name if arguments.video else f"{frames} pictures"
    print(f"written to {out}: {what}, truth.json")
    gamma = "" if is_flat else " --gamma free"
    known = f"{shlex.quote(str(source))} --target {shlex.quote(target)}{gamma}"
    print(f"next: endolab calibrate {known} --out endoscope.json")


def _calibrate(arguments: argparse.Namespace) -> None:
    from endolab.batch.calibrate import calibrate_to_files, report_folder
    from endolab.calibration.summary import account
    from endolab.io.cameras.formats import read_camera
    from endolab.io.descriptions import read_target
    from endolab.io.video import open_frames
    from endolab.model.cameras import BrownConrady, KannalaBrandt

    frames = open_frames(*arguments.source)
    target = read_target(arguments.target)
    camera = None if arguments.camera is None else read_camera(arguments.camera)
    if not isinstance(camera, KannalaBrandt | BrownConrady | None):
        raise ValueError(
            f"{arguments.camera}: camera.model: expected kannala_brandt or brown_conrady, "
            f"found {camera.model}"
        )
    # Checked before a long search for the target.
    patches = len(set(target.ink.greys[:, 3]))
    given = [None if known == "free" else known for known in arguments.reflectance]
    if given and len(given) != patches:
        raise ValueError(
            f"the target has {patches} kinds of grey patches, but --reflectance says {len(given)}"
        )
    names = (
        "lens",
        "every",
        "channel",
        "leave_out",
        "record",
        "overwrite",
        "gamma",
        "brdf",
        "gain",
    )
    with _bar() as bar:
        session = calibrate_to_files(
            frames,
            target,
            arguments.out,
            progress=bar,
            camera=camera,
            reflectance=given or [None] * patches,
            **{name: getattr(arguments, name) for name in names},
        )
    print("\n".join(account(session)))
    if session.light is None:
        print(
            "The camera is calibrated and the light is not: k 2.5 and γ 2.2 of another endoscope stand in."
        )
    pageless = lacking("jinja2")
    page = f"there is no report.html: {pageless}" if pageless else "see its report.html"
    print(f"written to {arguments.out}, and to {report_folder(arguments.out)}; {page}")


def _calibrate_light(arguments: argparse.Namespace) -> None:
    import numpy as np

    from endolab.io.atomic import stage_file
    from endolab.io.cameras.formats import read_camera
    from endolab.io.datasets.known_endoscopes import CALIBRATIONS, load_calibration
    from endolab.io.descriptions import write_calibration
    from endolab.io.video import open_frames
    from endolab.model.endoscope import Calibration
    from endolab.numerics.iteration import Status
    from endolab.reconstruction.light.unknown_light import estimate_light
    from endolab.reconstruction.sequence import as_frame

    if arguments.camera in CALIBRATIONS:
        camera = load_calibration(arguments.camera).camera
    else:
        camera = read_camera(arguments.camera)
    frames = open_frames(*arguments.source)
    many = min(arguments.frames, len(frames))
    spread = np.linspace(0, len(frames) - 1, many).round().astype(int)
    names = [frames.names[index] for index in spread]
    light: dict[str, Any] = {"gamma": arguments.gamma, "otherwise": arguments.k}
    if arguments.albedo is not None:
        light["albedo"] = arguments.albedo
    pictures = frames.read(names)
    read = (as_frame(name, image) for name, image in pictures if image is not None)
    output = stage_file(arguments.out, overwrite=arguments.overwrite)
    with output as temporary, _bar() as bar:
        estimate = estimate_light(
            read, camera, progress=lambda done, _: bar("light", done, many), **light
        )
        if estimate.status is Status.STOPPED:
            raise KeyboardInterrupt
        found = Calibration(camera, estimate.photometry, estimate.evidence)
        write_calibration(found, temporary)
    for reason in estimate.refused.values():
        print(f"left out: {reason}")
    unread = sorted({*names} - {*estimate.names} - {*estimate.refused})
    if unread:
        print(f"cannot be read: {', '.join(unread)}")
    print(estimate.verdict)
    print(f"written to {arguments.out}; the gain is unknown, so distances are relative")


def _size(text: str) -> tuple[int, int]:
    """Read ``1440x1080``."""
    columns, _, rows = text.partition("x")
    return count(columns), count(rows)


def _convert(arguments: argparse.Namespace) -> None:
    from endolab.io.atomic import stage_file
    from endolab.io.datasets.endomapper import find_calibrations, read_endomapper
    from endolab.io.datasets.known_endoscopes import load_calibration
    from endolab.io.descriptions import write_calibration

    source = arguments.source
    photometry = arguments.photometry
    out = Path(arguments.out)
    if out.suffix != ".json":
        raise ValueError(f"the calibration's name ends in .json, got {out.name}")
    if Path(source).is_dir():
        if photometry is not None:
            raise ValueError(
                f"{source} is a folder, where both files are looked for; name no other"
            )
        source, photometry = find_calibrations(source)
    with stage_file(out, overwrite=arguments.overwrite) as temporary:
        if photometry is None:
            calibration = load_calibration(source, size=arguments.size)
        else:
            calibration = read_endomapper(source, photometry)
        write_calibration(calibration, temporary)
    if photometry is None:
        print(f"written to {out}; `endolab calibrate --camera {out}` measures its light")
    else:
        _print_light(calibration)
        print(f"written to {out}; the gain is unknown, so distances are relative")


def _print_light(calibration: Any) -> None:
    """Say how well EndoMapper's light could be expressed."""
    light = calibration.photometry
    fits = calibration.evidence["converted"]["lights"]
    worst = max(fit["worst_distance_percent"] for fit in fits)
    lights = len(light.lights) or "one at the optical centre"
    print(f"γ = {light.gamma:g}, k = {light.k:.3g}, lights: {lights}")
    print(
        f"the light's spread, as a power of a cosine, is off by at most {worst:.2g} % of a distance"
    )


def add_sheet_options(add: argparse.ArgumentParser) -> None:
    """Add what `simulate sheet` can be told."""
    option = add.add_argument_group("a calibration video (SCENE sheet)").add_argument
    option("--target", metavar="NAME", help="as for target (default vicalib_small)")
    option("--frames", type=count, metavar="N", help="how many (default 300)")
    option("--fold", type=number, metavar="DEG", help="of a folded target (default 20)")
    option("--outliers", type=number, metavar="SHARE", help="of the pixels that are wrong")
    text = "write one video instead of pictures"
    option("--video", action="store_true", default=None, help=text)


def _add_pictures_and_out(command: argparse.ArgumentParser, about_out: str | None) -> None:
    """Add the pictures that a calibration is made of, and the file that it is written to."""
    option = command.add_argument
    text = "a video, a folder of pictures, or pictures"
    option("source", nargs="+", metavar="SOURCE", help=text)
    option("--out", required=True, metavar="CAL.json", help=about_out)
    add_overwrite(option)


def add_calibration_commands(commands: Any) -> None:
    """Add the parsers of `target`, `calibrate` and `convert`."""
    command = add_command(
        commands,
        "target",
        _target,
        "a calibration sheet to print, at true size",
        "endolab target vicalib_folded --out sheet.pdf",
        "endolab target target.json --out sheet.svg",
    )
    option = command.add_argument
    names = "vicalib_big, vicalib_small, vicalib_folded, vicalib_grey, charuco, chessboard, circles"
    option("name", metavar="NAME", help=f"{names}, or TARGET.json")
    option("--out", required=True, metavar="SHEET.pdf", help="a PDF or SVG")
    add_overwrite(option)

    command = add_command(
        commands,
        "calibrate",
        _calibrate,
        "frames of a target in, endoscope.json out",
        "endolab calibrate v.mp4 --target vicalib_folded --gamma free --out cal.json",
        "endolab calibrate pictures/*.png --target chessboard --out cal.json",
        "endolab calibrate v.mp4 --camera camera.json --target charuco --out cal.json",
    )
    _add_pictures_and_out(command, "the report goes into CAL_report beside it")
    option = command.add_argument
    option("--target", required=True, help="its name, as for target, or TARGET.json")
    text = "calibrate the light only, with the camera of this file"
    option("--camera", metavar="CAL.json", help=text)
    text = "auto (default: what predicts frames held out best), fisheye or brown"
    option("--lens", choices=("auto", "fisheye", "brown"), default="auto", help=text)
    text = "one frame of a video in N goes into the geometry (default 20)"
    option("--every", type=count, default=20, metavar="N", help=text)
    text = "frames, by their names in the report, that the calibration is to do without"
    option("--leave-out", nargs="+", action="extend", default=[], metavar="NAME", help=text)
    text = "whose response: grey (default), red, green or blue"
    option("--channel", choices=("grey", "red", "green", "blue"), default="grey", help=text)
    text = "a number (default 2.2), a number and its standard deviation (2.2,0.1), or free"
    option("--gamma", type=_read_value, default=2.2, metavar="γ", help=text)
    text = "of the paper: tabulated (default) or lambertian"
    option("--brdf", choices=("tabulated", "lambertian"), default="tabulated", help=text)
    text = "free (default), or locked: the same in all frames"
    option("--gain", choices=("free", "locked"), default="free", help=text)
    text = "of the grey patches relative to white: 0.5, or 0.5,0.02 with its standard deviation, or free"
    known: dict[str, Any] = {
        "type": _read_value,
        "action": "append",
        "default": [],
        "metavar": "R",
    }
    option("--reflectance", help=text, **known)
    text = "write a recording for the Rerun viewer too"
    option("--record", action="store_true", help=text)

    command = add_command(
        commands,
        "calibrate-light",
        _calibrate_light,
        "the light's fall-off k, asked of frames of tissue",
        "endolab calibrate-light video.mp4 --camera camera.json --out endoscope.json",
        "endolab calibrate-light a.png b.png --camera paper --out endoscope.json",
    )
    _add_pictures_and_out(command, None)
    option = command.add_argument
    text = "endoscope.json, of which the camera is taken; or a known endoscope's name"
    option("--camera", required=True, metavar="CAL", help=text)
    text = "so many, spread evenly (default 8); each takes some seconds"
    option("--frames", type=count, default=8, metavar="N", help=text)
    text = "which frames don't tell (default 2.2)"
    option("--gamma", type=number, default=2.2, metavar="γ", help=text)
    text = "of the wall's green, or R,G,B, if known"
    option("--albedo", type=albedo, metavar="A", help=text)
    text = "if it is not found (default 2.5)"
    option("--k", type=number, default=2.5, metavar="K", help=text)

    command = add_command(
        commands,
        "convert",
        _convert,
        "another program's calibration in, endoscope.json out",
        "endolab convert camchain.yaml#cam1 --out endoscope.json",
        "endolab convert opencv.xml --size 1440x1080 --out endoscope.json",
        "endolab convert Endoscope_01 --out endoscope.json",
    )
    option = command.add_argument
    text = "a calibration of any kind; or EndoMapper's folder Endoscope_XX"
    option("source", metavar="IN", help=text)
    text = "of EndoMapper, the light"
    option("photometry", nargs="?", metavar="PHOTOMETRY.xml", help=text)
    text = "of the pictures, px, if the file does not say"
    option("--size", type=_size, metavar="COLUMNSxROWS", help=text)
    option("--out", required=True, metavar="CAL.json")
    add_overwrite(option)
