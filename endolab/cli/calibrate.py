"""The commands about calibration: target, calibrate, calibrate-light, convert."""

import os
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from endolab._extras import lacking
from endolab.cli.solving import Count, Size, Value, show_progress


def target(name: str, /, *, out: str, overwrite: bool = False) -> None:
    """Draw a calibration sheet to print, at true size.

    - endolab target vicalib_folded --out sheet.pdf
    - endolab target target.json --out sheet.pdf

    Parameters
    ----------
    name : str
        vicalib_big, vicalib_small, vicalib_folded, vicalib_grey, charuco, chessboard; a board as it is
        bought, printed squares: chessboard:14x9:3mm, charuco:11x8:15mm:11mm:4X4_50; or TARGET.json.
    out : path
        A PDF.
    overwrite : bool
        Replace what is there.
    """
    from endolab.calibration.session import describe_target
    from endolab.io.atomic import check_new
    from endolab.io.descriptions import read_target
    from endolab.workbench.reports.target_sheet import paper_of, write_sheet

    sheet = read_target(name)
    check_new(out, overwrite)
    write_sheet(sheet, out)
    print(describe_target(sheet))
    print(f"print at 100 % on {paper_of(sheet)} paper, and check the ruler")
    print(f"written to {out}")


def calibrate(
    source: tuple[str, ...],
    /,
    *,
    target: str,
    out: str,
    overwrite: bool = False,
    camera: str | None = None,
    lens: Literal["auto", "fisheye", "brown"] = "auto",
    every: Count = 20,
    leave_out: Annotated[tuple[str, ...], Parameter(consume_multiple=True)] = (),
    channel: Literal["grey", "red", "green", "blue"] = "grey",
    gamma: Value = 2.2,
    gain: Literal["free", "locked"] = "free",
    reflectance: list[Value] | None = None,
    lamps: Literal["auto", "centre", "one", "two"] = "auto",
) -> None:
    """Make an endoscope.json of frames of a target.

    - endolab calibrate v.mp4 --target vicalib_folded --gamma free --out cal.json
    - endolab calibrate pictures/*.png --target chessboard:14x9:3mm --out cal.json
    - endolab calibrate v.mp4 --camera camera.json --target charuco --out cal.json

    Parameters
    ----------
    source : paths
        A video, a folder of pictures, or pictures.
    target : str
        As for `target`; the whole of a chessboard must be in view, of other targets a part.
    out : path
        The calibration; the report goes into CAL_report beside it.
    overwrite : bool
        Replace what is there.
    camera : path
        Calibrate the light only, with the camera of this file.
    lens : str
        auto: what predicts frames held out best.
    every : int
        One frame of a video in N goes into the geometry.
    leave_out : str
        Frames, by their names in the report, that the calibration is to do without.
    channel : str
        Whose response.
    gamma : float
        A number, a number and its standard deviation (2.2,0.1), or free.
    gain : str
        Free, or the same in all frames.
    reflectance : float
        Of a grey patch relative to white: 0.5, or 0.5,0.02 with its standard deviation, or free; once for
        each kind of patch.
    lamps : str
        Whose places are sought; auto: the fewest that explain frames held out.
    """
    import endolab as el
    from endolab.calibration.session import check_names
    from endolab.calibration.summary import account
    from endolab.io.atomic import check_new, stage_folder
    from endolab.io.cameras.formats import read_camera
    from endolab.io.descriptions import make_calibration, read_target
    from endolab.model.photometry import NOMINAL
    from endolab.workbench.reports.calibration_page import write_report

    if not out.endswith(".json"):
        raise ValueError(f"the calibration's name ends in .json, got {out}")
    report = f"{out.removesuffix('.json')}_report"
    check_new(out, overwrite, (*source, target, camera))
    sheet = read_target(target)
    greys = [None] * len(set(sheet.grey_discs[:, 3]))  # free
    known = [None if value == "free" else value for value in reflectance or greys]
    given: Any = None if camera is None else read_camera(camera)
    seen = None if given is None else el.Calibration(given)
    found = el.open_frames(*source, calibration=seen)
    check_names(leave_out, found.names)  # before a long search
    with stage_folder(report, overwrite=overwrite) as folder:
        with show_progress("frame") as show:
            session = el.calibrate(
                found,
                sheet,
                camera=given,
                lens=lens,
                every=every,
                leave_out=leave_out,
                channel=channel,
                gamma=gamma,
                gain=gain,
                reflectance=known,
                lamps=lamps,
                progress=lambda stage, done, total: show(done, total, stage),
            )
        write_report(session, found, folder, channel)
    el.write_calibration(make_calibration(session, str(found.path), channel), out)
    print(*account(session), sep="\n")
    if session.light is None:
        print(
            f"The light is not calibrated: k {NOMINAL.k:g} and γ {NOMINAL.gamma:g} stand in."
        )
    print(f"written to {out}, and to {report}", lacking("jinja2"))


def calibrate_light(
    source: tuple[str, ...],
    /,
    *,
    camera: str,
    out: str,
    overwrite: bool = False,
    frames: Count = 8,
    gamma: float = 2.2,
    albedo: Value = None,
) -> None:
    """Ask frames of tissue for the light's fall-off k.

    - endolab calibrate-light video.mp4 --camera camera.json --out endoscope.json
    - endolab calibrate-light a.png b.png --camera paper --out endoscope.json

    Parameters
    ----------
    source : paths
        A video, a folder of pictures, or pictures.
    camera : path
        A calibration of any kind, of which the camera is taken.
    out : path
        The calibration.
    overwrite : bool
        Replace what is there.
    frames : int
        So many, spread evenly; each takes some seconds.
    gamma : float
        Which frames don't tell.
    albedo : floats
        Of the wall's green, or R,G,B, if known.
    """
    import endolab as el
    from endolab.io.atomic import check_new, stage_file
    from endolab.io.cameras.formats import read_camera
    from endolab.io.datasets.known_endoscopes import CALIBRATIONS
    from endolab.reconstruction.sequence import as_frame

    check_new(out, overwrite, (*source, camera))
    lens = CALIBRATIONS[camera].camera if camera in CALIBRATIONS else read_camera(camera)
    video = el.open_frames(*source, calibration=el.Calibration(lens))
    spread = video.spread(frames)
    pictures = video.read(spread)
    read = (as_frame(*one) for one in pictures if not isinstance(one[1], ValueError))
    with stage_file(out) as temporary:  # before a long search
        with show_progress("frame") as show:
            estimate = el.estimate_light(
                read,
                lens,
                gamma=gamma,
                albedo=albedo,
                progress=lambda done, _: show(done, len(spread)),
            )
        found = el.Calibration(lens, estimate.photometry, estimate.evidence)
        el.write_calibration(found, temporary)
    for reason in estimate.refused.values():
        print(f"left out: {reason}")
    print(estimate.verdict)
    print(f"written to {out}; the gain is unknown, so distances are relative")


def convert(
    source: str,
    photometry: str | None = None,
    /,
    *,
    out: str,
    size: Size = None,
    overwrite: bool = False,
) -> None:
    """Make an endoscope.json of another program's calibration.

    - endolab convert camchain.yaml#cam1 --out endoscope.json
    - endolab convert opencv.xml --size 1440x1080 --out endoscope.json
    - endolab convert Endoscope_01 --out endoscope.json

    Parameters
    ----------
    source : path
        A calibration of any kind; or EndoMapper's folder Endoscope_XX.
    photometry : path
        Of EndoMapper, the light.
    out : path
        The calibration.
    size : COLUMNSxROWS
        Of the pictures, px, if the file does not say, or other pictures of its shape.
    overwrite : bool
        Replace what is there.
    """
    import endolab as el
    from endolab.io.atomic import check_new
    from endolab.io.datasets.endomapper import find_calibrations, read_endomapper
    from endolab.io.datasets.known_endoscopes import CALIBRATIONS
    from endolab.reconstruction.report import WITHOUT_RAY

    check_new(out, overwrite, (source, photometry))
    if source not in CALIBRATIONS and os.path.isdir(source):
        source, photometry = map(str, find_calibrations(source))
    if photometry is None:
        calibration = el.load_calibration(source, size=size)
    else:
        calibration = read_endomapper(source, photometry)
    el.write_calibration(calibration, out)
    print(f"written to {out}; `endolab calibrate --camera {out}` measures its light")
    without_ray = 1 - calibration.camera.field.valid.mean()
    if without_ray >= WITHOUT_RAY:
        print(
            f"{100 * without_ray:.0f} % of the pixels have no ray: the camera's model does not reach them"
        )
