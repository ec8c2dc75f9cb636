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
from endolab.model.endoscope import Endoscope
from endolab.model.schema import Section, quoted, unknown_name

FORMAT, VERSION = "endolab_settings", 1
LIGHT = ("k", "gamma", "gain", "albedo")  # of "photometry"


@dataclass(frozen=True)
class SolvingSettings:
    """How a frame is solved.

    Parameters
    ----------
    keywords : mapping
        Of `endolab.reconstruct`, those in `KEYWORDS`.
    photometry : mapping
        What is believed of the light: "k", "gamma", "gain", and the "albedo" of a matt wall, one number or
        three, in place of the BRDF.

    Raises
    ------
    ValueError
        In one sentence, if a name is not known, or a value is none that a file can hold.
    """

    keywords: Mapping[str, Any] = field(default_factory=dict)
    photometry: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in self.keywords:
            if name not in KEYWORDS:
                raise unknown_name("setting", name, KEYWORDS)
        for name in self.photometry:
            if name not in LIGHT:
                raise unknown_name("part of the photometry", name, LIGHT)

    def believed(self, calibration: Endoscope) -> Endoscope:
        """Return the calibration as the settings believe it to be."""
        light = dict(self.photometry)
        if "albedo" in light:
            light["brdf"] = Lambertian(light.pop("albedo"))
        return replace(calibration, photometry=replace(calibration.photometry, **light))

    def to_json(self) -> bytes:
        """Encode as the file's content."""
        said = {name: self.keywords[name] for name in KEYWORDS if self.keywords.get(name) is not None}
        light = {name: self.photometry[name] for name in LIGHT if self.photometry.get(name) is not None}
        return as_json({FORMAT: VERSION} | said | ({"photometry": light} if light else {}))


def write_settings(settings: SolvingSettings, path: PathLike) -> None:
    """Write settings as JSON, whole or not at all; `read_settings` reads them."""
    write_atomically(path, settings.to_json())


def read_settings(path: PathLike) -> SolvingSettings:
    """Read settings; OSError or ValueError in one sentence, which names what in the file is wrong."""
    top = Section(read_json(path, "settings file"), "", str(path))
    version = top.take(FORMAT)
    if version != VERSION or isinstance(version, bool):
        raise top.error(FORMAT, f"expected version {VERSION}, found {quoted(version)}")
    keywords: dict[str, Any] = {}
    for name, read in KEYWORDS.items():
        top.asked[name] = None
        if name in top.content:
            keywords[name] = read(top, name)
    light: dict[str, Any] = {}
    if "photometry" in top.content:
        part = top.section("photometry")
        for name in LIGHT:
            part.asked[name] = None
            if name in part.content:
                light[name] = _albedo(part, name) if name == "albedo" else part.number(name)
        part.end()
    top.asked["photometry"] = None
    settings: SolvingSettings = top.build(SolvingSettings, keywords=keywords, photometry=light)
    return settings


# Values ---------------------------------------------------------------------------------
def _word(part: Section, name: str) -> str:
    value = part.take(name)
    if not isinstance(value, str):
        raise part.error(name, f"expected a word in quotes, found {quoted(value)}")
    return value


def _switch(part: Section, name: str) -> bool:
    value = part.take(name)
    if not isinstance(value, bool):
        raise part.error(name, f"expected true or false, found {quoted(value)}")
    return value


def _number_or_auto(part: Section, name: str) -> float | str:
    return _word(part, name) if isinstance(part.content[name], str) else part.number(name)


def _count(part: Section, name: str) -> int:
    return part.whole(name, low=1)


def _distance(part: Section, name: str) -> tuple[float, ...]:
    return part.numbers(name, 3)


def _diameter(part: Section, name: str) -> tuple[float, tuple[float, ...], tuple[float, ...]]:
    value = part.take(name)
    if not (isinstance(value, list) and len(value) == 3 and all(isinstance(at, list) for at in value[1:])):
        raise part.error(name, f"expected [mm, [column, row], [column, row]], found {quoted(value)}")
    flat = [value[0], *value[1], *value[2]]
    length, *places = Section({name: flat}, part.where, part.file).numbers(name, 5)
    return length, tuple(places[:2]), tuple(places[2:])


def _albedo(part: Section, name: str) -> float | tuple[float, ...]:
    return part.numbers(name, 3) if isinstance(part.content[name], list) else part.number(name)


# Keywords of `reconstruct` that a file may have, and how each is read; what may be said of each is
# `reconstruct`'s affair.
KEYWORDS: dict[str, Callable[[Section, str], Any]] = {
    "solver": _word,
    "channel": _word,
    "xi": _word,
    "regulariser": _word,
    "lam": _number_or_auto,
    "epsilon": Section.number,
    "threshold": Section.number,
    "max_iterations": _count,
    "width": _count,
    "smooth": Section.number,
    "highlights": _word,
    "contours": _switch,
    "median_distance": Section.number,
    "known_distance": _distance,
    "known_diameter": _diameter,
}
