"""The commands that solve: reconstruct, of a frame or a video, and sweep."""

import argparse
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Any, Self

from endolab._extras import lacking
from endolab.cli.options import (
    add_command,
    add_overwrite,
    add_solving_options,
    calibration_of,
    known_length,
    listed,
    settle,
    solver_of,
    solving_keywords,
    whole,
)
from endolab.cli.stopwatch import Stopwatch
from endolab.cli.streams import compiling_said

SNAPSHOTS = 12  # of a march, in its recording


LARGE, ENOUGH = 2_000_000, 1000  # px of a frame that takes long, and columns that show nearly as much


def _say_effort(arguments: argparse.Namespace, calibration: Any, what: str = "") -> None:
    """Say what a large frame takes before it is begun, and what helps."""
    from endolab.reconstruction.problem_setup import effort
    from endolab.reconstruction.reconstruct import channel_for

    camera = calibration.camera
    wide = arguments.width or camera.width
    high, less = (max(1, round(camera.height * width / camera.width)) for width in (wide, ENOUGH))
    if wide * high <= LARGE or wide <= ENOUGH:
        return
    channel = channel_for(arguments.channel, solver_of(arguments))
    seconds, needed = effort(wide, high, channel)
    quick, _ = effort(ENOUGH, less, channel)
    takes = f"about {float(f'{seconds:.2g}'):g} s and {needed / 1e9:.2g} GB"
    helps = f"--width {ENOUGH} takes about {float(f'{quick:.1g}'):g} s"
    print(f"{wide}x{high} px: {takes}{what}; {helps}", flush=True)


class _Progress:
    """An observer that shows a bar in a terminal, of the iterations of each stage that are done."""

    def __init__(self, total: int | None) -> None:
        from tqdm import tqdm

        self.bar = tqdm(total=total, unit="it", leave=False, desc="solving")
        self.close = self.bar.close

    def __call__(self, iterate: Any) -> None:
        name = "solving" if iterate.round == 0 else f"{iterate.stage}, round {iterate.round}"
        self.bar.set_description(name, refresh=False)
        self.bar.set_postfix_str(f"energy {iterate.energy:.3e}", refresh=False)
        self.bar.update(iterate.k - self.bar.n)  # the start is none


def _reconstruct(arguments: argparse.Namespace) -> None:
    from endolab.io.video import is_sequence, is_stream

    settle(arguments)
    source, *others = arguments.frame
    if others:
        wanted = "one picture, one folder of a video's frames, or one video"
        raise ValueError(
            f"reconstruct takes {wanted}, got {len(others) + 1}; sweep takes pictures that are apart"
        )
    arguments.frame = source
    if arguments.live or is_stream(source):
        _reconstruct_live(arguments)
    elif is_sequence(arguments.frame):
        _reconstruct_video(arguments)
    else:
        _reconstruct_frame(arguments)


class _Recording:
    """An observer that records once Rerun is loaded, which a thread does while the solver runs.

    The file is one of the outputs, so that it is written when they are; after a failure there is none.
    """

    def __init__(self, path: Path) -> None:
        self.seconds = 0.0  # that the solver waited
        self._path = path
        self._early: list[Any] = []  # iterates that nobody could record yet
        self._trust: tuple[Any, ...] = ()
        pool = ThreadPoolExecutor(1)
        self._recorder = pool.submit(self._load)
        pool.shutdown(wait=False)

    def _load(self) -> Any:
        from endolab.recording.recorder import record

        return record(self._path)

    def __call__(self, iterate: Any) -> None:
        started = time.perf_counter()
        self._early.append(iterate)
        if self._recorder.done():
            self._recorded()
        self.seconds += time.perf_counter() - started

    def _recorded(self) -> Any:
        recorder, early, self._early = self._recorder.result(), self._early, []
        for iterate in early:
            recorder(iterate)
        return recorder

    def add_trust(self, trust: Any, result: Any) -> None:
        """Show how far the result can be trusted, too."""
        self._trust = trust, result

    def write(self, _: Path) -> None:
        """Write the file."""
        recorder = self._recorded()
        if self._trust:
            recorder.add_trust(*self._trust)
        recorder.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, failure: object, *_: object) -> None:
        if failure is not None:
            with suppress(Exception):
                self._recorder.result().close()


def _reconstruct_frame(arguments: argparse.Namespace) -> None:
    for option in ("every", "limit"):
        if getattr(arguments, option) is not None:
            raise ValueError(f"--{option} is of a folder or a video, and {arguments.frame} is one picture")
    _reconstruct_drawn(arguments)


def _reconstruct_drawn(arguments: argparse.Namespace) -> None:
    import numpy as np

    from endolab.datasets.folders import depth_layout
    from endolab.io.atomic import staged_folder
    from endolab.io.images import read_frame
    from endolab.preprocessing.frame import looks_like_depth

    clock = Stopwatch(arguments.began)
    clock.lap("starting")
    calibration = calibration_of(arguments)
    frame = read_frame(arguments.frame, calibration, arguments.mask)
    clock.lap("reading")
    with compiling_said():
        from endolab.preprocessing.prepare import prepare
        from endolab.reconstruction.assumptions import notes, of_evidence
        from endolab.reconstruction.reconstruct import reconstruct
        from endolab.reports.result import trusted, write_files
        from endolab.uncertainty.trust import check_solver

        clock.lap("starting")
        _say_effort(arguments, calibration)
        if depth_layout(arguments.frame) or looks_like_depth(frame.image):
            print(f"{arguments.frame} may be a depth map and no picture, by its name or for it has no noise.")
        prepared = prepare(frame, calibration, highlights="keep") if arguments.prepare else None
        keywords = solving_keywords(arguments) | known_length(arguments)
        solver, snapshots = keywords["solver"], arguments.snapshots
        if arguments.trust:
            check_solver(solver)
        if snapshots is None and solver == "fast_marching":
            snapshots = SNAPSHOTS
        if snapshots is not None:
            keywords["snapshots"] = snapshots
        unrecorded = lacking("rerun")
        inputs = [arguments.frame, arguments.calibration, arguments.mask, arguments.settings]
        with staged_folder(arguments.out, overwrite=arguments.overwrite, inputs=inputs) as folder:
            with nullcontext() if unrecorded else _Recording(folder / "recording.rrd") as recording:
                observers: list[Any] = [] if recording is None else [recording]
                if sys.stderr.isatty():
                    observers.append(_Progress(snapshots))
                picture = frame if prepared is None else prepared.frame
                result = reconstruct(picture, calibration, observers=observers, **keywords)
                clock.lap("preparing")
                clock.share("preparing", [(stage.name, stage.seconds) for stage in result.stages])
                trust = _trust(result, calibration) if arguments.trust else None
                if trust is not None:
                    clock.lap("trust")
                if recording is not None:
                    if trust is not None:
                        recording.add_trust(trust, result)
                    clock.share("preparing", [("recording", recording.seconds)])
                    recording.write(folder)
                write_files(result, folder, mesh=arguments.mesh, prepared=prepared, trust=trust)
            near, middle, far = np.percentile(result.distance[result.mask], [1, 50, 99])
            said = [*notes(result), *of_evidence(result)]
            clock.lap("writing")
            seconds = clock.total
            written = sorted(path.name for path in folder.iterdir())
    print(f"{result.status.name}: {result.status.value}")
    count, first = result.iterations, result.history[0]["energy"]
    print(
        f"{solver}, {count} iteration{'' if count == 1 else 's'}, {result.seconds:.2f} s, "
        f"energy {f'{first:.3e} to ' if count else ''}{result.energy:.3e}, {int(result.mask.sum())} pixels; "
        f"{seconds:.1f} s in all"
    )
    print(f"distance: median {middle:.4g}, 1 % below {near:.4g}, 1 % above {far:.4g} ({result.problem.unit})")
    if trust is not None:
        said += _told_of(trusted(result, trust))
    if not result.metric:
        ways = "--median-distance, --known-distance or --known-diameter fixes the scale."
        print(f"The gain is unknown, so distances have no unit; {ways}")
    for note in (*(prepared.notes if prepared is not None else ()), *said):
        print(note)
    if unrecorded:
        print(f"There is no recording.rrd: {unrecorded}.")
    print(f"written to {arguments.out}: {', '.join(written)}")


def _trust(result: Any, calibration: Any) -> Any:
    """How far a result can be trusted; None if the user had no patience for it."""
    from tqdm import tqdm

    from endolab.uncertainty.trust import trust_of

    with tqdm(unit="draw", leave=False, disable=None, desc="trust") as bar:

        def show(progress: Any) -> None:
            bar.total = progress.of
            bar.update(progress.done - bar.n)

        try:
            return trust_of(result, calibration, observers=[show])
        except KeyboardInterrupt:
            print("How far it can be trusted was not found out: interrupted.")
            return None


def _told_of(numbers: dict[str, Any]) -> list[str]:
    """How far a result can be trusted, in sentences; parameter as of `report.json`."""
    sigma, scale = numbers["sigma_percent"], numbers["sigma_scale_percent"]
    told = f"σ of the distance: {sigma['median']:.2g} % for the median pixel, {sigma['10th']:.2g} to "
    told += f"{sigma['90th']:.2g} % for four in five; {scale:.2g} % is a scale that all share."
    shares = ", ".join(f"{name} {100 * share:.0f} %" for name, share in numbers["decided_by"].items())
    stopped = [f"σ was stopped after {numbers['draws']} draws."] * (numbers["status"] == "STOPPED")
    return [told, f"Who decided the pixels: {shares}.", *numbers["notes"], *stopped]


def _reconstruct_video(arguments: argparse.Namespace) -> None:
    from tqdm import tqdm

    from endolab.batch.video import FILES, reconstruct_video
    from endolab.datasets.folders import depth_layout
    from endolab.io.atomic import spare_inputs

    for option in ("every", "limit"):
        value = getattr(arguments, option)
        if value is not None and value < 1:
            raise ValueError(f"--{option} must be at least 1, got {value}")
    if arguments.mesh or arguments.prepare or arguments.trust or arguments.snapshots is not None:
        options = "--mesh, --prepare, --trust and --snapshots"
        raise ValueError(f"{options} are of one frame, not of a folder or a video")
    calibration = calibration_of(arguments)
    keywords = solving_keywords(arguments) | known_length(arguments)
    spare_inputs([Path(arguments.out) / name for name in FILES], [arguments.calibration, arguments.settings])
    _say_effort(arguments, calibration, " a frame")
    depths = sorted(path.name for path in Path(arguments.frame).glob("*") if depth_layout(path))
    if depths:
        print(f"{arguments.frame} holds depth maps too, which are taken for frames, such as {depths[0]}.")
    with compiling_said(), tqdm(unit="frame", leave=False, disable=None, desc="video") as bar:

        def show(done: int, total: int, row: dict[str, Any]) -> None:
            bar.total = total
            if not row["error"]:
                bar.set_postfix_str(f"energy {row['energy']:.3e}", refresh=False)
            bar.update(done - bar.n)

        found = reconstruct_video(
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
    done = [row for row in found.rows if not row["error"]]
    for row in found.rows:
        if row["error"]:
            print(f"not done: {row['error']}")
    for doubt in found.doubts:
        print(doubt)
    seconds, warm = sum(row["seconds"] for row in done), sum(row["warm"] for row in done)
    print(f"{len(done)} of {len(found.rows)} frames, {warm} started from the last, {seconds:.2f} s")
    if found.done_before:
        print(f"done by an earlier call: {found.done_before} of them")
    middle = [row["median_distance"] for row in done]
    print(f"median distance: {min(middle):.4g} to {max(middle):.4g} ({done[0]['unit']})")
    if done[0]["unit"] != "mm":
        print("The gain is unknown: distances have no unit, but nearly the same one in all frames.")
    written = [path.name for path in found.paths]
    if "recording.rrd" not in written:
        print(f"There is no recording.rrd: {lacking('rerun')}.")
    print(f"written to {arguments.out}: {', '.join(written)}")


LIVE_FILES = {
    "depth.npz": "the last frame's",
    "frames.csv": "a row for each frame taken",
    "recording.rrd": "the surfaces",
}


def _reconstruct_live(arguments: argparse.Namespace) -> None:
    """Follow a camera until it ends, or the user ends it, which is how a live view ends."""
    from contextlib import ExitStack

    from endolab.batch.table import write_rows
    from endolab.io.atomic import staged_folder
    from endolab.io.surfaces import save_depth

    for option in ("mesh", "prepare", "trust", "snapshots", "every"):
        if getattr(arguments, option):
            raise ValueError(f"--{option} is not of a camera, whose frames are taken as they come")
    calibration = calibration_of(arguments)
    keywords = solving_keywords(arguments) | known_length(arguments)
    keywords = {name: value for name, value in keywords.items() if value is not None}
    if arguments.regulariser == "auto":
        del keywords["regulariser"]  # that of a live view
    rows: list[dict[str, Any]] = []
    with ExitStack() as ending:
        views, files = [], [*LIVE_FILES][: 2 if lacking("rerun") else 3]
        depth, table, recording = LIVE_FILES
        if arguments.out is not None:
            inputs = [arguments.frame, arguments.calibration, arguments.mask, arguments.settings]
            how = {"overwrite": arguments.overwrite, "inputs": inputs}
            folder = ending.enter_context(staged_folder(arguments.out, **how))
            if recording in files:
                from endolab.recording.live import LiveView

                views.append(LiveView(folder / recording))
        if arguments.live:
            from endolab.recording.live import LiveView

            try:
                views.append(LiveView())
            except OSError as error:
                if arguments.out is None:
                    raise
                print(error)
        for view in views:
            ending.callback(view.close)
        tally, last = _follow(arguments, calibration, keywords, views, rows)
        if arguments.out is not None:
            if not rows:
                raise KeyboardInterrupt
            write_rows(folder / table, [*rows[0]], rows)
            if last is None:
                files.remove(depth)
            else:
                save_depth(folder / depth, last, last.metric)
    print(tally)
    for view in views:
        if view.left_out and not view.gone:
            where = "the recording" if view.full else "the view"
            print(f"{view.left_out} of them are not in {where}")
    if arguments.out is not None:
        print(f"written to {arguments.out}: {', '.join(f'{name} ({LIVE_FILES[name]})' for name in files)}")


def _follow(
    arguments: argparse.Namespace,
    calibration: Any,
    keywords: dict[str, Any],
    views: list[Any],
    rows: list[dict[str, Any]],
) -> tuple[Any, Any]:
    """Take frame after frame, show it and note a row of it, until the end.

    Return the tally, and the last result, None if there was none.
    """
    from contextlib import closing, suppress

    from tqdm import tqdm

    from endolab.batch.live import LIVE_WIDTH, Tally, live_row, reconstruct_live

    width, channel = (
        arguments.width or min(LIVE_WIDTH, calibration.camera.width),
        arguments.channel or "green",
    )
    print(f"live: {width} px wide, channel {channel} (--width, --channel); Ctrl-C ends it", flush=True)
    last = None
    tally, how = Tally(), {"mask": arguments.mask, "limit": arguments.limit}
    steps = reconstruct_live(arguments.frame, calibration, **how, **keywords)
    with (
        compiling_said(),
        tqdm(unit="frame", leave=False, disable=None, desc="live") as bar,
        closing(steps),
        suppress(KeyboardInterrupt),
    ):
        for step in steps:
            tally.add(step)
            row = live_row(step)
            if arguments.out is not None:
                rows.append(row)
            if step.result is not None:
                last = step.result
                plotted = {"rate": tally.rate, "lag": 1000 * step.lag, "dropped": step.dropped}
                plotted["median_distance"] = row["median_distance"]
                for view in views:
                    view(step.index, step.result, plotted)
            bar.set_postfix_str(f"lag {1000 * step.lag:.0f} ms, {tally.dropped} dropped", refresh=False)
            bar.update()
            if arguments.live and arguments.out is None and all(view.gone for view in views):
                break  # the window is closed
    return tally, last


class _Live(argparse.Action):
    """Take a live view, for which nothing need be written."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, *given: Any) -> None:
        setattr(namespace, self.dest, True)
        for action in parser._actions:
            if action.dest == "out":
                action.required = False


def _sweep(arguments: argparse.Namespace) -> None:
    from tqdm import tqdm

    from endolab.batch.sweep import sweep

    settle(arguments)
    keywords = solving_keywords(arguments)
    for name, kind in (("lam", float), ("xi", str), ("regulariser", str)):
        keywords[name] = listed(keywords[name], name, kind)
    if arguments.jobs < 1 and arguments.jobs != -1:
        raise ValueError(f"--jobs must be at least 1, or -1 for every core, got {arguments.jobs}")
    calibration = calibration_of(arguments)
    _say_effort(arguments, calibration, " a row")
    made = 0
    with compiling_said(), tqdm(unit="row", leave=False, disable=None, desc="sweep") as bar:

        def show(done: int, total: int, row: dict[str, Any]) -> None:
            nonlocal made
            made += 1
            bar.total = total
            bar.set_postfix_str(f"{row['frame']} λ {row['lam']:g}", refresh=False)
            bar.update(done - bar.n)

        rows = sweep(
            arguments.frames,
            calibration,
            truth=arguments.truth,
            table=arguments.out,
            n_jobs=arguments.jobs,
            backend=arguments.backend,
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
    if made < len(rows):
        print(f"made by an earlier call: {len(rows) - made} of them")
    print(f"written to {arguments.out}")


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
        "endolab reconstruct 0 --calibration endoscope.json --live",
    )
    option = command.add_argument
    how = "PNG, JPEG or TIFF, 8 or 16 bits; or a folder of these, or a video; or a camera's number or URL"
    option("frame", nargs="+", metavar="FRAME", help=how)
    add_solving_options(command)
    option("--out", required=True, metavar="DIR", help="folder for the results")
    add_overwrite(command)
    option("--mask", metavar="M.png", help="bright where the frame is to be used")
    how = f"of fast_marching in the recording (default {SNAPSHOTS})"
    option("--snapshots", type=whole, metavar="N", help=how)
    how = "leave out text and dark lumen, undo interlacing, and draw it all: preparation.png"
    option("--prepare", action="store_true", help=how)
    option("--mesh", action="store_true", help="write mesh.ply too: triangles, torn at folds")
    how = "tell how far each pixel can be trusted: sigma in depth.npz; takes a few solves' time"
    option("--trust", action="store_true", help=how)
    option("--every", type=whole, metavar="N", help="of a video, every N-th frame only")
    option("--limit", type=whole, metavar="N", help="of a video, N frames at most")
    how = "show a camera's surfaces, or a video's at its own rate: always the newest frame's, by default "
    how += "320 px wide and from green alone"
    option("--live", action=_Live, nargs=0, default=False, help=how)

    command = add_command(
        commands,
        "sweep",
        _sweep,
        "frames × λ × ξ × order: one table, which can be gone on with",
        "endolab sweep frame.png --calibration endoscope.json --lam 0.1,1,10 --xi d,1/d",
        "endolab sweep *.png --calibration endoscope.json --jobs -1 --out sweep.csv",
        "endolab sweep a.png b.png --calibration endoscope.json --truth a.npz b.npz",
    )
    option = command.add_argument
    option("frames", nargs="+", metavar="FRAME", help="PNG, JPEG or TIFF, 8 or 16 bits")
    option("--out", default="sweep.csv", metavar="T.csv", help="the table (default sweep.csv)")
    add_solving_options(command, several=True)
    option("--truth", nargs="+", metavar="T.npz", help="truth.npz of each frame")
    option("--jobs", type=whole, default=1, metavar="N", help="at once; -1: as many as cores")
    option("--backend", help="of joblib: loky (processes, the default), threading or dask")
