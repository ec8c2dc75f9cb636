"""How the command line says how to solve: the options, in one place, and the keywords they stand for."""

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

CHANNELS = ("auto", "separated", "red", "green", "blue", "grey")
LARGEST_COUNT = 2**31 - 1  # that a whole number may be; no count is larger
CONTOURS = {"auto": None, "yes": True, "no": False}
LENGTHS = ("median_distance", "known_distance", "known_diameter")  # one of which may fix the scale
SOLVING = (
    *("solver", "xi", "regulariser", "lam", "epsilon", "threshold", "max_iterations", "channel"),
    *("width", "smooth", "highlights", *LENGTHS),
)
COMPILING = "Compiling for this machine, a minute or so; only the first run does."
LOOPS = 170  # that a default reconstruction compiles
NOT_KEPT = "Compiling, a minute or so, in every run: NUMBA_CACHE_DIR can name a folder to keep it in."


# Values ---------------------------------------------------------------------------------
def whole(text: str) -> int:
    """Read a whole number that an option was given."""
    try:
        value = int(text)
    except ValueError:
        value = LARGEST_COUNT + 1
    if abs(value) > LARGEST_COUNT:
        raise argparse.ArgumentTypeError(f"expected a whole number, found {text!r}")
    return value


def count(text: str) -> int:
    """Read how many an option asks for."""
    if whole(text) < 1:
        raise argparse.ArgumentTypeError(f"expected at least 1, found {text!r}")
    return whole(text)


def wide(text: str) -> int:
    """Read a width, px."""
    if whole(text) < 16:
        raise argparse.ArgumentTypeError(f"expected at least 16 px, found {text!r}")
    return whole(text)


def number(text: str) -> float:
    """Read a number that an option was given."""
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected a number, found {text!r}") from None


def several(kind: Callable[[str], Any]) -> Callable[[str], list[Any]]:
    """Return what reads several values of a kind, ``0.1,1,10``."""
    return lambda text: [kind(part.strip()) for part in text.split(",")]


def albedo(text: str) -> float | tuple[float, ...]:
    """Read the albedo of a matt wall, or its three."""
    from endolab.model.brdf import Lambertian

    try:
        first, *others = several(float)(text)
        return Lambertian((first, *others) if others else first).albedo
    except ValueError as error:
        expected = "one number in (0, 1] or three (R,G,B)"
        raise argparse.ArgumentTypeError(f"expected {expected}, found {text!r}") from error


def _distance(text: str) -> tuple[float, ...]:
    return tuple(_numbers(text, "MM,COLUMN,ROW"))


def _diameter(text: str) -> tuple[Any, ...]:
    mm, *pixels = _numbers(text, "MM,COLUMN1,ROW1,COLUMN2,ROW2")
    return mm, tuple(pixels[:2]), tuple(pixels[2:])


def _numbers(text: str, form: str) -> list[float]:
    values = several(number)(text)
    if len(values) != form.count(",") + 1:
        raise argparse.ArgumentTypeError(f"expected {form}, found {text!r}")
    return values


# Options --------------------------------------------------------------------------------
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


def add_overwrite(option: Callable[..., Any]) -> None:
    """Add the option of every command that writes results."""
    option("--overwrite", action="store_true", help="write even where there are files of others")


def add_threads(option: Callable[..., Any]) -> None:
    """Add the option of every command that solves."""
    text = "cores at most (default: ENDOLAB_THREADS, or all)"
    option("--threads", type=count, metavar="N", help=text)


def add_solving_options(
    parser: argparse.ArgumentParser, most_used: Callable[..., Any], swept: bool = False
) -> None:
    """Add what `solving` reads, in groups; λ, ξ and order are lists if `swept`."""
    more, orders, weights = (
        f"; several as {example}" if swept else "" for example in ("d,1/d", "first,curvature", "0.1,1,10")
    )
    kinds: list[Any] = [several(str), several(number)] if swept else [str, number]

    add = most_used
    add("--calibration", required=True, metavar="CAL", help="endoscope.json, or a known endoscope's name")
    add("--width", type=count, metavar="PX", help="shrink the frame to this width first")
    text = f"weight of the regulariser; larger is smoother (default 1){weights}"
    add("--lam", type=kinds[1], metavar="λ", help=text)
    text = "auto (default): all three colours, indirect light removed, if the frame allows it; separated: "
    text += "always; red, green, blue or grey: this channel as it is (green with the paper's solvers)"
    add("--channel", choices=CHANNELS, metavar="NAME", help=text)

    add = parser.add_argument_group("surface").add_argument
    text = f"first, second, curvature or auto (default): curvature, or second if light bounced{orders}"
    add("--regulariser", type=kinds[0], metavar="ORDER", help=text)
    text = "whether folds may hide what is behind them; auto (default): if that explains the picture better"
    add("--contours", choices=tuple(CONTOURS), help=text)
    text = f"the map that is made smooth: 1/z, d or 1/d (default){more}"
    add("--xi", type=kinds[0], metavar="ξ", help=text)
    add("--solver", metavar="NAME", help="facing, fast_marching, gauss_newton (default) or primal_dual")
    add("--max-iterations", type=count, metavar="N", help="steps of the solver at most")
    text = "derivative of ξ above which the penalty grows linearly (default 1e-3)"
    add("--epsilon", type=number, metavar="ε", help=text)
    text = "error of a stored value above which the penalty grows linearly (default 0.05)"
    add("--threshold", type=number, metavar="ρ", help=text)

    add = parser.add_argument_group("frame and light").add_argument
    if not swept:
        add("--mask", metavar="M.png", help="bright where the frame is to be used")
        text = "settings that the tuner exported; options given here win"
        add("--settings", metavar="FILE.json", help=text)
    text = "of a matt wall, or R,G,B, in place of the calibration's BRDF"
    add("--albedo", type=albedo, metavar="A", help=text)
    text = "mirrored light (default: ignore with auto and separated, else keep)"
    add("--highlights", choices=("keep", "ignore", "inpaint"), help=text)
    add("--smooth", type=number, metavar="PX", help="blur the light first (default: by the noise)")

    add = parser.add_argument_group("scale, where the gain is unknown").add_argument
    add("--median-distance", type=number, metavar="MM", help="of the result")
    if not swept:
        add("--known-distance", type=_distance, metavar="MM,COLUMN,ROW", help="of the surface at a pixel")
        text = "between the surface at two pixels: a polyp, the lumen"
        add("--known-diameter", type=_diameter, metavar="MM,COLUMN1,ROW1,COLUMN2,ROW2", help=text)


# What they stand for --------------------------------------------------------------------
def solving(arguments: argparse.Namespace) -> tuple[Any, dict[str, Any]]:
    """Return what the settings file and the options stand for.

    It is the calibration, with the light and the wall that they believe in, and keywords of
    `endolab.reconstruct`.
    """
    from endolab.datasets.known_endoscopes import load_calibration
    from endolab.io.settings import SolvingSettings, read_settings

    calibration = load_calibration(arguments.calibration)
    path = getattr(arguments, "settings", None)
    kept = SolvingSettings() if path is None else read_settings(path)
    light, keywords = dict(kept.photometry), dict(kept.keywords)
    if arguments.albedo is not None:
        light["albedo"] = arguments.albedo
    evidence = calibration.evidence.get("photometry")
    if "albedo" not in light and isinstance(evidence, dict) and evidence.get("brdf_of"):
        print("The BRDF is that of the calibration sheet; --albedo 0.5 takes a matt wall instead.")
    chosen = {name: value for name in SOLVING if (value := getattr(arguments, name, None)) is not None}
    if arguments.contours is not None:
        chosen["contours"] = CONTOURS[arguments.contours]
    if any(name in chosen for name in LENGTHS):
        keywords = {name: value for name, value in keywords.items() if name not in LENGTHS}
    return SolvingSettings(photometry=light).believed(calibration), keywords | chosen


# What is told meanwhile -----------------------------------------------------------------
def progress_bar(unit: str, what: str | None = None, total: int | None = None) -> Any:
    """Return a bar on stderr, where that is a terminal."""
    from tqdm import tqdm

    return tqdm(total=total, unit=unit, leave=False, disable=None, desc=what)


@contextmanager
def announce_compiling() -> Iterator[None]:
    """Say on stderr, once, that loops are compiled, if any are in the block, and show how far that is."""
    from numba.core import event
    from tqdm import tqdm

    from endolab.numerics.compiled import COMPILED

    bars: list[Any] = []

    class Watching(event.Listener):
        def on_start(self, event: object) -> None:
            if not bars:
                tqdm.write(COMPILING if COMPILED["cache"] else NOT_KEPT, file=sys.stderr)
                bars.append(tqdm(total=LOOPS, unit="loop", desc="compiling", leave=False, disable=None))

        def on_end(self, event: object) -> None:
            bars[0].update()

    try:
        with event.install_listener("numba:compile", Watching()):
            yield
    finally:
        for bar in bars:
            bar.close()
