"""The commands that solve: reconstruct, of a frame or a video, and sweep."""

import shlex
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from endolab._extras import lacking
from endolab.cli.solving import (
    Count,
    Diameter,
    Distance,
    Lamps,
    Rectangle,
    Several,
    Value,
    announce_compiling,
    load,
    load_endoscope,
    show_progress,
)
from endolab.reconstruction.settings import Settings, option_types, takes_settings

# The command line writes these otherwise than Python does.
OPTIONS = option_types() | {
    "contours": Literal["auto", "yes", "no"] | None,
    "known_distance": Distance,
    "known_diameter": Diameter,
}


@partial(takes_settings, types=OPTIONS)
def reconstruct(
    frame: str,
    /,
    *,
    calibration: str | None = None,
    fov: float | None = None,
    crop: Rectangle = None,
    lamp: Lamps = None,
    out: str,
    mask: str | None = None,
    settings: str | None = None,
    albedo: Value = None,
    overwrite: bool = False,
    uncertainty: bool = False,
    mesh: bool = False,
    prepare: bool = False,
    every: Count | None = None,
    limit: Count | None = None,
    threads: Count | None = None,
    **options: Any,
) -> None:
    """Make a surface of a frame, or of each frame of a video.

    - endolab reconstruct picture.jpg --out result
    - endolab reconstruct frame.png --calibration endoscope.json --out result
    - endolab reconstruct frame.png --calibration paper --width 480 --out quick
    - endolab reconstruct frame.png --calibration c3vd --channel green --out r
    - endolab reconstruct a.png --calibration paper --settings tuned.json --out r
    - endolab reconstruct video.mp4 --calibration paper --every 5 --out video

    Parameters
    ----------
    frame : path
        A picture (PNG, JPEG, TIFF, AVIF, DICOM ...), a folder of these, or a video.
    calibration : path
        endoscope.json, a known endoscope's name, or another program's file; a nominal fisheye without.
    fov : float
        Across what the picture shows, degrees, without a calibration (140).
    crop : COLUMN,ROW,WIDTH,HEIGHT
        The part of the calibration's picture that this one shows, as of a zoom, px; or the part of this one
        that is the calibration's, as an eye of a stereo picture.
    lamp : X,Y[,Z]
        Where a lamp stands, mm: x right, y down of the lens; once for each, instead of those listed.
    out : path
        Folder for the results.
    mask : path
        A picture, bright where the frame is to be used.
    settings : path
        Settings that the tuner exported; options given here win.
    albedo : floats
        Of a matt wall, or R,G,B, in place of the calibration's BRDF.
    overwrite : bool
        Write even where there are files of others.
    uncertainty : bool
        Add σ, the standard deviation of every pixel's distance; one to three times as long.
    mesh : bool
        Write mesh.ply too: triangles, cut at folds.
    prepare : bool
        Draw what was solved of the picture, and what was left out: preparation.png.
    every : int
        Of a video, every N-th frame only.
    limit : int
        Of a video, N frames at most.
    threads : int
        Cores at most; by default ENDOLAB_THREADS, or all.
    **options
    """
    from endolab.io.settings import read_settings
    from endolab.io.video import is_sequence

    is_video = is_sequence(frame)
    if (uncertainty or mesh or prepare) if is_video else every or limit:
        kinds = "--every and --limit are of a video, --uncertainty, --mesh and --prepare"
        raise ValueError(f"{kinds} of one picture")
    endoscope = load_endoscope(calibration, [frame], fov, crop)
    kept = None if settings is None else read_settings(settings)
    light = {"albedo": albedo, "lamps": lamp}
    known, keywords = load(endoscope, options, light, threads, kept)
    if is_video:
        if kept is not None and kept.found:
            text = "light and contours are found anew, in each frame: those of"
            print(f"{text} {settings} are of one picture")
        from endolab.batch.video import reconstruct_video

        with announce_compiling(), show_progress("frame") as follow_video:
            video = reconstruct_video(
                frame,
                known,
                out,
                mask=mask,
                every=every or 1,
                limit=limit,
                overwrite=overwrite,
                progress=lambda done, total, row: follow_video(done, total, row["frame"]),
                **keywords,
            )
        lost = [row["error"] for row in video.rows if row["error"]]
        for error in lost:
            print(f"not done: {error}")
        done = f"{len(video.rows) - len(lost)} of {len(video.rows)} frames"
        unit = next(row["unit"] for row in video.rows if row["unit"])
        print(f"{done} ({unit}), by an earlier call: {video.done_before}")
        print(f"written to {out}: {', '.join(path.name for path in video.paths)}")
        return

    import endolab as el
    from endolab.io.atomic import stage_folder
    from endolab.reconstruction.report import summary

    picture = el.read_frame(frame, known, mask)
    solve = partial(el.reconstruct, picture)
    if kept is not None and kept.found:
        found = el.load_found(kept.found)
        if found.is_of(picture) and kept.mask and mask is None:
            picture = el.read_frame(frame, known, kept.mask)
        solve = partial(el.solve_found, found)
        other = found.differences(picture, known, Settings.of(keywords))
        if other:
            solve = partial(el.reconstruct, picture)
            text = "light and contours are found anew: not of"
            print(f"{text} {settings} is {', '.join(other)}")
    if keywords.get("solver") == "fast_marching":
        keywords["snapshots"] = 12
    unrecorded = lacking("rerun")
    trusted = None
    read = (frame, calibration, mask, settings)
    with announce_compiling(), stage_folder(out, overwrite=overwrite, read=read) as folder:
        recording = nullcontext() if unrecorded else el.record(folder / "recording.rrd")
        with recording as recorder, show_progress("it") as show:

            def follow(iterate: Any) -> None:
                show(iterate.k, note=f"{iterate.stage}, energy {iterate.energy:.3e}")

            observers: list[Any] = [follow] if unrecorded else [recorder, follow]
            result = solve(known, observers=observers, **keywords)
            if uncertainty:
                draws = [lambda progress: show(progress.done, progress.of, "σ")]
                trusted = el.uncertainty_of(result, known, observers=draws)
                if recorder is not None:
                    recorder.add_uncertainty(trusted, result)
        el.save_result(
            result,
            folder,
            mesh=mesh,
            prepare=prepare,
            uncertainty=trusted,
            overwrite=True,
            undrawn=None if recorder is None else recorder.undrawn,
        )
        written = sorted(path.name for path in folder.iterdir())
    lines = [*summary(result, None if trusted is None else trusted.sigma)]
    if not result.metric:
        lines.append(
            "--median-distance, --known-distance or --known-diameter fixes the scale."
        )
    lines += [] if trusted is None else trusted.notes
    print(*lines, sep="\n")
    if unrecorded:
        print(f"There is no recording.rrd: {unrecorded}.")
    print(f"written to {out}: {', '.join(written)}")
    if calibration is None:
        tune = f"endolab tune {shlex.quote(frame)}"
        print(
            f"next: {tune} has λ under a slider; endolab calibrate makes the endoscope known"
        )


@partial(
    takes_settings,
    types=OPTIONS | dict.fromkeys(("lam", "xi", "regulariser"), Several),
)
def sweep(
    frames: tuple[str, ...],
    /,
    *,
    calibration: str | None = None,
    fov: float | None = None,
    crop: Rectangle = None,
    lamp: Lamps = None,
    out: str = "sweep.csv",
    truth: Annotated[tuple[str, ...] | None, Parameter(consume_multiple=True)] = None,
    recording: str | None = None,
    anew: bool = False,
    jobs: int | None = None,
    overwrite: bool = False,
    albedo: Value = None,
    threads: Count | None = None,
    **options: Any,
) -> None:
    """Make one table of errors and energies of many frames and settings.

    Of --lam, --xi and --regulariser several values can be given, each with each.

    - endolab sweep frame.png --calibration endoscope.json --lam 0.1,1,10 --xi d,1/d
    - endolab sweep frame.png --lam 1,0.01,0.1,10 --recording lam.rrd
    - endolab sweep *.png --calibration endoscope.json --jobs -1 --out sweep.csv
    - endolab sweep a.png b.png --calibration endoscope.json --truth a.npz b.npz

    Parameters
    ----------
    frames : paths
        Pictures: PNG, JPEG, TIFF, AVIF, DICOM ...
    calibration : path
        endoscope.json, a known endoscope's name, or another program's file; a nominal fisheye without.
    fov : float
        Across what the picture shows, degrees, without a calibration (140).
    crop : COLUMN,ROW,WIDTH,HEIGHT
        The part of the calibration's picture that this one shows, as of a zoom, px; or the part of this one
        that is the calibration's, as an eye of a stereo picture.
    lamp : X,Y[,Z]
        Where a lamp stands, mm: x right, y down of the lens; once for each, instead of those listed.
    out : path
        The table.
    truth : paths
        truth.npz of each frame.
    recording : path
        Of the answers for one frame, to scrub through λ with rerun: with the light and the contours that the
        first of them has found.
    anew : bool
        Find them anew for each answer of a recording.
    jobs : int
        How many at once (1); -1: as many as cores.
    overwrite : bool
        Replace a table that is there.
    albedo : floats
        Of a matt wall, or R,G,B, in place of the calibration's BRDF.
    threads : int
        Cores at most; by default ENDOLAB_THREADS, or all.
    **options
    """
    import endolab as el

    endoscope = load_endoscope(calibration, frames, fov, crop)
    light = {"albedo": albedo, "lamps": lamp}
    known, keywords = load(endoscope, options, light, threads)
    with announce_compiling(), show_progress("row") as show:
        rows = el.sweep(
            frames,
            known,
            truth=truth,
            table=out,
            overwrite=overwrite,
            recording=recording,
            anew=anew,
            n_jobs=jobs,
            progress=lambda done, total, row: show(done, total, row["frame"]),
            **keywords,
        )
    failed = [row for row in rows if row["error"]]
    for row in failed:
        print(f"not done: {row['frame']}, λ {row['lam']:g}: {row['error']}")
    print(f"{len(rows) - len(failed)} of {len(rows)} rows, written to {out}")
    if recording is not None and Path(recording).exists():
        print(f"answers are in {recording}: rerun {shlex.quote(recording)}")
