"""The command line: python -m endolab reconstruct, sweep, calibrate, simulate, tune and others."""

import argparse
import gc
import json
import math
import os
import signal
import sys
import threading
import warnings
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any, NoReturn

from endolab import __version__
from endolab._extras import MissingPackage
from endolab.cli.calibrate import (
    SHEET,
    SHEET_OPTIONS,
    add_calibration_commands,
    add_sheet_options,
    simulate_sheet,
)
from endolab.cli.options import add_command, add_overwrite, integer, number, wide
from endolab.cli.reconstruct import add_reconstruct_commands
from endolab.cli.tune import add_tune_command

# Of `simulate`, but for its calibration video.
FRAME_OPTIONS = ("texture", "fog", "highlights")
# Those of the system that ask for an end.
SIGNALS = [
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP")
    if hasattr(signal, name)
]
_ended: list[int] = []  # the signals that asked for an end


def _check_scenes_options(arguments: argparse.Namespace) -> None:
    """Refuse what a calibration video cannot be told, or nothing else can."""
    is_sheet = arguments.scene == SHEET
    for name in FRAME_OPTIONS if is_sheet else SHEET_OPTIONS:
        if getattr(arguments, name) is not None:
            kinds = ("one frame", "a calibration video")
            raise ValueError(
                f"--{name} is of {kinds[not is_sheet]}, and {arguments.scene} is {kinds[is_sheet]}"
            )


def _simulate(arguments: argparse.Namespace) -> None:
    import numpy as np

    from endolab.io.atomic import as_json, stage_folder, write_atomically
    from endolab.io.datasets.known_endoscopes import load_calibration
    from endolab.io.descriptions import write_calibration
    from endolab.io.images import write_image
    from endolab.io.surfaces import save_depth
    from endolab.model.schema import unknown_name
    from endolab.synthetic.rendering import render
    from endolab.synthetic.scenes import SCENES

    if arguments.scene not in (*SCENES, SHEET):
        raise unknown_name("scene", arguments.scene, (*SCENES, SHEET))
    _check_scenes_options(arguments)
    calibration = load_calibration(arguments.calibration)
    height = calibration.camera.height * arguments.width / calibration.camera.width
    calibration = calibration.resize(arguments.width, max(1, round(height)))
    if arguments.scene == SHEET:
        simulate_sheet(arguments, calibration)
        return
    names = ("noise", "bits", "seed", *FRAME_OPTIONS)
    given = {name: getattr(arguments, name) for name in names}
    chosen = {name: value for name, value in given.items() if value is not None}
    with stage_folder(arguments.out, overwrite=arguments.overwrite) as folder:
        rendered = render(
            SCENES[arguments.scene], calibration.camera, calibration.photometry, **chosen
        )
        write_image(folder / "frame.png", rendered.image, arguments.bits)
        used = replace(calibration, photometry=rendered.photometry)
        write_calibration(used, folder / "endoscope.json")
        save_depth(folder / "truth.npz", rendered, True)
        facts = {"endolab": 1, "scene": arguments.scene} | chosen
        write_atomically(folder / "report.json", as_json(facts))
    known = rendered.distance[rendered.mask]
    print(
        f"{arguments.scene}: {known.min():.1f} to {known.max():.1f} mm, median {np.median(known):.1f} mm"
    )
    print(f"written to {arguments.out}: endoscope.json, frame.png, report.json, truth.npz")


def _evaluate(arguments: argparse.Namespace) -> None:
    from endolab.batch.evaluate import evaluate, evaluate_folder
    from endolab.io.datasets.known_endoscopes import load_calibration

    names = ("kind", "unit", "truth_kind", "truth_unit", "mask", "scale", "max_angle")
    options = {name: getattr(arguments, name) for name in names}
    if arguments.calibration is not None:
        options["camera"] = load_calibration(arguments.calibration).camera
    given = (arguments.depth, arguments.truth)
    if os.path.isdir(arguments.depth):
        found, alone = evaluate_folder(*given, **options)
        _print_table(found, alone, arguments.json)
        return
    found = [evaluate(*given, **options)]
    if arguments.json:
        print(json.dumps(_evaluation_as_json(found[0]), indent=2))
    else:
        _print_evaluation(found[0])


def _print_evaluation(made: Any) -> None:
    e = made.errors
    if made.resampled_from:
        rows, columns = made.resampled_from
        print(f"The truth, {columns}x{rows} px, is resampled to the result's size.")
    print(f"{e.pixels} pixels, estimate multiplied by {e.scale:.4g} (scale: {made.scale})")
    print(
        f"{made.kind:<9} mean {e.mean_mm:.4g} mm, median {e.median_mm:.4g} mm, RMSE {e.rmse_mm:.4g} mm"
    )
    print(
        f"          mean {e.mean_percent:.4g} % (AbsRel), median {e.median_percent:.4g} %"
    )
    print(
        f"          δ < 1.25: {e.within_125:.4g} %, 1.25²: {e.within_125_squared:.4g} %, "
        f"1.25³: {e.within_125_cubed:.4g} %"
    )
    if not math.isnan(e.rmse_z_mm):
        print(f"z         RMSE {e.rmse_z_mm:.4g} mm")
    if not math.isnan(e.mean_degrees):
        print(f"normals   mean {e.mean_degrees:.4g}°, median {e.median_degrees:.4g}°")
    if made.coverage is not None:
        trusted = made.coverage
        print(
            f"σ         {trusted.within_one:.0f} % within 1 σ, {trusted.within_two:.0f} % within 2 σ "
            f"(68 and 95 if right); its rank follows the error's by {trusted.spearman:.2f}"
        )


def _evaluation_as_json(made: Any) -> dict[str, Any]:
    content = _as_json(made.errors) | {"depth": made.name, "kind": made.kind}
    if made.coverage is not None:
        content["coverage"] = _as_json(made.coverage)
    if made.resampled_from:
        content["truth_resampled_from"] = made.resampled_from[::-1]
    return content


def _print_table(found: list[Any], alone: list[str], as_json: bool) -> None:
    """Print a row for each depth map of a folder, their mean and their median."""
    import numpy as np

    if as_json:
        frames = [_evaluation_as_json(made) for made in found]
        print(json.dumps({"frames": frames, "without_partner": alone}, indent=2))
        return
    columns = {
        "AbsRel %": "mean_percent",
        "RMSE mm": "rmse_mm",
        "RMSE z mm": "rmse_z_mm",
        "δ<1.25 %": "within_125",
        "δ<1.25² %": "within_125_squared",
        "δ<1.25³ %": "within_125_cubed",
        "scale": "scale",
    }
    values = [[getattr(made.errors, name) for name in columns.values()] for made in found]
    rows = [*values, np.mean(values, axis=0), np.median(values, axis=0)]
    labels = [*(made.name for made in found), "mean", "median"]
    wide = max(map(len, labels))
    print(" " * wide + "".join(f"{name:>11}" for name in columns))
    for label, row in zip(labels, rows, strict=True):
        print(f"{label:<{wide}}" + "".join(f"{value:>11.4g}" for value in row))
    if alone:
        print(f"{len(alone)} without a partner: {to_one_line(', '.join(alone))}")


def _as_json(facts: Any) -> dict[str, Any]:
    """Return the fields of a dataclass of numbers; None for what is not known."""
    return {
        name: value if math.isfinite(value) else None
        for name, value in asdict(facts).items()
    }


def _lab(arguments: argparse.Namespace) -> None:
    from endolab.cli.lab import open_lab

    open_lab(arguments.notebooks, arguments.port, arguments.jupyter)


class _Parser(argparse.ArgumentParser):
    """A parser whose complaint is one sentence."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"endolab: {to_one_line(message)}; see {self.prog} --help\n")


class _Completion(argparse.Action):
    """Print what a shell needs to complete commands and options, and end."""

    def __call__(self, parser: argparse.ArgumentParser, *given: Any) -> None:
        import shtab

        print(shtab.complete(parser, given[1]))
        parser.exit()


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="endolab", description="See how one endoscope frame becomes 3D.")
    parser.epilog = "endolab COMMAND --help shows what a command takes, with examples."
    parser.add_argument("--version", action="version", version=f"endolab {__version__}")
    shells = ("bash", "zsh", "tcsh")
    parser.add_argument(
        "--completion", action=_Completion, choices=shells, help="print it for this shell"
    )
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    add_reconstruct_commands(commands)

    command = add_command(
        commands,
        "simulate",
        _simulate,
        "render a scene: a frame with its truth",
        "endolab simulate colon --out sim",
        "endolab simulate tube --calibration simple --width 320 --noise 0 --out sim",
        "endolab simulate sheet --target vicalib_folded --video --out v",
    )
    option = command.add_argument
    option(
        "scene",
        metavar="SCENE",
        help="plane, curved, tube or colon; sheet: a calibration video",
    )
    option("--out", required=True, metavar="DIR", help="folder for the results")
    add_overwrite(command.add_argument)
    option(
        "--calibration",
        default="paper",
        metavar="CAL",
        help="endoscope.json, or a name (default paper)",
    )
    option(
        "--width", type=wide, default=640, metavar="PX", help="of the frame (default 640)"
    )
    option(
        "--noise",
        type=number,
        default=1.0,
        metavar="GREY",
        help="standard deviation (default 1 of 255)",
    )
    option(
        "--bits",
        type=integer,
        default=8,
        choices=(8, 16),
        help="of each channel (default 8)",
    )
    option("--texture", type=number, metavar="S", help="sd of the albedo's logarithm")
    option("--fog", type=number, metavar="PER_MM", help="attenuation")
    option(
        "--highlights", type=number, metavar="S", help="share of light a wet film mirrors"
    )
    option(
        "--seed",
        type=integer,
        default=0,
        metavar="N",
        help="of all that is random (default 0)",
    )
    add_sheet_options(command)

    add_calibration_commands(commands)

    command = add_command(
        commands,
        "evaluate",
        _evaluate,
        "compare a depth map with the truth",
        "endolab evaluate result/depth.npz sim/truth.npz",
        "endolab evaluate result/depth.npz sim/truth.npz --max-angle 60 --json",
        "endolab evaluate result/depth.npz 0001_depth.png --scale median",
        "endolab evaluate predictions truths --unit 1000 --calibration cal.json",
    )
    option = command.add_argument
    text = "depth.npz, .npy, .npz, .png, .tif of any program, or a folder of these"
    option("depth", metavar="DEPTH", help=text)
    text = "the same, or a depth map of C3VD, SimCol3D or UCL 2019; or a folder"
    option("truth", metavar="TRUTH", help=text)
    option(
        "--scale",
        choices=("none", "median", "medians"),
        help="median of d*/d, or ratio of medians; default: median for relative units, else none",
    )
    for which, unit in (("", "none: relative"), ("truth-", "1")):
        text = "what it holds, if no name says so (default z)"
        option(f"--{which}kind", choices=("z", "distance"), help=text)
        text = f"that 1 in the file stands for (default {unit})"
        option(f"--{which}unit", type=number, metavar="MM", help=text)
    text = "endoscope.json, or a name: turns z into distance"
    option("--calibration", metavar="CAL", help=text)
    option("--mask", metavar="MASK.png", help="bright where it counts, of the truth's size")
    option(
        "--max-angle",
        type=number,
        default=90.0,
        metavar="DEG",
        help="only pixels this near the axis",
    )
    option("--json", action="store_true", help="print JSON")

    add_tune_command(commands)

    command = add_command(
        commands,
        "lab",
        _lab,
        "open JupyterLab on the notebooks",
        "endolab lab",
        "endolab lab --notebooks mine --port 9000 -- --no-browser",
    )
    option = command.add_argument
    option(
        "--notebooks",
        metavar="DIR",
        help="other notebooks than endolab's own; its parent is shown too",
    )
    option(
        "--port",
        type=integer,
        default=8888,
        metavar="N",
        help="the next free one (default 8888)",
    )
    option("jupyter", nargs="*", metavar="OPTION", help="passed on to JupyterLab, after --")
    return parser


def to_one_line(error: object) -> str:
    """Return what an error says in one printable line, without the middle of what is too long."""
    from endolab.model.schema import shorten

    text = str(error) or "out of memory"
    if isinstance(error, OSError) and error.strerror:  # the system's own words
        text = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    text = text.replace("overwrite=True", "--overwrite")  # as one says it here
    return shorten(text, 600)  # what was typed may be as long as it likes


class _ToldToEnd(KeyboardInterrupt):
    """An interrupt that Python leaves to us: one of its own that passes exec() makes the exit status its."""


def _interrupt(number: int, _: object) -> NoReturn:
    _ended.append(number)
    raise _ToldToEnd


def _interrupt_again(what: Any) -> None:
    """Interrupt again, where Python dropped an interrupt, as it does while Numba compiles."""
    if issubclass(what.exc_type, KeyboardInterrupt):
        threading.Timer(0.05, signal.raise_signal, [signal.SIGINT]).start()
    else:
        sys.__unraisablehook__(what)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command: 0 when all is done, 2 after bad input, which is said in one sentence on stderr."""
    try:
        arguments = _parser().parse_args(sys.argv[1:] if argv is None else argv)
        if getattr(arguments, "threads", None) is not None:
            os.environ["ENDOLAB_THREADS"] = str(arguments.threads)
        if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
            raise ValueError("NUMBA_DISABLE_JIT is set, and endolab's loops need Numba")
        arguments.run(arguments)
        sys.stdout.flush()
    except BrokenPipeError:  # as after `| head -1`: nobody reads on
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141  # as shells know it
    except (ValueError, OSError, MemoryError, MissingPackage) as error:
        print(f"endolab: {to_one_line(error)}", file=sys.stderr)
        return 2
    except (KeyboardInterrupt, RuntimeError) as error:
        if isinstance(error, RuntimeError) and not _ended:
            raise
        # A RuntimeError is Numba's, that it could not end.
        reason = str(error) if isinstance(error, KeyboardInterrupt) else ""
        print(f"endolab: {reason or 'interrupted; nothing was written'}", file=sys.stderr)
        return 128 + (_ended or [signal.SIGINT])[0]
    return 0


def run() -> NoReturn:
    """Run a command as a process of its own, which ends on SIGTERM and SIGHUP as on Ctrl-C."""
    for asking in SIGNALS:
        if signal.getsignal(asking) is not signal.SIG_IGN:  # as of nohup
            signal.signal(asking, _interrupt)
    sys.unraisablehook = _interrupt_again
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed, as after `>&-`
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115 - open to the end
        getattr(sys, name).reconfigure(errors="backslashreplace")
    if not sys.warnoptions:  # others' warnings say nothing to its user
        warnings.filterwarnings("ignore", module=r"(?!endolab\b)")
    # Of a disk that is full Rerun complains on its own, before `recording.stream.Sink` says so in a sentence.
    os.environ.setdefault("RUST_LOG", "warn,re_log_encoding=off,re_sdk=off")
    # What is imported stays: to look through it takes a sixth of all importing.
    gc.set_threshold(50_000)
    status = main()
    for asking in SIGNALS:
        signal.signal(asking, signal.SIG_IGN)  # it ends already
    gc.freeze()  # nothing need be looked through for what could be freed when Python ends: half a second
    raise SystemExit(status)
