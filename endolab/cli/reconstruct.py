"""The commands that solve: reconstruct, of a frame or a video, and sweep."""

import argparse
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from endolab._extras import lacking
from endolab.cli.options import (
    add_command,
    add_overwrite,
    add_solving_options,
    add_threads,
    announce_compiling,
    count,
    integer,
    progress_bar,
    read_solving_options,
)

SNAPSHOTS = 12  # of a march, in its recording


def _reconstruct(arguments: argparse.Namespace) -> None:
    from endolab.io.video import is_sequence

    source, *others = arguments.frame
    if others:
        wanted = "one picture, one folder of a video's frames, or one video"
        raise ValueError(
            f"reconstruct takes {wanted}, got {len(others) + 1}; sweep takes pictures that are apart"
        )
    arguments.frame = source
    of_one_frame = ("mesh", "prepare", "uncertainty", "snapshots")
    if is_sequence(source):
        _refuse(arguments, of_one_frame, "a folder or a video")
        _reconstruct_video(arguments)
    else:
        _refuse(arguments, ("every", "limit"), "one picture")
        _reconstruct_frame(arguments)


def _refuse(arguments: argparse.Namespace, options: tuple[str, ...], kind: str) -> None:
    for option in options:
        if getattr(arguments, option):
            raise ValueError(f"--{option} is not of {kind}")


def _where(arguments: argparse.Namespace) -> dict[str, Any]:
    """Say what may be replaced in the folder of results, and what never."""
    inputs = [
        arguments.frame,
        arguments.calibration,
        arguments.mask,
        arguments.settings,
    ]
    return {"overwrite": arguments.overwrite, "inputs": inputs}


# One frame ------------------------------------------------------------------------------
def _reconstruct_frame(arguments: argparse.Namespace) -> None:
    from endolab.frames.frame import looks_like_depth
    from endolab.frames.prepare import prepare
    from endolab.io.atomic import stage_folder
    from endolab.io.datasets.folders import depth_layout
    from endolab.io.images import read_frame
    from endolab.reconstruction.reconstruct import reconstruct
    from endolab.solvers.solvers import DEFAULT_SOLVER

    calibration, keywords = read_solving_options(arguments)
    frame = read_frame(arguments.frame, calibration, arguments.mask)
    if depth_layout(arguments.frame) or looks_like_depth(frame.image):
        print(
            f"{arguments.frame} may be a depth map and no picture, by its name or for it has no noise."
        )
    solver = keywords.setdefault("solver", DEFAULT_SOLVER)
    if arguments.uncertainty:
        from endolab.reconstruction.uncertainty.estimate import check_solver

        check_solver(solver)
    if solver == "fast_marching" or arguments.snapshots is not None:
        keywords["snapshots"] = (
            SNAPSHOTS if arguments.snapshots is None else arguments.snapshots
        )
    unrecorded = lacking("rerun")
    if not unrecorded:
        from endolab.workbench.recording.recorder import record
    with announce_compiling(), stage_folder(arguments.out, **_where(arguments)) as folder:
        prepared = (
            prepare(frame, calibration, highlights="keep") if arguments.prepare else None
        )
        with (
            nullcontext() if unrecorded else record(folder / "recording.rrd") as recorder,
            progress_bar("it", "solving", keywords.get("snapshots")) as bar,
        ):

            def show(iterate: Any) -> None:
                name = (
                    "solving"
                    if iterate.round == 0
                    else f"{iterate.stage}, round {iterate.round}"
                )
                bar.set_description(name, refresh=False)
                bar.set_postfix_str(f"energy {iterate.energy:.3e}", refresh=False)
                bar.update(iterate.k - bar.n)  # the start is none

            observers: list[Any] = [show] if recorder is None else [recorder, show]
            picture = frame if prepared is None else prepared.frame
            result = reconstruct(picture, calibration, observers=observers, **keywords)
            uncertainty = (
                _uncertainty(result, calibration) if arguments.uncertainty else None
            )
            if recorder is not None and uncertainty is not None:
                recorder.add_uncertainty(uncertainty, result)

        from endolab.workbench.reports.result import (
            write_files,
        )  # now, as drawing takes half a second to load

        write_files(
            result, folder, mesh=arguments.mesh, prepared=prepared, uncertainty=uncertainty
        )
        written = sorted(path.name for path in folder.iterdir())
    _tell(result, solver, prepared, uncertainty)
    if unrecorded:
        print(f"There is no recording.rrd: {unrecorded}.")
    print(f"written to {arguments.out}: {', '.join(written)}")


def _uncertainty(result: Any, calibration: Any) -> Any:
    """How far a result can be trusted; None if the user had no patience for it."""
    from endolab.reconstruction.uncertainty.estimate import uncertainty_of

    with progress_bar("draw", "uncertainty") as bar:

        def show(progress: Any) -> None:
            bar.total = progress.of
            bar.update(progress.done - bar.n)

        try:
            return uncertainty_of(result, calibration, observers=[show])
        except KeyboardInterrupt:
            print("How far it can be trusted was not found out: interrupted.")
            return None


def _tell(result: Any, solver: str, prepared: Any, uncertainty: Any) -> None:
    """Sum a result up."""
    import numpy as np

    from endolab.reconstruction.sentences import notes, of_evidence
    from endolab.reconstruction.warnings import warnings
    from endolab.workbench.reports.result import summarise_uncertainty

    nearest, median, farthest = np.percentile(result.distance[result.mask], [1, 50, 99])
    steps = f"{result.iterations} iteration" + "s" * (result.iterations != 1)
    energy = f"energy {result.history[0]['energy']:.3e} to {result.energy:.3e}"
    print(f"{result.status.name}: {result.status.value}")
    print(
        f"{solver}, {steps}, {result.seconds:.2f} s, {energy}, {int(result.mask.sum())} pixels"
    )
    unit = result.problem.unit
    print(
        f"distance: median {median:.4g}, 1 % below {nearest:.4g}, 1 % above {farthest:.4g} ({unit})"
    )
    if not result.metric:
        ways = "--median-distance, --known-distance or --known-diameter fixes the scale."
        print(f"The gain is unknown, so distances have no unit; {ways}")
    preparation = () if prepared is None else prepared.notes
    for note in (*preparation, *notes(result), *of_evidence(result), *warnings(result)):
        print(note)
    if uncertainty is not None:
        numbers = summarise_uncertainty(result, uncertainty)
        sigma = numbers["sigma_percent"]
        scale = numbers["sigma_scale_percent"]
        shared = (
            f" An error of the scale, common to all, makes {scale:.2g} %."
            if result.metric
            else ""
        )
        print(
            f"σ of the distance: {sigma['median']:.2g} % for the median pixel, {sigma['10th']:.2g} to "
            f"{sigma['90th']:.2g} % for four in five.{shared}"
        )
        shares = ", ".join(
            f"{name} {100 * share:.0f} %"
            for name, share in numbers["dominant_source"].items()
        )
        print("\n".join([f"Pixels decided by: {shares}.", *numbers["notes"]]))
        if numbers["status"] == "STOPPED":
            print(f"σ was stopped after {numbers['draws']} draws.")


# Many frames ----------------------------------------------------------------------------
def _reconstruct_video(arguments: argparse.Namespace) -> None:
    from endolab.batch.video import reconstruct_video
    from endolab.io.datasets.folders import depth_layout

    calibration, keywords = read_solving_options(arguments)
    depths = sorted(
        path.name for path in Path(arguments.frame).glob("*") if depth_layout(path)
    )
    if depths:
        print(
            f"{arguments.frame} holds depth maps too, which are taken for frames, such as {depths[0]}."
        )
    with announce_compiling(), progress_bar("frame", "video") as bar:

        def show(done: int, total: int, row: dict[str, Any]) -> None:
            bar.total = total
            if not row["error"]:
                bar.set_postfix_str(f"energy {row['energy']:.3e}", refresh=False)
            bar.update(done - bar.n)

        video = reconstruct_video(
            arguments.frame,
            calibration,
            arguments.out,
            mask=arguments.mask,
            overwrite=arguments.overwrite,
            every=arguments.every or 1,
            limit=arguments.limit,
            progress=show,
            **keywords,
        )
    done = [row for row in video.rows if not row["error"]]
    for row in video.rows:
        if row["error"]:
            print(f"not done: {row['error']}")
    seconds = sum(row["seconds"] for row in done)
    warm = sum(row["warm"] for row in done)
    print(
        f"{len(done)} of {len(video.rows)} frames, {warm} started from the last, {seconds:.2f} s"
    )
    if video.done_before:
        print(f"done by an earlier call: {video.done_before} of them")
    middle = [row["median_distance"] for row in done]
    print(f"median distance: {min(middle):.4g} to {max(middle):.4g} ({done[0]['unit']})")
    if done[0]["unit"] != "mm":
        print(
            "The gain is unknown: distances have no unit, but nearly the same one in all frames."
        )
    written = [path.name for path in video.paths]
    if "recording.rrd" not in written:
        print(f"There is no recording.rrd: {lacking('rerun')}.")
    print(f"written to {arguments.out}: {', '.join(written)}")


def _sweep(arguments: argparse.Namespace) -> None:
    from endolab.batch.sweep import sweep

    calibration, keywords = read_solving_options(arguments)
    with announce_compiling(), progress_bar("row", "sweep") as bar:

        def show(done: int, total: int, row: dict[str, Any]) -> None:
            bar.total = total
            bar.set_postfix_str(f"{row['frame']} λ {row['lam']:g}", refresh=False)
            bar.update(done - bar.n)

        rows = sweep(
            arguments.frames,
            calibration,
            truth=arguments.truth,
            table=arguments.out,
            overwrite=arguments.overwrite,
            n_jobs=arguments.jobs,
            progress=show,
            **keywords,
        )
    failed = [row for row in rows if row["error"]]
    if len(failed) == len(rows):
        raise ValueError(f"no row could be made; the first: {failed[0]['error']}")
    for row in failed:
        where = f"{row['frame']}, ξ {row['xi']}, {row['regulariser']}, λ {row['lam']:g}"
        print(f"not done: {where}: {row['error']}")
    print(f"{len(rows) - len(failed)} of {len(rows)} rows")
    print(f"written to {arguments.out}")


# Parsers --------------------------------------------------------------------------------
def add_reconstruct_commands(commands: Any) -> None:
    """Add the commands `reconstruct` and `sweep` to a parser."""
    command = add_command(
        commands,
        "reconstruct",
        _reconstruct,
        "a frame or a video and a calibration in, surfaces out",
        "endolab reconstruct frame.png --calibration endoscope.json --out result",
        "endolab reconstruct frame.png --calibration paper --width 480 --out quick",
        "endolab reconstruct frame.png --calibration c3vd --channel green --out r",
        "endolab reconstruct a.png --calibration paper --settings tuned.json --out r",
        "endolab reconstruct video.mp4 --calibration paper --every 5 --out video",
    )
    text = "PNG, JPEG or TIFF, 8 or 16 bits; or a folder of these, or a video"
    command.add_argument("frame", nargs="+", metavar="FRAME", help=text)
    most_used = command.add_argument_group("most used").add_argument
    most_used("--out", required=True, metavar="DIR", help="folder for the results")
    add_solving_options(command, most_used)
    option = command.add_argument_group("output").add_argument
    add_overwrite(option)
    text = "add σ, the standard deviation of every pixel's distance; takes one to three times as long"
    option("--uncertainty", action="store_true", help=text)
    option(
        "--mesh", action="store_true", help="write mesh.ply too: triangles, cut at folds"
    )
    text = "leave out the dark lumen, find highlights, and draw it all: preparation.png"
    option("--prepare", action="store_true", help=text)
    text = f"of fast_marching in the recording (default {SNAPSHOTS})"
    option("--snapshots", type=integer, metavar="N", help=text)
    add_threads(option)
    option = command.add_argument_group("a video").add_argument
    option("--every", type=count, metavar="N", help="every N-th frame only")
    option("--limit", type=count, metavar="N", help="N frames at most")

    command = add_command(
        commands,
        "sweep",
        _sweep,
        "many frames and settings in, one table of errors and energies out",
        "endolab sweep frame.png --calibration endoscope.json --lam 0.1,1,10 --xi d,1/d",
        "endolab sweep *.png --calibration endoscope.json --jobs -1 --out sweep.csv",
        "endolab sweep a.png b.png --calibration endoscope.json --truth a.npz b.npz",
    )
    command.add_argument(
        "frames", nargs="+", metavar="FRAME", help="PNG, JPEG or TIFF, 8 or 16 bits"
    )
    most_used = command.add_argument_group("most used").add_argument
    most_used(
        "--out", default="sweep.csv", metavar="T.csv", help="the table (default sweep.csv)"
    )
    add_solving_options(command, most_used, swept=True)
    option = command.add_argument_group("output").add_argument
    add_overwrite(option)
    option("--truth", nargs="+", metavar="T.npz", help="truth.npz of each frame")
    text = "at once (default 1); -1: as many as cores"
    option("--jobs", type=integer, metavar="N", help=text)
    add_threads(option)
