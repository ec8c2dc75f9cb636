"""How the command line says how to solve: the options of `Settings`, and what is shown meanwhile."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from endolab.reconstruction.settings import LENGTHS, option_types

if TYPE_CHECKING:
    from endolab.model.endoscope import Calibration

SWITCHES = {"auto": None, "yes": True, "no": False}


def _split(kind: Any, tokens: Sequence[Any]) -> tuple[Any, ...]:
    """Read ``0.1,1,10``, or ``d,1/d``."""
    words = tuple(tokens[0].value.split(","))
    return words if kind == tuple[str, ...] else tuple(map(float, words))


def _diameter(kind: Any, tokens: Sequence[Any]) -> tuple[Any, ...]:
    """Read ``MM,COLUMN1,ROW1,COLUMN2,ROW2``."""
    mm, *pixels = _split(kind, tokens)
    return mm, tuple(pixels[:2]), tuple(pixels[2:])


Numbers = Annotated[
    tuple[float, ...], Parameter(converter=_split, n_tokens=1, metavar="A,B,…")
]
Words = Annotated[tuple[str, ...], Parameter(converter=_split, n_tokens=1, metavar="A,B,…")]
# The command line writes these otherwise than Python does.
OPTIONS = option_types() | {
    "contours": Literal["auto", "yes", "no"],
    "known_distance": Numbers,
    "known_diameter": Annotated[Numbers, Parameter(converter=_diameter)],
}
SWEPT = OPTIONS | {"lam": Numbers, "xi": Words, "regulariser": Words}


def load(
    calibration: str,
    sources: Sequence[str],
    options: dict[str, Any],
    *,
    settings: str | None = None,
    albedo: Sequence[float] | None = None,
    threads: int | None = None,
) -> tuple[Calibration, dict[str, Any]]:
    """Return the calibration, as it is believed to be, and the keywords of `endolab.reconstruct`."""
    from endolab.io.settings import SolvingSettings, read_settings

    if threads is not None:
        os.environ["ENDOLAB_THREADS"] = str(threads)
    known = load_endoscope(calibration, sources)
    kept = SolvingSettings() if settings is None else read_settings(settings)
    light = dict(kept.photometry)
    if albedo is not None:
        light["albedo"] = albedo if len(albedo) > 1 else albedo[0]
    evidence = known.evidence.get("photometry")
    if "albedo" not in light and isinstance(evidence, dict) and evidence.get("brdf_of"):
        print(
            "The BRDF is the calibration sheet's; --albedo 0.5 takes a matt wall instead."
        )
    if "contours" in options:
        options["contours"] = SWITCHES[options["contours"]]
    keywords = dict(kept.keywords)
    if any(name in options for name in LENGTHS):  # one alone may fix the scale
        keywords = {name: value for name, value in keywords.items() if name not in LENGTHS}
    return SolvingSettings(photometry=light).apply(known), keywords | options


def load_endoscope(calibration: str, sources: Sequence[str]) -> Calibration:
    """Load a calibration; pictures are as large as the first source's, if it does not say."""
    from endolab.io.cameras.readers import MissingSize
    from endolab.io.datasets.known_endoscopes import load_calibration
    from endolab.io.video import open_frames

    try:
        return load_calibration(calibration)
    except MissingSize:
        frames = open_frames(*sources)
        ((_, image),) = frames.read(frames.names[:1])
        if image is None:
            raise
        rows, columns = image.shape[:2]
        return load_calibration(calibration, size=(columns, rows))


@contextmanager
def show_progress(unit: str) -> Iterator[Callable[..., None]]:
    """Show how many of how many are done, and a note, on stderr where that is a terminal."""
    from tqdm import tqdm

    with tqdm(unit=unit, leave=False, disable=None) as bar:

        def show(done: int, total: int | None = None, note: object = "") -> None:
            bar.total = total
            bar.set_postfix_str(str(note), refresh=False)
            bar.update(done - bar.n)

        yield show


@contextmanager
def announce_compiling() -> Iterator[None]:
    """Say on stderr, once, that loops are compiled, if any are in the block."""
    from numba.core import event
    from tqdm import tqdm

    from endolab.numerics.compiled import COMPILED

    class Announcer(event.Listener):
        said = False

        def on_start(self, event: object) -> None:
            when = "only the first run does" if COMPILED["cache"] else "in every run"
            if not self.said:
                text = f"Compiling for this machine, a minute or so; {when}."
                tqdm.write(text, file=sys.stderr)
            self.said = True

        def on_end(self, event: object) -> None:
            pass

    with event.install_listener("numba:compile", Announcer()):
        yield
