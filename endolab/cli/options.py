"""How the command line says how to solve: the options, in one place, and the keywords they stand for."""

import argparse
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

CHANNELS = ("auto", "separated", "red", "green", "blue", "grey")
MOST = 2**31 - 1  # that a whole number may be; no count is larger
CONTOURS = {"auto": None, "yes": True, "no": False}
USUAL = {"xi": "1/d", "regulariser": "auto", "lam": 1.0, "contours": "auto"}  # where nothing is said
LENGTHS = ("median_distance", "known_distance", "known_diameter")  # one of which may fix the scale
CHOSEN = ("highlights", "epsilon", "threshold", "max_iterations")  # handed on only if they were given
KNOWN = {"distance": "MM,COLUMN,ROW", "diameter": "MM,COLUMN1,ROW1,COLUMN2,ROW2"}


def whole(text: str) -> int:
    """Read a whole number that an option was given."""
    try:
        value = int(text)
    except ValueError:
        value = MOST + 1
    if abs(value) > MOST:
        raise argparse.ArgumentTypeError(f"expected a whole number, found {text!r}")
    return value


def number_or_auto(text: str) -> float | str:
    """Read a number, or the word that leaves it to the program."""
    return text if text == "auto" else number(text)


def number(text: str) -> float:
    """Read a number that an option was given."""
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected a number, found {text!r}") from None


def add_command(
    commands: Any, name: str, run: Callable[[argparse.Namespace], None], does: str, *examples: str
) -> argparse.ArgumentParser:
    """Add the parser of a command, whose help ends with `examples`, and return it."""
    parser: argparse.ArgumentParser = commands.add_parser(
        name,
        help=does,
        description=f"{does[0].upper()}{does[1:]}.",
        epilog="\n  ".join(["examples:", *examples]),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.set_defaults(run=run)
    return parser


def add_overwrite(parser: argparse.ArgumentParser) -> None:
    """Add the option of every command that writes results."""
    how = "replace files that endolab did not write, too"
    parser.add_argument("--overwrite", action="store_true", help=how)


def matt_wall(albedo: str) -> Any:
    """Read the albedo of a matt wall, or three, as its BRDF."""
    from endolab.model.brdf import Lambertian

    try:
        values = tuple(float(part) for part in albedo.split(","))
        return Lambertian(values[0] if len(values) == 1 else values)  # type: ignore[arg-type]
    except ValueError as error:
        raise ValueError(f"--albedo must be one number in (0, 1] or three (R,G,B), got {albedo}") from error


def _of_a_wall(calibration: Any, albedo: str | None) -> Any:
    """Replace the BRDF by that of a matt wall, as one must after calibrating on a sheet of paper."""
    if albedo is None:
        evidence = calibration.evidence.get("photometry")
        if isinstance(evidence, dict) and evidence.get("brdf_of"):
            print("The BRDF is that of the calibration sheet; --albedo 0.5 takes a matt wall instead.")
        return calibration
    return replace(calibration, photometry=replace(calibration.photometry, brdf=matt_wall(albedo)))


def calibration_of(arguments: argparse.Namespace) -> Any:
    """Return the calibration that the options name, with the wall that they say."""
    from endolab.datasets.known_endoscopes import load_calibration

    calibration = load_calibration(arguments.calibration)
    settings = getattr(arguments, "believed", None)  # of the light, by a settings file
    if settings is None:
        return _of_a_wall(calibration, arguments.albedo)
    light = dict(settings.photometry)
    if arguments.albedo is not None:
        light.pop("albedo", None)
    known = replace(settings, photometry=light).believed(calibration)
    return known if "albedo" in light else _of_a_wall(known, arguments.albedo)


def add_solving_options(parser: argparse.ArgumentParser, several: bool = False) -> None:
    """Add what `solving_keywords` and `calibration_of` read; `several`: λ, ξ and order may be lists."""
    add = parser.add_argument
    more, orders, weights = (
        f"; several as {example}" if several else "" for example in ("d,1/d", "first,curvature", "0.1,1,10")
    )
    add("--calibration", required=True, metavar="CAL", help="endoscope.json, or a known endoscope's name")
    add("--solver", metavar="NAME", help="facing, fast_marching, gauss_newton (default) or primal_dual")
    add("--xi", metavar="ξ", help=f"what the regulariser sees: 1/z, d or 1/d (default){more}")
    forms = f"first, second, curvature or auto (default): curvature, or second if light bounced{orders}"
    add("--regulariser", metavar="ORDER", help=forms)
    chosen = "" if several else "; auto: chosen for the picture, see the report"
    weight = f"its weight; larger is smoother (default 1){weights}{chosen}"
    add("--lam", type=str if several else number_or_auto, metavar="λ", help=weight)
    channels = (
        "auto (default): what the frame's evidence allows; separated: all three colours, light that bounced "
    )
    channels += "taken out; red, green, blue or grey: this alone (green with the solvers of the paper)"
    size = "derivative of ξ above which the regulariser charges its size, not its square (default 1e-3)"
    add("--epsilon", type=number, metavar="ε", help=size)
    size = "error of a stored value above which the picture is charged so (default 0.05)"
    add("--threshold", type=number, metavar="ρ", help=size)
    add("--max-iterations", type=whole, metavar="N", help="steps of the solver at most")
    add("--channel", metavar="NAME", help=channels)
    add("--albedo", metavar="A", help="of a matt wall, or R,G,B, in place of the calibration's BRDF")
    folds = "whether folds may hide what is behind them; auto: if that explains the picture better"
    add("--contours", choices=tuple(CONTOURS), help=folds)
    treated = "what to do with mirrored light (default: ignore it with auto and separated, else keep)"
    add("--highlights", choices=("keep", "ignore", "inpaint"), help=treated)
    add("--median-distance", type=number, metavar="MM", help="fix the scale of the result")
    if not several:
        add("--known-distance", metavar=KNOWN["distance"], help="fix it by the distance at a pixel")
        length = "fix it by the length between the surface at two pixels: a polyp, the lumen"
        add("--known-diameter", metavar=KNOWN["diameter"], help=length)
        saved = "how to solve, as the tuner saved it; options given here win"
        add("--settings", metavar="FILE.json", help=saved)
    add("--width", type=whole, metavar="PX", help="shrink the frame to this width first")
    add("--smooth", type=number, metavar="PX", help="blur the light first (default: by the noise)")
    add("--threads", type=whole, metavar="N", help="cores at most (default: ENDOLAB_THREADS, or all)")


def settle(arguments: argparse.Namespace) -> None:
    """Fill in what no option said: from the settings file, if there is one, and then by default."""
    if getattr(arguments, "settings", None) is not None:
        from endolab.io.settings import read_settings

        settings = read_settings(arguments.settings)
        arguments.believed = settings
        said = {name: _as_option(value) for name, value in settings.keywords.items()}
        if any(getattr(arguments, name) is not None for name in LENGTHS):
            said = {name: value for name, value in said.items() if name not in LENGTHS}
        _fill(arguments, said)
    _fill(arguments, USUAL)


def _fill(arguments: argparse.Namespace, values: Mapping[str, Any]) -> None:
    for name, value in values.items():
        if getattr(arguments, name, None) is None:
            setattr(arguments, name, value)


def _as_option(value: Any) -> Any:
    """Say a keyword of `reconstruct` as its option does."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, tuple):
        return ",".join(_as_option(part) if isinstance(part, tuple) else repr(part) for part in value)
    return value


@contextmanager
def threads_of(arguments: argparse.Namespace) -> Iterator[None]:
    """Let loops, and processes that are started, have as many cores as the options say, within."""
    count, before = getattr(arguments, "threads", None), os.environ.get("ENDOLAB_THREADS")
    if count is not None and count < 1:
        raise ValueError(f"--threads must be at least 1, got {count}")
    try:
        if count is not None:
            os.environ["ENDOLAB_THREADS"] = str(count)
        yield
    finally:
        if count is not None and before is None:
            os.environ.pop("ENDOLAB_THREADS", None)
        elif before is not None:
            os.environ["ENDOLAB_THREADS"] = before


def solver_of(arguments: argparse.Namespace) -> str:
    """Return the solver that the options name, or the default."""
    from endolab.depth.solvers import DEFAULT_SOLVER

    return DEFAULT_SOLVER if arguments.solver is None else str(arguments.solver)


def solving_keywords(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the keywords of `endolab.reconstruct` that the options stand for."""
    from endolab.model.schema import unknown_name

    names = ("xi", "regulariser", "lam", "channel", "width", "smooth", "median_distance")
    keywords = {name: getattr(arguments, name) for name in names}
    if arguments.channel not in (None, *CHANNELS):
        raise unknown_name("channel", arguments.channel, CHANNELS)
    if arguments.max_iterations is not None and arguments.max_iterations < 1:
        raise ValueError(f"--max-iterations must be at least 1, got {arguments.max_iterations}")
    chosen = {name: getattr(arguments, name) for name in CHOSEN}
    chosen["contours"] = CONTOURS[arguments.contours]
    return (
        {"solver": solver_of(arguments)}
        | keywords
        | {key: value for key, value in chosen.items() if value is not None}
    )


def known_length(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the one length that the options know, as `known_distance` or `known_diameter`.

    ValueError in one sentence, if it is none, or if more than one option fixes the scale.
    """
    from endolab.reconstruction.scale import check_scale

    options = {"median-distance": arguments.median_distance}
    options |= {"known-distance": arguments.known_distance, "known-diameter": arguments.known_diameter}
    given = [f"--{name}" for name, value in options.items() if value is not None]
    if len(given) > 1:
        raise ValueError(f"{' and '.join(given)} exclude each other; give one")
    known: dict[str, Any] = {}
    for name, form in KNOWN.items():
        text = options[f"known-{name}"]
        if text is None:
            continue
        try:
            numbers = tuple(float(part) for part in text.split(","))
        except ValueError:
            numbers = ()
        if len(numbers) != form.count(",") + 1:
            example = f"30{',80' * form.count(',')}"
            raise ValueError(f"--known-{name} must be {form}, such as {example}, got {text}")
        length = numbers if name == "distance" else (numbers[0], numbers[1:3], numbers[3:5])
        known[f"known_{name}"] = length
    check_scale(**known)
    return known


def listed(text: object, name: str, kind: Callable[[str], Any]) -> list[Any]:
    """Read several values, ``0.1,1,10``."""
    try:
        return [kind(part.strip()) for part in str(text).split(",")]
    except ValueError as error:
        raise ValueError(f"--{name} must be numbers such as 0.1,1,10, got {text}") from error
