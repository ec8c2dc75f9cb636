"""How a frame is solved, in a small JSON file: what the tuner saves, and `endolab reconstruct` takes.

``{"endolab_settings": 1, "xi": "1/d", "lam": 0.002, "photometry": {"k": 2.4}}``: keywords of `reconstruct`,
and what is believed of the light in place of the calibration. What a file does not say stays as it is by
default.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from endolab.io.atomic import PathLike, as_json, read_json, write_atomically
from endolab.model.brdf import Lambertian
from endolab.model.endoscope import Calibration
from endolab.model.photometry import Photometry
from endolab.model.schema import Section, quote
from endolab.reconstruction.settings import MAP, Settings, option_fields, option_of

FORMAT = "endolab_settings"
VERSION = 1
BELIEFS = ("k", "gamma", "gain", "albedo")


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
        return replace(calibration, photometry=self.believe(calibration.photometry))

    def believe(self, photometry: Photometry) -> Photometry:
        """Return the light as the settings believe it to be."""
        light = dict(self.photometry)
        if "albedo" in light:
            light["brdf"] = Lambertian(light.pop("albedo"))
        return replace(photometry, **light)


def write_settings(settings: SolvingSettings, path: PathLike) -> None:
    """Write settings as JSON, whole or not at all; `read_settings` reads them. None is left out."""
    content = {FORMAT: VERSION} | _without_none(settings.keywords)
    light = _without_none(settings.photometry)
    if light:
        content["photometry"] = light
    write_atomically(path, as_json(content))


def _without_none(values: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in values.items() if value is not None}


def read_settings(path: PathLike) -> SolvingSettings:
    """Read settings; OSError or ValueError in one sentence, which names what in the file is wrong."""
    top = Section(read_json(path, "settings file"), "", str(path))
    version = top.take(FORMAT)
    if version != VERSION or isinstance(version, bool):
        raise top.error(FORMAT, f"expected version {VERSION}, found {quote(version)}")
    light: dict[str, Any] = {}
    if "photometry" in top.content:
        light = _take(top.section("photometry"), BELIEFS)
    top.asked["photometry"] = None
    # An array is in no file.
    names = [part.name for part in option_fields() if option_of(part.name).kind != MAP]
    settings = SolvingSettings(_take(top, names), light)
    try:
        Settings.of(settings.keywords)
        settings.believe(Photometry())
    except ValueError as error:
        raise top.error("", str(error)) from error
    return settings


def _take(part: Section, names: Iterable[str]) -> dict[str, Any]:
    """Take all that a part of the file says; what it may say are these names."""
    part.asked |= dict.fromkeys(names)
    values = {
        name: _as_tuples(part.take(name)) for name in part.asked if name in part.content
    }
    part.end()
    return values


def _as_tuples(value: Any) -> Any:
    return tuple(map(_as_tuples, value)) if isinstance(value, list) else value
