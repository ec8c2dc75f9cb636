"""How the command line says how to solve: the options of `Settings`, and what is shown meanwhile."""

from __future__ import annotations

import getpass
import logging
import os
import socket
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter
from cyclopts.validators import Number

if TYPE_CHECKING:
    from endolab.frames.frame import Frame
    from endolab.io.settings import SolvingSettings
    from endolab.model.endoscope import Calibration

Count = Annotated[int, Parameter(validator=Number(gte=1))]
Port = Annotated[int, Parameter(validator=Number(gte=1, lte=65535))]
Reader = Callable[[Any, Sequence[Any]], Any]


def _several(_: Any, tokens: Sequence[Any]) -> tuple[Any, ...]:
    """Read ``0.1,1,10``, or words."""
    words = tuple(tokens[0].value.split(","))
    try:
        return tuple(map(float, words))
    except ValueError:
        return words


def _value(_: Any, tokens: Sequence[Any]) -> Any:
    """Read ``0.5``, ``0.7,0.4,0.3``, or ``free``."""
    values = _several(_, tokens)
    return values if len(values) > 1 else values[0]


def _numbers(form: str, kind: type = float, between: str = ",") -> Reader:
    """Make what reads as many numbers as a form has, such as ``MM,COLUMN,ROW``."""

    def read(_: Any, tokens: Sequence[Any]) -> tuple[Any, ...]:
        with suppress(ValueError):
            given = tuple(map(kind, tokens[0].value.split(between)))
            if len(given) == len(form.split(between)):
                return given
        raise ValueError(f"expected {form}, got {tokens[0].value}")

    return read


def _diameter(_: Any, tokens: Sequence[Any]) -> tuple[Any, ...]:
    mm, *pixels = _numbers("MM,COLUMN1,ROW1,COLUMN2,ROW2")(_, tokens)
    return mm, tuple(pixels[:2]), tuple(pixels[2:])


def _lamps(_: Any, tokens: Sequence[Any]) -> list[tuple[float, ...]]:
    forms = ["X,Y,Z" if token.value.count(",") == 2 else "X,Y" for token in tokens]
    return [_numbers(form)(_, [token]) for form, token in zip(forms, tokens, strict=True)]


def _read_by(read: Reader) -> Any:
    return Annotated[Any, Parameter(converter=read, n_tokens=1)]


Several = _read_by(_several)
Value = _read_by(_value)
Distance = _read_by(_numbers("MM,COLUMN,ROW"))
Diameter = _read_by(_diameter)
Rectangle = _read_by(_numbers("COLUMN,ROW,WIDTH,HEIGHT", int))
# X,Y or X,Y,Z, mm, once for each lamp; the first number may be below 0.
Lamps = Annotated[
    list[Any] | None, Parameter(converter=_lamps, n_tokens=1, allow_leading_hyphen=True)
]
Size = _read_by(_numbers("COLUMNSxROWS", int, "x"))


def load(
    calibration: Calibration,
    options: dict[str, Any],
    light: dict[str, Any],
    threads: int | None,
    kept: SolvingSettings | None = None,
) -> tuple[Calibration, dict[str, Any]]:
    """Return a calibration, as it is believed to be, and the keywords of `endolab.reconstruct`.

    `light` is what is believed of it, `kept` what a file of settings says; options win.
    """
    from endolab.io.settings import SolvingSettings
    from endolab.reconstruction.settings import LENGTHS

    if threads is not None:
        os.environ["ENDOLAB_THREADS"] = str(threads)
    kept = kept or SolvingSettings()
    given = {name: value for name, value in light.items() if value is not None}
    kept = replace(kept, photometry={**kept.photometry, **given})
    if "contours" in options:
        options["contours"] = {"auto": None, "yes": True, "no": False}[options["contours"]]
    keywords = dict(kept.keywords)
    for name in LENGTHS if options.keys() & LENGTHS else ():  # one alone may fix the scale
        keywords.pop(name, None)
    return kept.apply(calibration), keywords | options


def load_endoscope(
    calibration: str | None,
    sources: Sequence[str],
    fov: float | None = None,
    crop: tuple[int, int, int, int] | None = None,
) -> Calibration:
    """Load a calibration, or that of a part of its pictures; a nominal one of the first source without."""
    from endolab.frames.nominal import nominal_of_several
    from endolab.io.cameras.readers import MissingSize
    from endolab.io.datasets.known_endoscopes import load_calibration
    from endolab.model.endoscope import same_shape

    if calibration is None:
        if crop is not None:
            raise ValueError("--crop is of a calibration's pictures: give it --calibration")
        known = nominal_of_several(_sample(sources), 140.0 if fov is None else fov)
        light = known.photometry
        angle = f"a fisheye, {known.evidence['camera']['fov']:g}° across what it shows"
        text = f"no calibration: {angle}, k {light.k:g}, γ {light.gamma:g}: shape only"
        logging.getLogger("endolab").warning("%s", text)
        return known
    if fov is not None:
        raise ValueError("--fov is of a picture without --calibration, which tells it")
    try:
        known = load_calibration(calibration)
    except MissingSize:
        first = next(_sample(sources))
        known = load_calibration(calibration, size=(first.width, first.height))
    is_nominal = "nominal" in known.evidence.get("photometry", {})
    if is_nominal and next(_sample(sources)).is_linear:
        known = replace(known, photometry=replace(known.photometry, gamma=1.0))
    if crop is None or known.evidence.get("crop") == [*crop]:  # a result's own file
        return known
    frame = next(_sample(sources))
    column, row, *cut = crop
    own, size = (known.camera.width, known.camera.height), (frame.width, frame.height)

    def holds(whole: tuple[int, int]) -> bool:
        return column + cut[0] <= whole[0] and row + cut[1] <= whole[1]

    # Of the calibration's pictures, or of this one: sizes tell.
    if own == size or not (holds(size) and same_shape(cut, own)):
        return known.crop(*crop)
    if own != tuple(cut) and holds(own) and same_shape(size, cut):
        raise ValueError(
            f"--crop {','.join(map(str, crop))} may be a part of {frame.name}, {size[0]}x{size[1]} px, or of "
            f"the calibration's {own[0]}x{own[1]} px: cut the picture first, or take Calibration.crop"
        )
    return replace(known, part=crop)


def _sample(sources: Sequence[str]) -> Iterator[Frame]:
    """Read up to nine frames, spread over all, but those that can't be used; ValueError if none can."""
    import numpy as np

    from endolab.frames.frame import usable_pixels
    from endolab.io.images import read_frame
    from endolab.io.video import open_frames
    from endolab.reconstruction.sequence import as_frame

    frames = open_frames(*sources)
    refused: list[Exception] = []
    names = frames.spread(9)
    for name, picture in (
        frames.read(names) if frames.is_video else dict.fromkeys(names).items()
    ):
        try:
            frame = (
                read_frame(frames.path / name)
                if picture is None
                else as_frame(name, picture)
            )
            shown = frame.selection.pixels
            usable_pixels(frame.channel()[1], shown, np.ones(shown.shape), name)
        except (OSError, ValueError, MemoryError) as error:
            refused.append(error)
        else:
            yield frame
    if len(refused) == len(names):
        raise refused[0]


# Pages ----------------------------------------------------------------------------------
def free_port(first: int) -> int:
    """Find the first port from `first` on that nobody listens to."""
    for port in range(first, 65536):
        with suppress(OSError, OverflowError), socket.create_server(("127.0.0.1", port)):
            return port
    raise ValueError(f"--port must be below 65536, got {first}")


def tunnel(port: int) -> str:
    """Say what to type on one's own machine first, where no browser can open here; else ""."""
    ends = os.environ.get("SSH_CONNECTION", "").split()  # two addresses, each with its port
    displays = map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY"))
    if not ends and (sys.platform != "linux" or any(displays)):
        return ""
    place = f"{getpass.getuser()}@{ends[2] if len(ends) > 2 else socket.gethostname()}"
    return f"First, on your own machine: ssh -L {port}:127.0.0.1:{port} {place}"


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

    class Announcer(event.Listener):
        is_first = True

        def on_start(self, event: object) -> None:
            if self.is_first:
                text = (
                    "Compiling for this machine, a minute or so; only the first run does."
                )
                tqdm.write(text, file=sys.stderr)
            self.is_first = False

        def on_end(self, event: object) -> None:
            pass

    with event.install_listener("numba:compile", Announcer()):
        yield
