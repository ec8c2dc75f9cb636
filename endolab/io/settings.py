"""How a frame is solved, in a small JSON file: what the tuner saves, and `endolab reconstruct` takes.

``{"endolab_settings": 1, "xi": "1/d", "lam": 0.002, "photometry": {"k": 2.4}}``: keywords of `reconstruct`,
and what is believed of the light in place of the calibration. What a file does not say stays as it is by
default.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from endolab.io.atomic import PathLike, as_json, read_json, write_atomically
from endolab.model.brdf import Lambertian
from endolab.model.endoscope import Calibration
from endolab.model.schema import Section, quote
from endolab.reconstruction.settings import (
    COUNT,
    DIAMETER,
    DISTANCE,
    NUMBER,
    SWITCH,
    WORD,
    option_fields,
    option_of,
)

FORMAT = "endolab_settings"
VERSION = 1


@dataclass(frozen=True)
class SolvingSettings:
    """How a frame is solved.

    Parameters
    ----------
    keywords : mapping
        Of `endolab.reconstruct`, those that are options of `Settings`.
    photometry : mapping
        What is believed of the light: "k", "gamma", "gain", and the "albedo" of a matt wall, one number or
        three, in place of the BRDF.
    """

    keywords: Mapping[str, Any] = field(default_factory=dict)
    photometry: Mapping[str, Any] = field(default_factory=dict)

    def apply(self, calibration: Calibration) -> Calibration:
        """Return the calibration as the settings believe it to be."""
        light = dict(self.photometry)
        if "albedo" in light:
            light["brdf"] = Lambertian(light.pop("albedo"))
        return replace(calibration, photometry=replace(calibration.photometry, **light))


def write_settings(settings: SolvingSettings, path: PathLike) -> None:
    """Write settings as JSON, whole or not at all; `read_settings` reads them. None is left out."""
    given = {name: value for name, value in settings.keywords.items() if value is not None}
    light = {
        name: value for name, value in settings.photometry.items() if value is not None
    }
    write_atomically(
        path, as_json({FORMAT: VERSION} | given | ({"photometry": light} if light else {}))
    )


def read_settings(path: PathLike) -> SolvingSettings:
    """Read settings; OSError or ValueError in one sentence, which names what in the file is wrong."""
    top = Section(read_json(path, "settings file"), "", str(path))
    version = top.take(FORMAT)
    if version != VERSION or isinstance(version, bool):
        raise top.error(FORMAT, f"expected version {VERSION}, found {quote(version)}")
    light: dict[str, Any] = {}
    if "photometry" in top.content:
        light = _read(top.section("photometry"), PHOTOMETRY_READERS)
    top.asked["photometry"] = None
    return SolvingSettings(_read(top, _keywords()), light)


def _keywords() -> dict[str, Callable[[Section, str], Any]]:
    """Return what a file may say, and how it is read; the rest is the affair of `Settings`."""
    kinds = {part.name: option_of(part.name).kind for part in option_fields()}
    return {name: READERS[kind] for name, kind in kinds.items() if kind in READERS}


def _read(
    part: Section, known: Mapping[str, Callable[[Section, str], Any]]
) -> dict[str, Any]:
    """Read all that a part of the file says."""
    part.asked |= dict.fromkeys(known)
    values = {
        name: read(part, name) for name, read in known.items() if name in part.content
    }
    part.end()
    return values


# Values ---------------------------------------------------------------------------------
def _word(part: Section, name: str) -> str:
    value = part.take(name)
    if not isinstance(value, str):
        raise part.error(name, f"expected a word in quotes, found {quote(value)}")
    return value


def _switch(part: Section, name: str) -> bool:
    value = part.take(name)
    if not isinstance(value, bool):
        raise part.error(name, f"expected true or false, found {quote(value)}")
    return value


def _count(part: Section, name: str) -> int:
    return part.integer(name, low=1)


def _distance(part: Section, name: str) -> tuple[float, ...]:
    return part.numbers(name, 3)


def _diameter(
    part: Section, name: str
) -> tuple[float, tuple[float, ...], tuple[float, ...]]:
    value = part.take(name)
    if not (
        isinstance(value, list)
        and len(value) == 3
        and all(isinstance(at, list) for at in value[1:])
    ):
        raise part.error(
            name, f"expected [mm, [column, row], [column, row]], found {quote(value)}"
        )
    flat = [value[0], *value[1], *value[2]]
    length, *places = Section({name: flat}, part.where, part.file).numbers(name, 5)
    return length, tuple(places[:2]), tuple(places[2:])


def _albedo(part: Section, name: str) -> float | tuple[float, ...]:
    is_list = isinstance(part.content[name], list)
    return part.numbers(name, 3) if is_list else part.number(name)


READERS: dict[str, Callable[[Section, str], Any]] = {
    WORD: _word,
    NUMBER: Section.number,
    COUNT: _count,
    SWITCH: _switch,
    DISTANCE: _distance,
    DIAMETER: _diameter,
}
PHOTOMETRY_READERS = dict.fromkeys(("k", "gamma", "gain"), Section.number) | {
    "albedo": _albedo
}
