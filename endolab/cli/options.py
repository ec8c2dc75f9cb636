"""How the command line says how to solve: the options, in one place, and the keywords they stand for."""

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from endolab.reconstruction.settings import (
    COUNT,
    DIAMETER,
    DISTANCE,
    FRAME_AND_LIGHT,
    LENGTHS,
    MAP,
    NUMBER,
    SCALE,
    SURFACE,
    SWITCH,
    WORD,
    Option,
    option_fields,
    option_of,
)

SWITCHES = {"auto": None, "yes": True, "no": False}


# Values ---------------------------------------------------------------------------------
def integer(text: str) -> int:
    """Read a whole number that an option was given."""
    largest = 2**31 - 1  # no count is larger
    try:
        value = int(text)
    except ValueError:
        value = largest + 1
    if abs(value) > largest:
        raise argparse.ArgumentTypeError(f"expected a whole number, found {text!r}")
    return value


def at_least(least: int, unit: str = "") -> Callable[[str], int]:
    """Return what reads a whole number that is not less than another."""

    def read(text: str) -> int:
        if integer(text) < least:
            raise argparse.ArgumentTypeError(
                f"expected at least {least}{unit}, found {text!r}"
            )
        return integer(text)

    return read


count = at_least(1)
wide = at_least(16, " px")


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
    first, *others = several(number)(text)
    return (first, *others) if others else first


def _distance(text: str) -> tuple[float, ...]:
    return tuple(several(number)(text))


def _diameter(text: str) -> tuple[Any, ...]:
    mm, *pixels = several(number)(text)
    return mm, tuple(pixels[:2]), tuple(pixels[2:])


READERS: dict[str, Callable[[str], Any]] = {
    WORD: str,
    NUMBER: number,
    COUNT: count,
    DISTANCE: _distance,
    DIAMETER: _diameter,
}


# Options --------------------------------------------------------------------------------
def add_command(
    commands: Any,
    name: str,
    run: Callable[[argparse.Namespace], None],
    does: str,
    *examples: str,
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
    option(
        "--overwrite",
        action="store_true",
        help="write even where there are files of others",
    )


def add_threads(option: Callable[..., Any]) -> None:
    """Add the option of every command that solves."""
    text = "cores at most (default: ENDOLAB_THREADS, or all)"
    option("--threads", type=count, metavar="N", help=text)


def add_solving_options(
    parser: argparse.ArgumentParser, most_used: Callable[..., Any], swept: bool = False
) -> None:
    """Add what `read_solving_options` reads, in groups; λ, ξ and order are lists if `swept`."""
    most_used(
        "--calibration",
        required=True,
        metavar="CAL",
        help="endoscope.json, a known endoscope's name, or another program's file",
    )
    for group in ("", SURFACE, FRAME_AND_LIGHT, SCALE):
        add = parser.add_argument_group(group).add_argument if group else most_used
        if group == FRAME_AND_LIGHT:
            _add_light_options(add, swept)
        for part in option_fields():
            facts = option_of(part.name)
            if facts.group == group and facts.kind != MAP:
                _add_option(add, part.name, facts, swept)


def _add_option(add: Callable[..., Any], name: str, facts: Option, swept: bool) -> None:
    """Add an option of `Settings`."""
    if swept and facts.kind in (DISTANCE, DIAMETER):  # of one frame
        return
    flag = f"--{name.replace('_', '-')}"
    if facts.kind == SWITCH:
        add(flag, choices=tuple(SWITCHES), help=facts.help)
        return
    lists = {"lam": "0.1,1,10", "xi": "d,1/d", "regulariser": "first,curvature"}
    if swept and name in lists:
        text = f"{facts.help}; several as {lists[name]}"
        add(flag, type=several(READERS[facts.kind]), metavar=facts.form, help=text)
        return
    add(
        flag,
        type=READERS[facts.kind],
        choices=facts.choices or None,
        metavar=facts.form or None,
        help=facts.help,
    )


def _add_light_options(add: Callable[..., Any], swept: bool) -> None:
    """Add what is said of the frame and its light, and is no option of `Settings`."""
    if not swept:
        add("--mask", metavar="M.png", help="bright where the frame is to be used")
        text = "settings that the tuner exported; options given here win"
        add("--settings", metavar="FILE.json", help=text)
    text = "of a matt wall, or R,G,B, in place of the calibration's BRDF"
    add("--albedo", type=albedo, metavar="A", help=text)


def load_endoscope(arguments: argparse.Namespace) -> Any:
    """Load what --calibration names; pictures are as large as the first frame, if it does not say."""
    from endolab.io.cameras.readers import MissingSize
    from endolab.io.datasets.known_endoscopes import load_calibration
    from endolab.io.video import open_frames

    try:
        return load_calibration(arguments.calibration)
    except MissingSize:
        source = getattr(arguments, "frame", None) or arguments.frames
        sources = [source] if isinstance(source, str) else source
        frames = open_frames(*sources)
        ((_, image),) = frames.read(frames.names[:1])
        if image is None:
            raise
        rows, columns = image.shape[:2]
        return load_calibration(arguments.calibration, size=(columns, rows))


# What they stand for --------------------------------------------------------------------
def read_solving_options(arguments: argparse.Namespace) -> tuple[Any, dict[str, Any]]:
    """Return what the settings file and the options stand for.

    It is the calibration, with the light and the wall that they believe in, and keywords of
    `endolab.reconstruct`.
    """
    from endolab.io.settings import SolvingSettings, read_settings

    calibration = load_endoscope(arguments)
    path = getattr(arguments, "settings", None)
    kept = SolvingSettings() if path is None else read_settings(path)
    light = dict(kept.photometry)
    keywords = dict(kept.keywords)
    if arguments.albedo is not None:
        light["albedo"] = arguments.albedo
    evidence = calibration.evidence.get("photometry")
    if "albedo" not in light and isinstance(evidence, dict) and evidence.get("brdf_of"):
        print(
            "The BRDF is that of the calibration sheet; --albedo 0.5 takes a matt wall instead."
        )
    chosen: dict[str, Any] = {}
    for part in option_fields():
        value = getattr(arguments, part.name, None)
        if value is not None:
            is_switch = option_of(part.name).kind == SWITCH
            chosen[part.name] = SWITCHES[value] if is_switch else value
    if any(name in chosen for name in LENGTHS):
        keywords = {name: value for name, value in keywords.items() if name not in LENGTHS}
    return SolvingSettings(photometry=light).apply(calibration), keywords | chosen


# What is told meanwhile -----------------------------------------------------------------
def progress_bar(unit: str, what: str | None = None, total: int | None = None) -> Any:
    """Return a bar on stderr, where that is a terminal."""
    from tqdm import tqdm

    return tqdm(total=total, unit=unit, leave=False, disable=None, desc=what)


@contextmanager
def announce_compiling() -> Iterator[None]:
    """Say on stderr, once, that loops are compiled, if any are in the block."""
    from numba.core import event
    from tqdm import tqdm

    from endolab.numerics.compiled import COMPILED

    class Watching(event.Listener):
        is_first = True

        def on_start(self, event: object) -> None:
            if self.is_first:
                text = (
                    "Compiling for this machine, a minute or so; only the first run does."
                )
                if not COMPILED["cache"]:
                    text = "Compiling, a minute or so, in every run: "
                    text += "NUMBA_CACHE_DIR can name a folder to keep it in."
                tqdm.write(text, file=sys.stderr)
            self.is_first = False

        def on_end(self, event: object) -> None:
            pass

    with event.install_listener("numba:compile", Watching()):
        yield
